import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

from envs.field import FIELD  # noqa: E402
from envs.quadruped import constants as c  # noqa: E402
from envs.quadruped import mjcf  # noqa: E402
from envs.quadruped.physics import Solver, compile_model  # noqa: E402


@pytest.fixture(scope="module")
def lean():
    return compile_model(mjcf.LEAN, Solver())


@pytest.fixture(scope="module")
def full():
    # One Newton iteration leaves forces that do not belong to the accelerations.
    return compile_model(mjcf.FULL, Solver(impl="jax", iterations=20, ls_iterations=20))


def test_full_has_the_papers_seventeen_joints_with_limits(full):
    hinges = [full.joint(i) for i in range(full.njnt) if full.jnt_type[i] == 3]
    assert len(hinges) == 17
    assert full.nu == 17
    for joint in hinges:
        low, high = joint.range
        assert low < 0 < high, joint.name
    assert np.allclose(np.degrees(full.joint("lf_j3").range), (-27, 147))
    assert np.allclose(np.degrees(full.joint("head_tilt").range), (-82, 43))


def test_masses_and_inertias_of_both_variants_add_up(lean, full):
    assert lean.body_mass.sum() == pytest.approx(c.MASS, abs=1e-6)
    assert full.body_subtreemass[full.body("trunk").id] == pytest.approx(c.MASS, abs=1e-6)
    assert 1.35 <= c.MASS <= 1.5
    inertia = []
    for model in (lean, full):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        dense = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, dense)
        inertia.append(dense[:18, :18])
    # The head and tail that lean locks weigh as much in full, hanging at zero: the same matrix.
    armature = np.max(np.abs(inertia[0] - inertia[1]))
    assert armature < 1e-6 * np.max(inertia[0]) + 1e-7


def test_lean_is_a_prefix_of_full(lean, full):
    assert (lean.nq, lean.nv, lean.nu) == (19, 18, 12)
    for i in range(lean.njnt):
        assert lean.joint(i).name == full.joint(i).name
        assert lean.jnt_qposadr[i] == full.jnt_qposadr[i]
    for i in range(lean.nu):
        assert lean.actuator(i).name == full.actuator(i).name


def test_lean_touches_the_floor_with_feet_and_elbows_only(lean):
    names = {lean.geom(g).name for g in lean.pair_geom2}
    assert names == {f"{leg}_{part}" for leg in c.LEGS for part in ("foot", "elbow")}
    assert lean.npair == 8
    collides = lean.geom_contype.astype(bool) & lean.geom_conaffinity.astype(bool)
    assert not collides.any()


def test_every_joint_has_limits_a_torque_and_dry_friction(lean, full):
    for model in (lean, full):
        legs = slice(6, 18)
        assert model.jnt_limited[1:13].all() and model.actuator_forcelimited.all()
        np.testing.assert_allclose(model.actuator_forcerange[:12], [[-1.5, 1.5]] * 12)
        assert (model.dof_frictionloss[legs] > 0).all() and (model.dof_armature[legs] > 0).all()
    # P per joint in the ratios of Sony's table.
    gains = full.actuator_gainprm[:12, 0].reshape(4, 3)
    np.testing.assert_allclose(gains / gains[:, :1], np.array([[22, 20, 35]] * 4) / 22)


def test_legs_have_their_share_of_the_mass():
    legs = 4 * (c.MASS_SHOULDER + c.MASS_UPPER + c.MASS_LOWER)
    assert legs / c.MASS == pytest.approx(0.45)


def test_sensors_are_named(full):
    names = {full.sensor(i).name for i in range(full.nsensor)}
    assert {"base_position", "base_orientation", "gyro", "accelerometer"} <= names
    assert {f"{leg}_contact" for leg in c.LEGS} <= names


def test_feet_of_a_standing_dog_carry_its_weight(full):
    from envs.quadruped.locomotion import load_gait
    from envs.quadruped.physics import settled

    data = mujoco.MjData(full)
    pose = settled(load_gait(), Solver())
    data.qpos[:19] = pose
    data.ctrl[:12] = pose[7:]
    for _ in range(600):
        mujoco.mj_step(full, data)
    # 3 s: at rest, so the feet's contact forces are the weight.
    force = sum(float(data.sensor(f"{leg}_contact").data[0]) for leg in c.LEGS)
    assert force == pytest.approx(c.MASS * 9.81, rel=0.02)
    accelerometer = data.sensor("accelerometer").data
    assert np.linalg.norm(accelerometer) == pytest.approx(9.81, rel=0.01)


def test_field_has_goals_and_six_landmarks(full):
    names = {full.geom(i).name for i in range(full.ngeom)}
    assert {mark.name for mark in FIELD.landmarks} <= names
    assert {"wall_front", "wall_back", "wall_left", "wall_right", "ball"} <= names


def test_unknown_variant_is_refused():
    with pytest.raises(ValueError, match="variant = 'fat'"):
        mjcf.mjcf("fat")
