"""Independent PPO in the match: robots that learn to score against robots that stand still.

    python -m experiments.ippo [--players 1] [--steps 10000000] [--seed 0] [--out runs/ippo]

The baseline that one would pick from elsewhere: every home robot is a PPO learner of its own senses
(one network for all of them), in PureJaxRL's shape.  The environment is
`envs.soccer.jaxmarl.Soccer`, which shows the truth; the away team gets the action 0, as the team
`still` acts.  Advantages: J. Schulman et al., "High-dimensional continuous control using
generalized advantage estimation", 2016, eq. 16; loss: "Proximal policy optimization algorithms",
2017, eq. 9.  Prints ten rows of the curve; writes ippo.csv and ippo.png.
"""

import dataclasses
import time
from collections import namedtuple
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
import tyro

from envs.field import FIELD
from envs.soccer.jaxmarl import Soccer
from experiments import script
from fntg_jax.running import xla
from fntg_jax.running.statistics import bootstrap_mean_of_counts


@dataclasses.dataclass(frozen=True)
class Options:
    """players: robots a side; steps: environment steps of training; minutes: of a half; seed: of
    networks, actions and matches; goal, progress, approach: rewards, see
    `envs.soccer.flat.rewards`; matches: played at once, and in the test; out: folder for
    ippo.csv and ippo.png."""

    players: int = 1
    steps: int = 10_000_000
    minutes: float = 0.5
    seed: int = 0
    goal: float = 5.0
    progress: float = 1.0
    approach: float = 0.5
    matches: int = 256
    out: Path | None = None

    @property
    def env(self) -> Soccer:
        rewards = self.goal, self.progress, self.approach
        return Soccer(*rewards, players=self.players, minutes=self.minutes)


LENGTH, MINIBATCHES, EPOCHS = 64, 4, 4  # steps of a roll-out; parts and repetitions of an update
DISCOUNT, LAMBDA, CLIP, ENTROPY, MOST_GRADIENT = 0.99, 0.95, 0.2, 0.003, 0.5
HIDDEN, ACTIONS, RATE = 64, 6, 1e-3  # RATE: of Adam, falling to 0
Sample = namedtuple("Sample", "seen action log_prob value reward done")


def features(seen):
    """[..., 9 + 4 n] as the environment tells it, and ball and goal in the robot's own frame."""
    x, y, c, s, bx, by, vx, vy = (seen[..., k] for k in range(8))
    own = lambda dx, dy: (c * dx + s * dy, c * dy - s * dx)  # noqa: E731
    ball, end = own(bx - x, by - y), 0.5 * FIELD.length
    goal, aim = own(end - x, -y), own(end - bx, -by)
    far = jnp.sqrt(ball[0] ** 2 + ball[1] ** 2 + 1e-6)
    more = (*ball, *own(vx, vy), *goal, *aim, ball[0] / far, ball[1] / far, jnp.exp(-5 * far))
    return jnp.concatenate([seen, jnp.stack(more, -1)], -1)


def network(key, inputs):
    """Actor and critic, two hidden layers each; a spread that depends on nothing."""

    def layers(key, last, scale):
        plan = ((inputs, HIDDEN, 2**0.5), (HIDDEN, HIDDEN, 2**0.5), (HIDDEN, last, scale))
        make, keys = jax.nn.initializers.orthogonal, jax.random.split(key, 3)
        return [(make(g)(k, (a, b)), jnp.zeros(b)) for k, (a, b, g) in zip(keys, plan)]

    one, other = jax.random.split(key)
    actor, critic = layers(one, ACTIONS, 0.01), layers(other, 1, 1.0)
    # Kicks and getting up take a second and more: they start as rare.
    actor[-1] = actor[-1][0], jnp.array([0.0, 0.0, 0.0, 0.0, -1.5, -1.5])
    return {"actor": actor, "critic": critic, "spread": jnp.full(ACTIONS, -0.5)}


def apply(net, seen):
    """Mean action [..., 6], logarithm of its spread [6], value [...]."""
    x = features(seen)

    def through(layers):
        (w1, b1), (w2, b2), (w3, b3) = layers
        return jnp.tanh(jnp.tanh(x @ w1 + b1) @ w2 + b2) @ w3 + b3

    return through(net["actor"]), net["spread"], through(net["critic"])[..., 0]


def log_prob(mean, spread, action):
    z = (action - mean) * jnp.exp(-spread)
    return jnp.sum(-0.5 * z * z - spread, -1)  # without the constant, which cancels


def loss(net, batch: Sample, advantage, target):
    mean, spread, value = apply(net, batch.seen)
    ratio = jnp.exp(log_prob(mean, spread, batch.action) - batch.log_prob)
    a = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    gain = jnp.minimum(ratio * a, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * a).mean()
    return -gain + 0.5 * jnp.mean((value - target) ** 2) - ENTROPY * jnp.sum(spread)


def advantages(samples: Sample, last):
    """Generalized advantage estimation, backwards; leaves [time, ...]."""

    def back(carry, s):
        gae, after = carry
        kept = DISCOUNT * (1 - s.done)
        gae = s.reward + kept * after - s.value + kept * LAMBDA * gae
        return (gae, s.value), gae

    _, found = jax.lax.scan(back, (jnp.zeros_like(last), last), samples, reverse=True)
    return found


def act(env: Soccer, home):
    """The home team's actions [n, 6] as a dictionary; the others stand still."""
    return dict(zip(env.agents, jnp.concatenate([home, jnp.zeros_like(home)])))


def rows(env: Soccer, named):
    return jnp.stack([named[a] for a in env.agent_classes["home"]])


