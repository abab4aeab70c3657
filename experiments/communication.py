"""How well robots hear each other: frames lost against noise, distance, echo, motors, other voices.

    python -m experiments.communication

Every frame is a random word; "lost" is not heard or heard wrong.  Noise: white, Eb the energy of a
whole frame over its 64 bits.  Field: `envs.soccer.audio` with its assumed hall, the listener's
motors on, speaker and listener turned at random; 0.5 s from the slot's begin are decoded.  Theory
is the union bound of the convolutional code with perfect timing (Chernoff's bound of each pair of
code words, whose weights are published), and, for comparison, 16 tones without a code.

Then decoding attempts on what holds no right frame: noise, speech-like sound (pulses through
formants that glide), damaged frames (a part replaced by another frame or by noise).  Counted are
wrong words accepted, and wrong words that all but the checksum would accept: these are 2^20 times
as many by chance, so they show the rate that a direct count would take 10^9 attempts for.

Writes communication.csv, reliability.csv, false.csv, communication.png, and sound.json, the table
of the match's symbols level: the logistic curve of losses over distance.
"""

import dataclasses
import json
import math
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from envs.soccer import audio
from experiments import script
from fntg_jax.files import write_atomically
from fntg_jax.robot import acoustics
from fntg_jax.robot.communication import SLOT, Word, pack
from fntg_jax.running import statistics, xla

# Weights of the code's error events (generators 171, 133) and how many events have each.
SPECTRUM = {10: 11, 12: 38, 14: 193, 16: 1331, 18: 7275, 20: 40406}
HALL = audio.Hall()


@dataclasses.dataclass(frozen=True)
class Options:
    """How much to compute and where the results go."""

    out: Path = Path("runs/communication")
    """folder of the tables and the figure."""
    frames: int = 1024
    """frames a point."""
    attempts: int = 200_000
    """decoding attempts on each kind of sound without a right frame."""
    seed: int = 0
    """of words, places and noise."""


def words(key: jax.Array, number: int) -> jax.Array:
    """Random words, uint32 [number, 2]."""
    floats = jax.random.uniform(key, (7, number), minval=-1.7, maxval=1.7)
    sender, role = jax.random.randint(jax.random.fold_in(key, 1), (2, number), 0, 3)
    x, y, heading, sd, ball_x, ball_y, age = floats
    return pack(Word(sender, role, x, y, heading, sd, ball_x, ball_y, 6 * jnp.abs(age)))


def at(sound: jax.Array, start: jax.Array, samples: int = 4000) -> jax.Array:
    return jax.lax.dynamic_update_slice(jnp.zeros(samples), sound, (start,))


@partial(jax.jit, static_argnames="number")
def in_noise(
    key: jax.Array, number: int, noise: float, other: float, other_team: int
) -> tuple[jax.Array, ...]:
    """Frames of team 0 in white noise of a standard deviation, and with a second voice of an
    amplitude in a band.  Right and valid; valid and wrong; quality; right before the checks."""

    def one(key: jax.Array) -> tuple[jax.Array, ...]:
        keys = jax.random.split(key, 4)
        said = words(keys[0], 2)
        starts = jax.random.randint(keys[1], (2,), 0, 960)
        sound = at(acoustics.encode(said[0], 0), starts[0])
        sound += other * at(acoustics.encode(said[1], other_team), starts[1])
        sound += noise * jax.random.normal(keys[2], sound.shape)
        found = acoustics.decode(sound[None], 0)
        same = (found.words == said[0]).all()
        second = (found.words == said[1]).all()
        return (
            found.valid & same,
            found.valid & ~same,
            found.quality,
            same & ~second,
            found.quality,
            same,
        )

    return jax.lax.map(one, jax.random.split(key, number), batch_size=64)


