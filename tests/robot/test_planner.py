import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs.base import SEEN
from fntg_jax.robot import genes, local_map, planner
from fntg_jax.robot.genes import DEFAULTS, GENES, Genes
from fntg_jax.robot.messages import Displacement, Heard, Pose, Seen

KICKS = planner.Kicks(*(jnp.asarray([x]) for x in (0.0, 1.0, 2.0, 0.11, 0.19, -0.06, 0.06)))
NOBODY = Heard(*(jnp.zeros(2) for _ in range(5)), jnp.zeros(2, int), jnp.full(2, 99.0))


def pose(x=0.0, y=0.0, heading=0.0):
    return Pose(*(jnp.asarray(v) for v in (x, y, np.cos(heading), np.sin(heading), 0.02, 0.02)))


def with_ball(x, y, velocity=(0.0, 0.0)):
    """A map that knows of a ball at x, y of the robot's frame."""
    empty = local_map.empty()
    far = np.hypot(x, y)
    put = lambda a, v: a.at[0].set(v)  # noqa: E731
    return empty._replace(
        distance=put(empty.distance, far),
        cos=put(empty.cos, x / far),
        sin=put(empty.sin, y / far),
        age=put(empty.age, 0.0),
        velocity=jnp.asarray(velocity),
    )


def decide(memory, where, shirt=1, heard=NOBODY, role=planner.ATTACKER, held=0.0, waits=False):
    f = planner.facts(
        memory,
        where,
        heard,
        jnp.asarray(role),
        jnp.asarray(shirt),
        DEFAULTS,
        KICKS,
        planner.Ground(),
        (jnp.asarray(0.9), jnp.asarray(0.0)),
        jnp.asarray(True),
        jnp.asarray(waits),
        jnp.asarray(held),
        0.1,
    )
    order, rule = planner.decide(f, DEFAULTS)
    return f, int(order.behavior), order.need, planner.RULES[int(rule)].text


def test_the_tables_names_are_the_fields():
    assert tuple(g.name for g in GENES) == Genes._fields
    assert all(g.low <= g.default <= g.high for g in GENES)
    with pytest.raises(ValueError, match="gene near = 99"):
        genes.check(DEFAULTS._replace(near=99.0))


def test_a_ball_far_ahead_before_the_goal_is_intercepted():
    f, behavior, need, _ = decide(with_ball(0.8, 0.0), pose())
    assert behavior == 7 and int(f.role) == planner.ATTACKER
    assert float(need.d_ball) == pytest.approx(0.8, abs=0.02)


def test_a_ball_behind_is_approached_from_its_other_side():
    # The robot stands between ball and opponents' goal: it must go past the ball, not to it.
    _, behavior, need, _ = decide(with_ball(-0.6, 0.0), pose(0.4, 0.0))
    assert behavior == 7
    assert float(need.d_ball * abs(jnp.sin(need.ball))) > 0.9 * DEFAULTS.behind


def test_a_ball_in_the_kicks_zone_is_kicked_at_the_goal_only():
    assert decide(with_ball(0.15, 0.0), pose(0.5, 0.0))[1] == 6
    assert decide(with_ball(0.15, 0.0), pose(0.5, 0.0, np.pi))[1] != 6


def opponent(memory, x, y, place=0):
    """A map with an opponent at x, y of the robot's frame."""
    n, far = local_map.OPPONENTS[place], np.hypot(x, y)
    put = lambda a, v: a.at[n].set(v)  # noqa: E731
    return memory._replace(
        distance=put(memory.distance, far),
        cos=put(memory.cos, x / far),
        sin=put(memory.sin, y / far),
        age=put(memory.age, 0.0),
    )


def test_the_ball_goes_past_a_goalkeeper_not_through_it():
    where = pose(0.5, 0.0)
    blocked = opponent(with_ball(0.15, 0.0), 0.7, 0.0)
    assert decide(blocked, where)[1] != 6
    aim = float(decide(blocked, where)[0].aim)
    assert 0.1 < abs(aim) < 0.3  # beside it, within the mouth
    assert abs(float(decide(with_ball(0.15, 0.0), where)[0].aim)) < 1e-3


def test_a_kick_that_would_roll_into_the_own_goal_is_not_made():
    assert decide(with_ball(0.15, 0.0), pose(-1.0, 0.0, np.pi))[1] != 6


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_at_a_side_wall_the_robot_comes_from_the_inside_and_kicks_into_it(up):
    f = decide(with_ball(0.6, up * 0.85), pose(-0.6, 0.0))[0]  # the ball at (0, +-0.85)
    assert bool(f.at_wall) and np.sign(float(f.aim)) == up
    near = pose(-0.13, up * 0.78, up * 0.5)
    assert decide(with_ball(0.15, 0.0), near)[1] == 6


def test_a_ball_that_lies_at_the_chest_too_long_is_left():
    turned = pose(-1.0, 0.0, np.pi)  # nothing to kick at
    _, behavior, need, _ = decide(with_ball(0.15, 0.0), turned, held=3.0)
    assert behavior == 4 and float(need.distance) < 0


