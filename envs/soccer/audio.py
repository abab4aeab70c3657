"""What microphones on a field hear: every voice at once, echo, motors, at 8 kHz.

Sounds are pressures in Pa.  A robot has one speaker and two microphones; from a speaker to a
microphone go the direct sound (1/distance, delay, quieter behind the speaker) and the room's echo,
Gaussian noise that decays exponentially, drawn once a match for every pair.  Each microphone also
has the noise of its own robot's motors (broad noise that swells with the gait, gears' whine, blows
of the feet) and the hall's.  Levels and shapes are assumed, except the speed of sound; the hall's
echo follows Sabine's diffuse field, as loud as the direct sound at the critical distance.
"""

import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

Scalar = Float[Array, ""] | float

RATE = 8000  # Hz
STEP = 800  # samples of a control step of 0.1 s
_HISTORY = 2400  # samples of what was said before that a step still hears
_LENGTH = 4096  # of the Fourier transforms: history, step and the direct delay's room
SPEED = 343.0  # m/s
REFERENCE = 20e-6  # Pa, 0 dB
MICROPHONE = 0.05  # m to the left and right of the robot's centre (assumed)
GAIT = 1.5  # periods of the walk a second
NEAREST = 0.1  # m, from a robot's speaker to its own microphones (assumed)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Hall:
    """Levels in dB over 20 uPa, root mean square; all assumed, for a hall of 3000 m^3.

    voice: a robot's speaker at 1 m in front of it.  motors: at the robot's own microphones while it
    walks.  ambient: the hall's own noise.  echo_time: s until echo has fallen by 60 dB.
    critical_distance: m, where echo is as loud as the direct sound.
    """

    voice: Scalar = 65.0
    motors: Scalar = 55.0
    ambient: Scalar = 45.0
    echo_time: Scalar = 1.2
    critical_distance: Scalar = 2.8  # 0.057 sqrt(volume / echo_time)


def pressure(level: Scalar) -> Scalar:
    """Root mean square, Pa, of a level in dB."""
    return REFERENCE * 10 ** (level / 20)


class State(NamedTuple):
    """Between control steps.  said: amplitude of each robot's voice, the last 0.3 s; coming: what
    it has begun to say; echo: transfer of the room, from each speaker to each microphone; gait:
    phase of each robot's walk, 0 to 1."""

    said: Float[Array, "R history"]
    coming: Float[Array, "R samples"]
    echo: Complex[Array, "R 2 R frequencies"]
    gait: Float[Array, " R"]


def echo(key: Array, num_robots: int, hall: Hall) -> Complex[Array, "R 2 R frequencies"]:
    """Transfer function of the room alone, of energy 1/critical_distance^2."""
    samples = _LENGTH - _HISTORY
    time = jnp.arange(samples) / RATE
    # The first reflections arrive some milliseconds after the direct sound; what comes after 0.2 s
    # is left out.
    rate = 6 * math.log(10) / hall.echo_time
    decay = jnp.where(time < 0.004, 0.0, jnp.exp(-rate / 2 * time))
    energy = RATE / rate * jnp.exp(-0.004 * rate)
    decay = decay / jnp.sqrt(energy) / hall.critical_distance
    noise = jax.random.normal(key, (num_robots, 2, num_robots, samples))
    return jnp.fft.rfft(noise * decay, _LENGTH)


def quiet(key: Array, num_robots: int, frame: int, hall: Hall) -> State:
    """Before anyone has spoken.  frame: samples of the longest message."""
    coming = jnp.zeros((num_robots, math.ceil(frame / STEP) * STEP))
    gait = jnp.arange(num_robots) / num_robots
    return State(jnp.zeros((num_robots, _HISTORY)), coming, echo(key, num_robots, hall), gait)


def paths(
    position: Float[Array, "R 2"], heading: Float[Array, " R"]
) -> tuple[Float[Array, "R 2 R"], Float[Array, "R 2 R"]]:
    """Direct sound from speakers (last axis) to microphones: gain (1 at 1 m ahead), delay in s.

    A voice is half as loud behind the robot (assumed).
    """
    left = jnp.stack([-jnp.sin(heading), jnp.cos(heading)], -1)
    ears = position[:, None] + MICROPHONE * left[:, None] * jnp.array([[1.0], [-1.0]])
    way = ears[:, :, None] - position
    distance = jnp.maximum(jnp.sqrt((way**2).sum(-1)), NEAREST)
    ahead = (way[..., 0] * jnp.cos(heading) + way[..., 1] * jnp.sin(heading)) / distance
    return (0.75 + 0.25 * ahead) / distance, distance / SPEED