@partial(jax.jit, static_argnames="number")
def on_field(
    key: jax.Array, number: int, hall: audio.Hall, distance: float, rival: float
) -> tuple[jax.Array, ...]:
    """A teammate speaks at a distance (m), an opponent at another one: inf for none."""

    def one(key: jax.Array) -> tuple[jax.Array, ...]:
        keys = jax.random.split(key, 5)
        said = words(keys[0], 2)
        angle = jax.random.uniform(keys[1], (5,), maxval=2 * math.pi)
        apart = jnp.array([0.0, distance, jnp.minimum(rival, 50.0)])
        place = apart[:, None] * jnp.stack([jnp.cos(angle[:3]), jnp.sin(angle[:3])], -1)
        turned = jnp.array([angle[3], angle[4], 0.0])
        # The listener's motors alone are in its ears; robot 2 is the opponent.
        state = audio.quiet(keys[2], 3, acoustics.FRAME, hall)
        voices = [acoustics.encode(said[n], n) for n in range(2)]
        loud = jnp.where(jnp.isfinite(rival), 1.0, 0.0)
        begins = jnp.stack([jnp.zeros(acoustics.FRAME), voices[0], loud * voices[1]])
        walking = jnp.array([1.0, 0.0, 0.0])

        def step(state: audio.State, n: jax.Array) -> tuple[audio.State, jax.Array]:
            now = jnp.where(n == 0, begins, 0.0)
            state, heard = audio.step(
                jax.random.fold_in(keys[3], n), state, place, turned, now, walking, hall
            )
            return state, heard[0]

        _, heard = jax.lax.scan(step, state, jnp.arange(5))
        found = acoustics.decode(jnp.moveaxis(heard, 0, 1).reshape(2, -1), 0)
        same = (found.words == said[0]).all()
        return found.valid & same, found.valid & ~same, found.quality, same

    return jax.lax.map(one, jax.random.split(key, number), batch_size=32)


def noise_of(ebn0: float) -> float:
    """Standard deviation of a sample for amplitude 1."""
    return math.sqrt(0.5 * acoustics.FRAME / 64 / 10 ** (ebn0 / 10) / 2)


def uncoded(ebn0: float) -> float:
    """Loss of 64 bits as 16 tones of 16 pitches, no code, no known tones, same energy (Proakis)."""
    energy = 64 / 16 * 10 ** (ebn0 / 10)
    n = np.arange(1, 16)
    combinations = np.array([math.comb(15, int(k)) for k in n])
    terms = (-1.0) ** (n + 1) / (n + 1) * combinations * np.exp(-n / (n + 1) * energy)
    return float(1 - (1 - terms.sum()) ** 16)


def union_bound(ebn0: float) -> float:
    """Upper bound of the loss with perfect timing: 64 ring positions, events by weight, each bit of
    an event in a tone of its own, Chernoff's bound of the sum of their evidence."""
    rng = np.random.default_rng(0)
    energy = 64 / 38 * 10 ** (ebn0 / 10)
    cells = rng.exponential(size=(200_000, 16))
    tone = rng.normal(size=(200_000, 2)) / math.sqrt(2) + [math.sqrt(energy), 0]
    cells[:, 0] = (tone**2).sum(-1)
    level = np.log(cells + cells.mean(-1, keepdims=True))
    evidence = level[:, :8].max(-1) - level[:, 8:].max(-1)
    factor = min(np.exp(-s * evidence).mean() for s in np.linspace(0.1, 8, 80))
    return min(1.0, 64 * sum(count * factor**weight for weight, count in SPECTRUM.items()))


def speech(key: jax.Array, samples: int) -> jax.Array:
    """Speech-like: pulses at a gliding pitch and hiss, through three gliding formants, in
    syllables of about 0.2 s."""
    keys = jax.random.split(key, 4)
    time = jnp.arange(samples) / acoustics.RATE
    u = jax.random.uniform(keys[0], (12,))
    pitch = 90 + 160 * u[0] + 30 * jnp.sin(2 * math.pi * (1 + 3 * u[1]) * time)
    phase = jnp.cumsum(pitch) / acoustics.RATE
    sound = jnp.zeros(samples)
    for n, (low, high) in enumerate(((300, 900), (900, 2400), (2300, 3500))):
        glide = jnp.sin(2 * math.pi * (1 + 4 * u[2 + n]) * time + 6 * u[5 + n])
        formant = (low + high) / 2 + (high - low) / 2 * glide
        # A pulse's response: a damped oscillation since the last pulse.
        since = jnp.mod(phase, 1.0) / pitch
        sound += jnp.exp(-since * 80 * math.pi) * jnp.sin(2 * math.pi * formant * since) / (n + 1)
    hiss = jax.random.normal(keys[1], (samples,)) * 0.3
    voiced = jnp.sin(2 * math.pi * (2.5 * time + u[8])) > -0.3
    loud = 0.2 + jnp.abs(jnp.sin(2 * math.pi * (2.5 * time + u[8])))
    return jnp.where(voiced, sound, hiss) * loud