def make_train(o: Options):
    """begin: key -> runner; update: runner -> (runner, (reward, goals, conceded)); how many."""
    env = o.env
    updates = max(o.steps // (o.matches * LENGTH), 1)
    schedule = optax.linear_schedule(RATE, 0.0, updates * EPOCHS * MINIBATCHES)
    adam = optax.chain(optax.clip_by_global_norm(MOST_GRADIENT), optax.adam(schedule, eps=1e-5))

    def begin(key):
        key, one, other = jax.random.split(key, 3)
        seen, state = jax.vmap(env.reset)(jax.random.split(one, o.matches))
        seen = jnp.stack([seen[a] for a in env.agent_classes["home"]], 1)
        net = network(other, features(seen).shape[-1])
        return net, adam.init(net), state, seen, key

    def one_match(key, state, home):
        seen, after, reward, done, _ = env.step(key, state, act(env, home))
        scored = after.statistics.goals - state.statistics.goals
        over = done["__all__"]  # and a new match has begun
        return rows(env, seen), after, rows(env, reward), over, scored * ~over

    def update(runner):
        net, memory, state, seen, key = runner

        def play(carry, _):
            state, seen, key = carry
            key, noise_key, step_key = jax.random.split(key, 3)
            mean, spread, value = apply(net, seen)
            action = mean + jnp.exp(spread) * jax.random.normal(noise_key, mean.shape)
            keys = jax.random.split(step_key, o.matches)
            then, state, reward, over, scored = jax.vmap(one_match)(keys, state, action)
            done = jnp.broadcast_to(over[:, None], reward.shape).astype(jnp.float32)
            sample = Sample(seen, action, log_prob(mean, spread, action), value, reward, done)
            return (state, then, key), (sample, scored)

        carry = state, seen, key
        (state, seen, key), (samples, scored) = jax.lax.scan(play, carry, None, length=LENGTH)
        gae = advantages(samples, apply(net, seen)[2])
        data = samples, gae, gae + samples.value
        flat = jax.tree.map(lambda a: a.reshape(-1, *a.shape[3:]), data)

        def learn(carry, key):
            order = jax.random.permutation(key, flat[1].shape[0])
            parts = jax.tree.map(lambda a: a[order].reshape(MINIBATCHES, -1, *a.shape[1:]), flat)

            def part(carry, batch):
                net, memory = carry
                change, memory = adam.update(jax.grad(loss)(net, *batch), memory, net)
                return (optax.apply_updates(net, change), memory), None

            return jax.lax.scan(part, carry, parts)[0], None

        key, *keys = jax.random.split(key, EPOCHS + 1)
        (net, memory), _ = jax.lax.scan(learn, (net, memory), jnp.stack(keys))
        return (net, memory, state, seen, key), (samples.reward.mean(), *scored.sum((0, 1)))

    return begin, update, updates


def test(o: Options, net, key):
    """Goals [matches, 2] of whole matches, the mean action played."""
    env = o.env

    def one(key):
        def step(carry, _):
            seen, state = carry
            return env.step_env(key, state, act(env, apply(net, rows(env, seen))[0]))[:2], None

        (_, state), _ = jax.lax.scan(step, env.reset(key), None, length=env.match.steps)
        return state.statistics.goals

    return jax.vmap(one)(jax.random.split(key, o.matches))


def run(o: Options) -> tuple[list, dict]:
    """The curve's rows (steps, seconds, reward, goals, conceded) and what a test came to."""
    script.check_least(o, steps=1, matches=1, seed=0)
    begin, update, updates = make_train(o)
    one, other = jax.random.split(jax.random.key(o.seed))
    runner = jax.jit(begin)(one)
    learn = jax.jit(update, donate_argnums=0).lower(runner).compile()
    curve, start = [], time.perf_counter()
    for n in range(updates):
        runner, log = learn(runner)
        curve.append([(n + 1) * o.matches * LENGTH, time.perf_counter() - start, *map(float, log)])
    after = np.asarray(jax.jit(lambda net: test(o, net, other))(runner[0]))
    found = {"steps": curve[-1][0], "seconds": curve[-1][1], "goals": float(after[:, 0].mean())}
    interval = bootstrap_mean_of_counts(after[:, 0])
    return curve, {**found, "goals_interval": interval, "conceded": float(after[:, 1].mean())}


def draw(curve: list, o: Options, path: Path) -> None:
    from matplotlib.figure import Figure

    steps, _, _, goals, own = np.asarray(curve).T
    rate = 600 / (o.matches * LENGTH)  # of goals a minute of play
    axes = (figure := Figure(figsize=(6, 3.6), layout="constrained")).subplots()
    axes.plot(steps / 1e6, goals * rate, steps / 1e6, own * rate)
    axes.set(xlabel="environment steps, million", ylabel="goals a minute of play")
    axes.legend(["scored", "conceded"], title=f"independent PPO, {o.players} a side")
    figure.savefig(path, dpi=150)


def main(argv: list[str] | None = None) -> None:
    o = tyro.cli(Options, args=argv)
    xla.configure()
    header = "steps", "seconds", "reward", "goals", "conceded"
    with script.folder(o.out or Path()):
        curve, found = run(o)
        if o.out:
            script.write_csv(o.out / "ippo.csv", header, curve)
            draw(curve, o, o.out / "ippo.png")
    print(" ".join(f"{name:>10s}" for name in header))
    for row in curve[:: -(-len(curve) // 10)]:
        print(" ".join(f"{x:10.4g}" for x in row))
    print(found)


if __name__ == "__main__":
    main()
