"""`fntg refine`: an exported controller's genes made better, along gradients or by CMA-ES."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from envs.base import Environment, World
from fntg_jax.commands.cli import load_controller, parse, say
from fntg_jax.running import registry, xla


@dataclasses.dataclass(frozen=True)
class RefineOptions:
    """Start from a controller's genes, descend along the gradient through its trials or adapt a
    cloud of samples (CMA-ES), and write the best iterate on validation scenes; where none is better
    than the start, the start.  How often it succeeds on held-out scenes before and after goes to
    stderr."""

    controller: Annotated[Path, tyro.conf.Positional]
    """params.json, an exported .fll, or a run folder."""
    out: Path = Path("refined.json")
    """file to write, in the exchange format (`fntg export` makes others of it)."""
    method: Literal["gradient", "cma"] = "gradient"
    """gradient: cheap and local; cma: 192 samples a step, passes the jumps of the roll-out."""
    steps: int = 300
    """steps of the method."""
    rate: float = 0.003
    """gradient: learning rate at the start, falling to 5 % of it."""
    optimizer: str = "adam"
    """gradient: an optax optimizer by name: adam, sgd, rmsprop, lion, ..."""
    sigma: float = 0.5
    """cma: first step size, in genes."""
    suite: str = "open:2,blocked:3"
    """training and validation scenes: a suite, or several with their shares."""
    scenes: int = 128
    """training scenes a step."""
    seed: int = 0
    """seed of these scenes."""
    env: str = "kinematic"
    """world, by its entry point name; for --method gradient one that has a gradient."""
    env_options: dict[str, float] = dataclasses.field(default_factory=dict)
    """options of that world by name, over the controller's own limits and control step."""


def main(argv: list[str]) -> None:
    options = parse(RefineOptions, argv, "refine")
    for name, most in (("steps", 100_000), ("scenes", 16384)):
        if not 1 <= getattr(options, name) <= most:
            value = getattr(options, name)
            raise ValueError(f"{name} = {value}: allowed are whole numbers from 1 to {most}")
    for name, most in (("rate", 1), ("sigma", 5)):
        if not 0 < getattr(options, name) <= most:
            value = getattr(options, name)
            raise ValueError(f"{name} = {value}: allowed are numbers above 0, up to {most}")
    if not 0 <= options.seed < 2**32:
        raise ValueError(f"seed = {options.seed}: allowed are whole numbers from 0 below 2^32")
    if not options.out.parent.is_dir() or options.out.is_dir():
        raise ValueError(f"out = {options.out}: allowed is a file in a folder that exists")
    xla.configure()
    import jax
    import jax.numpy as jnp
    import numpy as np

    from fntg_jax import export
    from fntg_jax.files import writing
    from fntg_jax.learning import cma, gradient, objective
    from fntg_jax.learning.rollout import EPISODE_STEPS
    from fntg_jax.running import evaluation

    controller = load_controller(options.controller)
    world = registry.get_world(options.env)
    by_gradient = options.method == "gradient"
    if by_gradient and not world.differentiable:
        raise ValueError(
            f"method = gradient: world {options.env} has no gradient worth following; take "
            "--method cma"
        )
    suite = registry.get_suite(world, options.suite)
    optimiser = gradient.optimiser(options.optimizer, options.steps, options.rate)
    env = evaluation.environment_for(controller, world, **options.env_options)
    # Checkpointed: reverse mode then stores one state a control step.
    problem = objective.smooth_descent(
        controller.layout,
        env,
        suite,
        options.scenes,
        controller.output,
        options.seed,
        checkpoint=by_gradient,
    )
    trials = options.scenes * (1 if by_gradient else cma.POPULATION)
    say(
        f"{options.steps} steps of {options.optimizer if by_gradient else 'CMA-ES'} on "
        f"{options.scenes} scenes each ({options.suite}), world {options.env}: "
        f"{trials * EPISODE_STEPS / 1e6:.2g} million control steps a step; compiling takes a "
        "while ..."
    )
    key = jax.random.key(options.seed)

    def descend(theta):
        found = gradient.refine(key, theta[None], *problem, optimiser, options.steps)
        return jax.tree.map(lambda x: x[0], found)

    def adapt(theta):
        return cma.adapt(key, theta, *problem, options.steps, options.sigma)

    program = (
        jax.jit(descend, compiler_options=xla.GRADIENT_OPTIONS) if by_gradient else jax.jit(adapt)
    )
    refined = program(jnp.asarray(controller.theta, jnp.float32))
    refined = jax.tree.map(np.asarray, refined)
    before, after = float(refined.history[0]), float(refined.cost)
    num_validation = jax.tree.leaves(problem.validation)[0].shape[0]
    if refined.num_skipped:
        what = "steps skipped: gradient" if by_gradient else "samples skipped: cost"
        say(f"{refined.num_skipped} {what} not finite")
    say(f"mean cost on {num_validation} validation scenes: {before:.5g} before, {after:.5g} after")
    better = after < before
    if better:
        result = _refined(controller, refined, options)
        _compare(controller, result, world, env)
    else:
        result = controller
        say("no iterate is better than the start: the controller is written as it was")
    with writing(options.out, "out"):
        export.save(result, options.out)
    print(options.out)


def _refined(controller: Any, refined: Any, options: RefineOptions) -> Any:
    """The controller with its new genes, and in its provenance how it came by them."""
    import numpy as np

    from fntg_jax.learning.fitness import from_cost

    provenance = {
        **{k: v for k, v in controller.provenance.items() if not k.startswith("refine_")},
        "env": options.env,
        "objective": "smooth",
        "fitness": from_cost(float(refined.cost)),
        "refine_method": options.method,
        "refine_steps": options.steps,
        **(
            {"refine_optimizer": options.optimizer, "refine_rate": options.rate}
            if options.method == "gradient"
            else {"refine_sigma": options.sigma}
        ),
        "refine_suite": options.suite,
        "refine_seed": options.seed,
    }
    return dataclasses.replace(
        controller, theta=refined.theta.astype(np.float64), bits=None, provenance=provenance
    )


def _compare(old: Any, new: Any, world: World, env: Environment) -> None:
    """Success on held-out scenes, from which nothing was learnt or chosen."""
    from fntg_jax.running import evaluation

    num_scenes = 2000
    say(f"success on {num_scenes} held-out scenes (95 % interval):")
    for name in evaluation.held_out_suites(world):
        was, now = (evaluation.evaluate(c, world, name, num_scenes, env=env) for c in (old, new))
        won = int((now.success & ~was.success).sum())
        lost = int((was.success & ~now.success).sum())
        rates = f"{was.rates['success']} before, {now.rates['success']} after"
        say(f"  {name:18s}{rates}: {won} scenes won, {lost} lost")