def damaged(key: jax.Array, samples: int) -> jax.Array:
    """A frame of which a part is replaced by the same part of another frame or by loud noise, in
    noise."""
    keys = jax.random.split(key, 6)
    said = words(keys[0], 2)
    first, second = acoustics.encode(said[0], 0), acoustics.encode(said[1], 0)
    ends = jnp.sort(jax.random.randint(keys[1], (2,), 240, acoustics.FRAME - 240))
    inside = (jnp.arange(acoustics.FRAME) >= ends[0]) & (jnp.arange(acoustics.FRAME) < ends[1])
    noise = jax.random.normal(keys[2], first.shape)
    other = jnp.where(jax.random.bernoulli(keys[3]), second, noise)
    level = noise_of(5.0) * jax.random.uniform(keys[4], maxval=1.3)
    sound = at(jnp.where(inside, other, first), jnp.int32(400), samples)
    return sound + level * jax.random.normal(keys[5], (samples,))


KINDS = {
    "noise": lambda key, samples: jax.random.normal(key, (samples,)),
    "speech-like": speech,
    "damaged frames": damaged,
}


@partial(jax.jit, static_argnames=("kind", "number"))
def false_words(key: jax.Array, kind: str, number: int) -> jax.Array:
    """Of 8 attempts in each of `number` sounds: wrong words accepted; wrong words that only the
    checksum refuses; wrong words with a right checksum."""

    def one(key: jax.Array) -> jax.Array:
        sound = KINDS[kind](key, 4000)
        found = acoustics.find(sound[None], 0)
        wrong = jnp.ones(found.valid.shape, bool)
        if kind == "damaged frames":
            said = words(jax.random.split(key, 6)[0], 2)
            wrong = ~(found.words[:, None] == said).all(-1).any(-1)
        gate = (found.quality >= acoustics.QUALITY_LEAST) & (found.sync >= acoustics.SYNC_LEAST)
        right = acoustics.unpack(found.words)[1]
        counts = [wrong & found.valid, wrong & gate, wrong & right, wrong]
        return jnp.stack([c.sum() for c in counts])

    return jax.lax.map(one, jax.random.split(key, number), batch_size=64).sum(0)


def curves(options: Options) -> list[dict[str, object]]:
    """All points: curve, x, frames, lost, wrong, low, high, theory."""
    key = jax.random.key(options.seed)
    rows: list[dict[str, object]] = []

    def point(curve: str, x: float, results: tuple, **theory: float) -> None:
        right, wrong = (np.asarray(r) for r in results[:2])
        lost = int((~right).sum())
        _, low, high = statistics.wilson(lost, len(right))
        rows.append(
            {"curve": curve, "x": x, "frames": len(right), "lost": lost, "wrong": int(wrong.sum()),
             "share": lost / len(right), "low": low, "high": high, **theory}
        )  # fmt: skip
        theories = "".join(f"  {name} {value:.2g}" for name, value in theory.items())
        share = f"{lost / len(right):.4f} ({low:.4f} to {high:.4f})"
        print(f"{curve:18s} {x:6.2f}  lost {share}{theories}", flush=True)

    n = options.frames
    for ebn0 in (4.0, 5.0, 5.5, 6.0, 6.5, 7.0, 8.0, 10.0, 12.0):
        results = in_noise(key, n, noise_of(ebn0), 0.0, 1)
        point("Eb/N0, dB", ebn0, results, bound=union_bound(ebn0), uncoded=uncoded(ebn0))
    for difference in (-6, -3, 0, 3, 6, 9, 12):
        results = in_noise(key, n, noise_of(15.0), 10 ** (-difference / 20), 0)
        point("same band, dB", difference, results)
    for difference in (-30, -25, -20, -15, -10, 0):
        results = in_noise(key, n, noise_of(15.0), 10 ** (-difference / 20), 1)
        point("other band, dB", difference, results)
    hall = jax.tree.map(jnp.float32, HALL)
    for distance in (0.3, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.3):
        point("distance, m", distance, on_field(key, n, hall, distance, jnp.inf))
    for critical in (0.5, 0.7, 1.0, 1.5, 2.0, 2.8):
        for time in (0.3, 1.2):
            here = dataclasses.replace(
                hall, critical_distance=critical, echo_time=jnp.float32(time)
            )
            point(f"echo {time} s, m", critical, on_field(key, n, here, 1.0, jnp.inf))
    for level in (50.0, 55.0, 60.0, 65.0, 70.0, 75.0):
        here = dataclasses.replace(hall, motors=jnp.float32(level))
        point("motors at 1 m, dB", level, on_field(key, n, here, 1.0, jnp.inf))
    for rival in (0.2, 0.3, 0.5, 1.0):
        point("rival, m", rival, on_field(key, n, hall, 2.0, rival))
    return rows