def test_the_others_kick_off_is_awaited():
    assert decide(with_ball(0.4, 0.0), pose(-0.4, 0.0), waits=True)[1] == 1
    assert decide(with_ball(0.4, 0.0), pose(-0.4, 0.0))[1] == 7


def test_field_players_keep_out_of_their_own_penalty_area():
    f, behavior, _, _ = decide(with_ball(0.6, 0.0), pose(-1.9, 0.0))
    assert bool(f.barred) and behavior == 7
    f = decide(with_ball(0.6, 0.0), pose(-0.7, 0.0, np.pi))[0]  # the ball at x = -1.3
    assert float(f.d_approach) < 0.4


def test_robots_keep_their_places_on_the_map_whatever_the_picture_calls_them():
    memory = opponent(opponent(local_map.empty(), 1.0, 0.0, 0), 0.5, 0.9, 1)
    # The second one is now the only one in sight, and so the first of the picture.
    n = local_map.OPPONENTS[0]
    put = lambda a, v: a.at[n].set(v)  # noqa: E731
    zero = jnp.zeros(len(SEEN))
    seen = Seen(
        put(zero + 1, np.hypot(0.5, 0.9)),
        put(zero + 1, 0.5 / np.hypot(0.5, 0.9)),
        put(zero, 0.9 / np.hypot(0.5, 0.9)),
        put(zero.astype(bool), True),
        zero + 0.1,
    )
    found = local_map.sighted(memory, seen, 0.1)
    places = np.array(found.distance[n : n + 2])
    np.testing.assert_allclose(places, [1.0, np.hypot(0.5, 0.9)], atol=1e-3)


def test_a_lost_ball_is_looked_for():
    _, behavior, need, text = decide(local_map.empty(), pose())
    assert "lost" in text and behavior == 3 and float(need.ball) != 0


def test_the_nearer_robot_attacks_and_silence_does_not_matter():
    near = NOBODY._replace(
        x=jnp.asarray([0.7, 0.0]), age=jnp.asarray([0.5, 99.0]), role=jnp.asarray([1, 1])
    )
    assert int(decide(with_ball(0.8, 0.0), pose(), heard=near)[0].role) == planner.SUPPORTER
    old = near._replace(age=jnp.full(2, 30.0))
    assert int(decide(with_ball(0.8, 0.0), pose(), heard=old)[0].role) == planner.ATTACKER


def test_the_goalkeeper_steps_to_where_the_ball_comes_in():
    keeper = pose(-1.24, 0.0)
    for side in (1.0, -1.0):
        _, behavior, need, _ = decide(with_ball(1.0, 0.0, (-0.8, side * 0.1)), keeper, shirt=0)
        assert behavior == 8 and np.sign(float(need.distance)) == -side


def test_rules_in_words_name_the_genes_values():
    words = planner.in_words(DEFAULTS._replace(near=0.4321))
    assert len(words) == len(planner.RULES) and any("0.432" in text for text in words)


def test_the_map_turns_and_moves_with_the_robot():
    memory = with_ball(1.0, 0.0)
    turn = jnp.cos(0.5), jnp.sin(0.5)
    found = local_map.moved(memory, Displacement(0.1, 0.0, 0.5), turn, 0.1)
    x, y = 0.9 * np.cos(0.5), -0.9 * np.sin(0.5)
    got = found.distance[0] * jnp.stack([found.cos[0], found.sin[0]])
    np.testing.assert_allclose(got, [x, y], atol=1e-6)
    assert found.sd[0] > memory.sd[0] or memory.sd[0] == local_map._UNKNOWN


def test_a_rolling_balls_velocity_is_learnt_from_pictures():
    memory, dt = with_ball(1.0, 0.0), 0.1
    memory = memory._replace(sd=memory.sd.at[0].set(0.05))
    none = Displacement(*jnp.zeros(3)), (jnp.asarray(1.0), jnp.asarray(0.0))
    step = jax.jit(
        lambda m, x: local_map.sighted(
            local_map.moved(m, *none, dt),
            Seen(
                jnp.ones(len(SEEN)).at[0].set(x),
                jnp.ones(len(SEEN)),
                jnp.zeros(len(SEEN)),
                jnp.zeros(len(SEEN), bool).at[0].set(True),
                jnp.full(len(SEEN), 0.03),
            ),
            dt,
        )
    )
    for n in range(1, 26):
        memory = step(memory, 1.0 - 0.03 * n)
    assert float(memory.velocity[0]) == pytest.approx(-0.3, abs=0.12)


def test_a_teammates_ball_is_believed_when_ones_own_is_old():
    memory = local_map.empty()
    heard = NOBODY._replace(
        ball_x=jnp.asarray([0.5, 0.0]), ball_y=jnp.asarray([0.2, 0.0]), age=jnp.asarray([0.3, 99.0])
    )
    found = local_map.told(memory, heard, pose(0.0, 0.0, np.pi / 2), 4.0)
    got = found.distance[0] * jnp.stack([found.cos[0], found.sin[0]])
    np.testing.assert_allclose(got, [0.2, -0.5], atol=0.03)
    assert float(found.age[0]) == pytest.approx(0.3)