def motor_noise(key: Array, gait: Float[Array, "..."], samples: int) -> Float[Array, "... samples"]:
    """Noise of a walking robot's motors at its own microphones, root mean square 1 (assumed).

    gait: phase of the walk at the begin, in periods of 1/1.5 s.  Half of the energy is broad noise
    that falls by 6 dB an octave above 500 Hz and swells with the gait; a quarter gears' whine, ten
    harmonics of 180 to 400 Hz, drawn anew in every call; a quarter the blows of the feet, four a
    period, which decay in 8 ms.
    """
    keys = jax.random.split(key, 2)
    phase = gait[..., None] + GAIT * jnp.arange(samples) / RATE
    swell = jnp.sin(2 * np.pi * phase)
    hertz = np.fft.rfftfreq(samples, 1 / RATE)
    falling = 1 / np.sqrt(1 + (hertz / 500) ** 2)
    white = jax.random.normal(keys[0], (2, *phase.shape))
    broad = jnp.fft.irfft(jnp.fft.rfft(white[0]) * falling.astype(np.float32), samples)
    broad = broad * (1 + 0.5 * swell) / math.sqrt((falling**2).mean() * 1.125)
    since = jnp.mod(phase, 0.25) / GAIT
    blows = white[1] * jnp.exp(-since / 0.008) / math.sqrt(0.004 * 4 * GAIT)
    gear = jax.random.uniform(keys[1], (*gait.shape, 1), minval=180.0, maxval=400.0)
    turning = gear * (jnp.arange(samples) / RATE - 0.01 * swell)
    harmonics = np.arange(1, 11)
    whine = jnp.stack([jnp.sin(2 * np.pi * n * turning) / n for n in harmonics]).sum(0)
    whine = whine / math.sqrt((0.5 / harmonics**2).sum())
    return math.sqrt(0.5) * broad + 0.5 * blows + 0.5 * whine


def step(
    key: Array,
    state: State,
    position: Float[Array, "R 2"],
    heading: Float[Array, " R"],
    begins: Float[Array, "R samples"],
    walking: Float[Array, " R"],
    hall: Hall,
) -> tuple[State, Float[Array, "R 2 800"]]:
    """One control step: what each robot's two microphones record, in Pa.

    begins: sounds of amplitude 1 that robots begin now, zeros for who does not; they are added to
    what they are still saying.  walking: 0 to 1, loudness of the motors.
    """
    coming = state.coming + jnp.pad(begins, ((0, 0), (0, state.coming.shape[1] - begins.shape[1])))
    said = jnp.concatenate([state.said, coming[:, :STEP]], 1)
    heard = mixture(said, position, heading, state.echo, hall)[..., _HISTORY : _HISTORY + STEP]
    coming = jnp.pad(coming[:, STEP:], ((0, 0), (0, STEP)))
    motors, ambient = jax.random.split(key)
    own = motor_noise(motors, state.gait, STEP) * walking[:, None] * pressure(hall.motors)
    noise = jax.random.normal(ambient, heard.shape) * pressure(hall.ambient)
    gait = jnp.mod(state.gait + GAIT * STEP / RATE, 1.0)
    return State(said[:, STEP:], coming, state.echo, gait), heard + own[:, None] + noise


def mixture(
    said: Float[Array, "R samples"],
    position: Float[Array, "R 2"],
    heading: Float[Array, " R"],
    echo: Complex[Array, "R 2 R frequencies"],
    hall: Hall,
) -> Float[Array, "R 2 4096"]:
    """All voices at all microphones, without noise.  said: amplitude 1; at most 3200 samples."""
    gain, delay = paths(position, heading)
    turns = jnp.fft.rfftfreq(_LENGTH) * RATE
    direct = gain[..., None] * jnp.exp(-2j * np.pi * delay[..., None] * turns)
    voices = jnp.fft.rfft(said, _LENGTH)
    loud = math.sqrt(2) * pressure(hall.voice)
    return loud * jnp.fft.irfft(((direct + echo) * voices).sum(2), _LENGTH)