def reliability(options: Options) -> list[dict[str, object]]:
    """How often a frame is right, before its checksum is looked at, against what
    `acoustics.confidence` supposes: weak frames in noise, in much echo, among loud motors."""
    key = jax.random.key(options.seed + 1)
    hall = jax.tree.map(jnp.float32, HALL)
    echo = dataclasses.replace(hall, critical_distance=jnp.float32(0.7))
    loud = dataclasses.replace(hall, motors=jnp.float32(71.0))
    n = options.frames
    results = [in_noise(key, n, noise_of(ebn0), 0.0, 1) for ebn0 in (3.0, 4.0, 5.0, 6.0)]
    results += [on_field(key, n, echo, distance, jnp.inf) for distance in (1.0, 2.0)]
    results += [on_field(key, n, loud, 1.0, jnp.inf)]
    quality = np.concatenate([r[2] for r in results])
    right = np.concatenate([r[3] for r in results])
    supposed = 1 / (1 + np.exp(-acoustics.SLOPE * (quality - acoustics.EVEN)))
    # The curve that every other frame would choose, by maximum likelihood on a grid.
    slope, even = np.meshgrid(np.arange(10, 121, 5), np.linspace(0.6, 0.95, 71), indexing="ij")
    odds = slope[..., None] * (quality[::2] - even[..., None])
    likelihood = np.where(right[::2], -np.logaddexp(0, -odds), -np.logaddexp(0, odds)).sum(-1)
    best = np.unravel_index(likelihood.argmax(), likelihood.shape)
    print(f"confidence: half of the frames choose slope {slope[best]}, even at {even[best]:.3f}")
    rows: list[dict[str, object]] = []
    judged = np.arange(len(quality)) % 2 == 1
    for low, high in ((0, 0.01), (0.01, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 0.99), (0.99, 1.01)):
        here = judged & (supposed >= low) & (supposed < high)
        if here.any():
            _, below, above = statistics.wilson(int(right[here].sum()), int(here.sum()))
            means = {"supposed": float(supposed[here].mean()), "right": float(right[here].mean())}
            rows.append({**means, "low": below, "high": above, "frames": int(here.sum())})
            share = f"{means['right']:.3f} ({below:.3f} to {above:.3f}) of {int(here.sum())}"
            print(f"supposed {means['supposed']:.3f}  right {share}", flush=True)
    return rows


def fit(rows: list[dict[str, object]]) -> tuple[float, float]:
    """half (m, where half of the frames are lost) and width (m) of a logistic curve, by maximum
    likelihood on a grid."""
    points = [(float(r["x"]), int(r["lost"]), int(r["frames"]))  # type: ignore[call-overload, arg-type]
              for r in rows if r["curve"] == "distance, m"]  # fmt: skip
    x, lost, frames = np.array(points).T
    half, width = np.meshgrid(np.linspace(2.5, 12, 96), np.linspace(0.1, 2.5, 97), indexing="ij")
    share = 1 / (1 + np.exp(-(x - half[..., None]) / width[..., None]))
    share = np.clip(share, 1e-9, 1 - 1e-9)
    likelihood = (lost * np.log(share) + (frames - lost) * np.log(1 - share)).sum(-1)
    best = np.unravel_index(likelihood.argmax(), likelihood.shape)
    return round(float(half[best]), 2), round(float(width[best]), 3)


