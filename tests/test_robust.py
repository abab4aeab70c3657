"""What the robust preset adds: islands, decaying mutation, smooth cost, the final choice."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fntg_jax.controller import genome
from fntg_jax.controller.layout import get_layout
from fntg_jax.learning import fitness, ga, objective
from fntg_jax.learning.rollout import Outcome
from fntg_jax.running import final_choice, problem, runner, settings


def test_islands_do_not_mix():
    bits = jnp.repeat(jnp.asarray([False, True]), 20)[:, None] & jnp.ones((40, 60), bool)

    def bred(num_islands):
        config = ga.GAConfig(40, num_islands=num_islands, mutation_rate=0.0, num_elites=0)
        return np.asarray(ga.reproduce(jax.random.key(0), bits, jnp.ones(40), config))

    apart, together = bred(2), bred(1)
    assert not apart[:20].any() and apart[20:].all()
    assert together[:20].any() and not together[20:].all()


def test_mutation_decays_geometrically():
    config = ga.GAConfig(population=200, mutation_rate=0.2, mutation_decay=0.25, num_elites=0)
    bits = jnp.zeros((200, 500), bool)
    for progress, rate in ((0.0, 0.2), (0.5, 0.1), (1.0, 0.05)):
        flipped = ga.reproduce(jax.random.key(1), bits, jnp.ones(200), config, progress).mean()
        assert abs(flipped - rate) < 5 * math.sqrt(rate / 1e5)


def outcome(d=0.0, v=0.0, clearance=1.0, failed=False):
    three = lambda x: jnp.full(3, x)  # noqa: E731
    return Outcome(three(d), three(v), three(0.0), *map(jnp.asarray, (clearance, 0.2, failed)))


def test_smooth_cost_by_hand():
    assert fitness.smooth_cost(outcome()) == 0
    far = math.log1p((0.94 / 0.05) ** 2) + 0.5 * math.log1p((0.92 / 0.05) ** 2)
    np.testing.assert_allclose(fitness.smooth_cost(outcome(d=1.0)), far, rtol=1e-6)
    moving = math.log1p((0.08 / 0.01) ** 2)
    np.testing.assert_allclose(fitness.smooth_cost(outcome(v=0.1)), moving, rtol=1e-6)
    # Stopping counts half at the gate.
    at_gate = outcome(d=0.4, v=0.1)
    alone = fitness.smooth_cost(outcome(d=0.4))
    np.testing.assert_allclose(fitness.smooth_cost(at_gate) - alone, moving / 2, rtol=1e-5)
    np.testing.assert_allclose(fitness.smooth_cost(outcome(clearance=0.06)), 10, rtol=1e-5)
    # Arriving without stopping beats standing still far away: no local optimum of doing nothing.
    arrived = fitness.smooth_cost(outcome(d=0.05, v=0.05))
    assert 2 * arrived < fitness.smooth_cost(outcome(d=1.0))
    assert np.isfinite(fitness.smooth_cost(outcome(failed=True)))


def test_what_costs_nothing_succeeds():
    """The thresholds of the smooth cost lie inside those of success, and not by much."""
    free = outcome(d=0.06, v=0.02, clearance=0.16)
    assert fitness.smooth_cost(free) == 0 and fitness.success(free).success
    for worse in (outcome(d=0.11), outcome(v=0.031), outcome(clearance=0.144)):
        assert fitness.smooth_cost(worse) > 0 and not fitness.success(worse).success


def test_a_partition_starts_with_labels_that_divide_their_input():
    layout = get_layout("paper-31")
    config = ga.GAConfig(population=200, gray=True)
    state = ga.init(jax.random.key(0), layout.num_genes, config, layout.partition)
    theta = np.asarray(genome.decode(state.bits, config.num_bits, config.gray))
    low, high = layout.partition.T
    step = 10 / 32767
    assert (theta >= low - step).all() and (theta <= high + step).all()
    names = [g.name for g in layout.genes]
    genes = dict(zip(names, theta.T))
    assert (genes["a_B1"] < 0).all() and (genes["a_B2"] > 0).all()  # near falls, far rises
    assert (abs(np.median(theta, axis=0) - (low + high) / 2) < 0.2 * (high - low)).all()
    # Rule constants start anywhere.
    assert genes["V_121"].min() < -4.5 and genes["V_121"].max() > 4.5


def test_the_final_controller_is_the_best_of_its_population_on_validation_scenes(monkeypatch):
    monkeypatch.setattr(problem, "VALIDATION", 64)
    config = dataclasses.replace(
        settings.PRESETS["robust"],
        ga=dataclasses.replace(settings.PRESETS["robust"].ga, population=64),
        generations=2,
        num_scenes=4,
        scene_pool=16,
        seeds=2,
        refine_steps=0,
    )
    run = runner.train(config)
    result, again = run.conclude(), run.conclude()
    np.testing.assert_array_equal(result.theta, again.theta)
    scenes = run.validation
    static, traced = run.problem.static, run.problem.traced()
    value = jax.jit(lambda theta: objective.score(static, traced, theta, scenes))
    for n in range(2):
        theta = genome.decode(run.now.population.bits[n], 15, True)
        scores = value(theta)
        np.testing.assert_allclose(result.fitness[n], scores.max(), rtol=1e-4)
        np.testing.assert_allclose(result.theta[n], theta[scores.argmax()], atol=1e-6)


def test_the_first_look_at_a_population_is_on_every_suite_of_the_mix():
    suites = np.repeat([0, 1], [819, 1229])  # validation scenes come suite by suite
    seen = final_choice._spread(suites)
    assert len(seen) == 256 and (seen == 0).sum() == 103
    np.testing.assert_array_equal(final_choice._spread(np.arange(3)), np.arange(3))


def test_refinement_on_few_fixed_scenes_is_validated_on_others():
    config = settings.TrainConfig(suite="open", refine_steps=10)
    run = runner.Run(problem.resolve(config))
    assert len(run.scenes.start) == 4 and len(run.validation.start) == 2048
    assert not (np.asarray(run.scenes.start)[:, None] == run.validation.start).all(-1).any()
    # The paper has its four starts and no others.
    run = runner.Run(problem.resolve(dataclasses.replace(config, suite="paper")))
    assert run.validation is run.scenes


def barely_evolved(**options):
    """The preset robust at a tiny budget."""
    robust = settings.PRESETS["robust"]
    return dataclasses.replace(
        robust,
        ga=dataclasses.replace(robust.ga, population=32),
        generations=2,
        num_scenes=4,
        scene_pool=64,
        refine_scenes=16,
        **options,
    )


def test_covariance_adaptation_continues_from_the_best_of_the_population(monkeypatch):
    monkeypatch.setattr(problem, "VALIDATION", 64)
    config = barely_evolved(seeds=2, refine_steps=90, refine_top=2)
    plain = runner.train(dataclasses.replace(config, refine_steps=0)).conclude()
    shown = []
    result = runner.train(config).conclude(lambda *progress: shown.append(progress))
    assert [done for done, _, _ in shown] == [20, 30, 50, 60, 80, 100, 120]
    assert {total for _, total, _ in shown} == {120}
    best = [best for _, _, best in shown]
    assert best == sorted(best) and best[-1] == pytest.approx(np.median(result.fitness))
    assert result.refined.shape == (2, 6)  # the start, and five validations
    # The course is that of the island which wins; it need not have led before.
    assert (result.refined[:, 0] <= plain.fitness * (1 + 1e-4)).all()
    np.testing.assert_array_equal(result.fitness, result.refined.max(axis=1))
    # By half at least: balls at walls are hard for a population that has barely evolved.
    assert (result.fitness > 1.5 * plain.fitness).all()
    assert (abs(result.theta) <= 5).all() and result.bits is None


def test_validation_scenes_are_a_share_of_every_suite_and_not_trained_on(monkeypatch):
    monkeypatch.setattr(problem, "VALIDATION", 50)
    config = dataclasses.replace(barely_evolved(), suite="open:3,blocked:2", scene_pool=450)
    run = runner.Run(problem.resolve(config))
    pool, held = (np.asarray(s.start) for s in (run.scenes, run.validation))
    assert pool.shape == (450, 3) and held.shape == (50, 3)
    assert not (pool[:, None] == held).all(axis=-1).any()
    # The obstacle of a blocked scene is within 0.145 m of the line from start to ball.
    s = run.validation
    line = np.asarray(s.ball) - s.start[:, :2]
    to = np.asarray(s.obstacles)[:, 0, :2] - s.start[:, :2]
    off = abs(line[:, 0] * to[:, 1] - line[:, 1] * to[:, 0]) / np.hypot(*line.T)
    assert (off[30:] <= 0.145 + 1e-5).all() and (off[:30] > 0.145).mean() > 0.5


@pytest.mark.slow
def test_gradients_continue_from_the_best_of_the_population(monkeypatch):
    monkeypatch.setattr(problem, "VALIDATION", 64)
    config = barely_evolved(refine_method="gradient", refine_steps=20, refine_rate=0.01)
    plain = runner.train(dataclasses.replace(config, refine_steps=0)).conclude()
    result = runner.train(config).conclude()
    assert result.refined.shape == (1, 3)  # the start, and a validation after each 10 steps
    assert result.fitness[0] == pytest.approx(result.refined[0].max(), rel=1e-5)
    assert result.fitness[0] > plain.fitness[0]