def draw(rows: list[dict[str, object]], path: Path) -> None:
    from matplotlib.figure import Figure

    names = {
        "white noise": ["Eb/N0, dB"],
        "distance, motors on": ["distance, m"],
        "critical distance of the echo, at 1 m": ["echo 0.3 s, m", "echo 1.2 s, m"],
        "motors' level, at 1 m": ["motors at 1 m, dB"],
        "second voice, level below ours": ["same band, dB", "other band, dB"],
        "opponent speaks nearby, mate at 2 m": ["rival, m"],
    }
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    for axes, (title, curves_) in zip(figure.subplots(2, 3).flat, names.items()):
        for curve in curves_:
            mine = [r for r in rows if r["curve"] == curve]
            x = np.array([r["x"] for r in mine], float)
            share, low, high = (
                np.array([r[k] for r in mine], float) for k in ("share", "low", "high")
            )
            axes.plot(x, share, "o-", ms=4, label=curve)
            axes.fill_between(x, low, high, alpha=0.2)
            if curve == "Eb/N0, dB":
                axes.plot(x, [r["bound"] for r in mine], "--", label="bound of the code")
                axes.plot(x, [r["uncoded"] for r in mine], ":", label="no code")
        axes.set(title=title, xlabel=curves_[0].split(" at")[0], ylabel="share of frames lost")
        axes.set_yscale("symlog", linthresh=1e-3)
        axes.set_ylim(0, 1.1)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)


def main() -> None:
    options = script.options(Options, __doc__, "experiments/communication.py")
    xla.configure()
    with script.folder(options.out):
        script.check_least(options, frames=8, attempts=512)
        content = 44 / (0.1 * SLOT)
        print(
            f"{content:.0f} bit/s of content, {64 / (0.1 * SLOT):.0f} with the checksum, in slots "
            f"of {0.1 * SLOT} s shared by three; oldest word {0.1 * SLOT * 4:.1f} s"
        )
        rows = curves(options)
        table(options.out / "communication.csv", rows)
        half, width = fit(rows)
        print(f"symbols: half lost at {half} m, width {width} m")
        document = {
            "format": "fntg-sound-symbols",
            "version": 1,
            "source": "experiments/communication.py: logistic curve of frames lost over distance, "
            "fitted to the audio level; duration of a message in s; half, width in m",
            "half": half,
            "width": width,
            "duration": 0.4,
        }
        write_atomically(
            options.out / "sound.json", (json.dumps(document, indent=2) + "\n").encode()
        )
        draw(rows, options.out / "communication.png")
        table(options.out / "reliability.csv", reliability(options))
        false = []
        for n, kind in enumerate(KINDS):
            key = jax.random.fold_in(jax.random.key(options.seed), n)
            counts = np.zeros(4, int)
            for part in range(math.ceil(options.attempts / 8 / 2048)):
                counts += np.asarray(false_words(jax.random.fold_in(key, part), kind, 2048))
            accepted, gate, right, wrong = (int(c) for c in counts)
            expected = gate / wrong / 2**20
            false.append({"sound": kind, "attempts": wrong, "accepted": accepted,
                          "pass_gate": gate, "checksum_right": right,
                          "expected_per_million": expected * 1e6})  # fmt: skip
            print(
                f"{kind}: {wrong} attempts without a right word, {accepted} accepted, "
                f"{gate} pass all but the checksum: {expected * 1e6:.2g} in a million expected",
                flush=True,
            )
        table(options.out / "false.csv", false)


def table(path: Path, rows: list[dict[str, object]]) -> None:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    script.write_csv(path, columns, [[row.get(name, "") for name in columns] for row in rows])


if __name__ == "__main__":
    main()
