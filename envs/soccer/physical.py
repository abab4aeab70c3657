"""The match with walking dogs: MuJoCo moves the bodies, everything else is the match's own.

`Physical.step` is `Match.step_batch` for one match (batch axis of 1) whose bodies and ball are
those of one MuJoCo model in native C: gait, kicks and postures give set-points, and what the model
came to goes back into the state, for senses, sound and referee.  What the referee moves is moved in
the model.  All styles walk with the shipped gait, at the speeds that the body's table allows them;
a motion that no file describes is waited for, standing; who gets up is set on its feet at the end
of the time that the table allows for it.
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from envs.base import Action
from envs.quadruped import environment, motions, render
from envs.quadruped.environment import Quadruped, heading
from envs.quadruped.locomotion import SPEED, follow, limit, set_points
from envs.quadruped.native import rolling_resistance
from envs.soccer import ball as balls
from envs.soccer import bodies as walking
from envs.soccer import noise, physical_model, referee, sound
from envs.soccer.match import Match
from envs.soccer.state import KICKOFF, PLAY, RollingBall, State
from envs.soccer.trig import unturn

_CONTROLS = 17  # set-points of a dog: legs, head, tail
_MOVED = 1e-4  # m, from which on a body was moved by the referee


class Gaits(NamedTuple):
    """How the dogs walk, leaves [R, ...]: phase (turns), stride (v_x, v_y, omega), set-points."""

    phase: Any
    stride: Any
    set_points: Any


class Physical:
    """One match in MuJoCo.  state: `reset`, then `step` with actions [..., R, 1]."""

    def __init__(self, match: Match, env: Quadruped | None = None):
        if {match.home, match.away} != {"ers210"}:
            raise ValueError(f"body = {match.home!r}, {match.away!r}: only ers210 can walk here")
        self.match, self.env = match, env or environment.standing()
        solver = self.env.solver
        self.model = physical_model.build(match.field, match.robots, solver.timestep)
        self.data = mujoco.MjData(self.model)
        joint = lambda name: self.model.joint(name)  # noqa: E731
        own = [physical_model.prefix(r) for r in range(match.robots)]
        self._base = np.array([joint(p + "base").qposadr[0] for p in own])
        self._speed = np.array([joint(p + "base").dofadr[0] for p in own])
        self._head = np.array(
            [[joint(f"{p}head_{j}").qposadr[0] for j in ("tilt", "pan", "roll")] for p in own]
        )
        self._ball = joint("ball").qposadr[0], joint("ball").dofadr[0]
        self._ball_geom = self.model.geom("ball").id
        body = self.model.geom_bodyid
        root = self.model.body_rootid[body]
        trunks = [self.model.body(p + "trunk").id for p in own]
        self._robot_of = np.array([trunks.index(r) if r in trunks else -1 for r in root])
        self._rest = np.concatenate([np.asarray(self.env.rest), np.zeros(5)])
        standing = motions.standing(self.env)
        self._standing = standing
        table = match.bodies.home
        names = [*((f, k) for k, f in enumerate(table.kicks.name, 1))]
        names += [(f, walking.POSTURE + k) for k, f in enumerate(table.postures.name)]
        self._motions = {
            code: motions.set_points(motions.load(name, standing), solver.timestep)
            for name, code in names
            if (Path(motions.FOLDER) / f"{name}.json").exists()
        }
        self._before, self._after = jax.jit(self._plan), jax.jit(self._judge)
        self.poses: list[np.ndarray] = []
        self.keep = 0  # poses of a control step that are kept in `poses`

    def reset(self, kickoff: int, seed: int) -> State:
        """The kick-off, leaves [R, 1], with all dogs standing at their places."""
        state = self.match.reset(jnp.full(1, kickoff), jnp.full(1, seed))
        mujoco.mj_resetData(self.model, self.data)
        r, num = state.robots, self.match.robots
        self._gaits = Gaits(
            jnp.zeros(num), jnp.zeros((num, 3)), jnp.tile(jnp.asarray(self._rest[7:19]), (num, 1))
        )
        for k in range(num):
            self._put(k, float(r.x[k, 0]), float(r.y[k, 0]), float(r.cos[k, 0]), float(r.sin[k, 0]))
        self._put_ball(float(state.ball.x[0]), float(state.ball.y[0]))
        self.data.ctrl[:] = np.tile(self._standing, num)
        mujoco.mj_forward(self.model, self.data)
        self.poses = [self.data.qpos.copy()] if self.keep else []
        return state

    def step(self, state: State, action: Action) -> State:
        """0.1 s of play."""
        env, num = self.env, self.match.robots
        robots, gaits, told = self._before(state, action, self._gaits)
        doing, busy, legs, head = jax.device_get(told)
        ctrl = np.tile(self._standing, (env.solver.substeps, num, 1))
        ctrl[:, :, :12] = legs
        share = np.arange(1, env.solver.substeps + 1)[:, None, None] / env.solver.substeps
        was = self.data.ctrl.reshape(num, _CONTROLS)[:, 12:15]
        ctrl[:, :, 12:15] = was + share * (head - was)
        self._play_motions(doing, busy, ctrl)
        touched = self._integrate(ctrl.reshape(len(ctrl), -1))
        q, v = self.data.qpos, self.data.qvel
        if not (np.isfinite(q).all() and np.abs(v).max() < 1e4):
            raise RuntimeError("the model blew up")  # seen never; nothing may be judged on it
        at, ball_v = self._ball
        measured = (
            q[self._base[:, None] + np.arange(7)],
            v[self._speed[:, None] + np.arange(6)],
            q[self._head],
            np.array([*q[at : at + 2], *v[ball_v : ball_v + 2]]),
            touched,
        )
        given = tuple(np.asarray(x, x.dtype if x.dtype == bool else np.float32) for x in measured)
        new, moved = self._after(state, action, robots, gaits.stride, given)
        self._gaits = gaits
        self._obey(*jax.device_get(moved))
        return new

    def _play_motions(self, doing: np.ndarray, busy: np.ndarray, ctrl: np.ndarray) -> None:
        """Set-points of kicks and postures under way, over the legs' and head's."""
        steps = len(ctrl)
        table = self.match.bodies.home
        for k in range(self.match.robots):
            code, left = int(doing[k]), float(busy[k])
            points = self._motions.get(code)
            if points is None or left <= 0:
                continue
            index = code - walking.POSTURE
            duration = (
                table.postures.duration[index] if index >= 0 else table.kicks.duration[code - 1]
            )
            # `left` after this step.
            done = round((duration - left) / self.match.dt - 1) * steps
            rows = np.clip(np.arange(done, done + steps), 0, len(points) - 1)
            ctrl[:, k] = points[rows]

    def _integrate(self, ctrl: np.ndarray) -> np.ndarray:
        """The substeps of a control step; which robots [R] touched the ball."""
        model, data = self.model, self.data
        speed = self._ball[1]
        rolling = data.qvel[speed : speed + 2][None]
        resistance = rolling_resistance(rolling, float(self.env.ball_deceleration), self.env.dt)
        data.qfrc_applied[speed : speed + 2] = resistance[0]
        touched = np.zeros(self.match.robots, bool)
        kept = np.linspace(0, len(ctrl), self.keep + 1)[1:].round().astype(int) if self.keep else ()
        for n, row in enumerate(ctrl, start=1):
            data.ctrl[:] = row
            mujoco.mj_step(model, data)
            if n % 5 == 0 and data.ncon:
                pairs = data.contact.geom[: data.ncon]
                hits = pairs[(pairs == self._ball_geom).any(axis=1)]
                found = self._robot_of[hits]
                touched[found[found >= 0]] = True
            if n in kept:
                self.poses.append(data.qpos.copy())
        return touched

    def _obey(self, which: np.ndarray, places: np.ndarray, rolls: bool, ball: np.ndarray) -> None:
        """Move in the model what the referee, or a get-up, moved in the state: robots [R] to places
        [4, R] x, y, cos, sin; the ball to [2]."""
        for k in np.flatnonzero(which):
            self._put(int(k), *map(float, places[:, k]))
        if rolls:
            self._put_ball(*map(float, ball))

    def _put(self, robot: int, x: float, y: float, cos: float, sin: float) -> None:
        """Stand a dog somewhere."""
        rest, half = self._rest, 0.5 * np.arctan2(sin, cos)
        a, b = np.cos(half), np.sin(half)
        w, i, j, k = rest[3:7]
        turned = [a * w - b * k, a * i - b * j, a * j + b * i, a * k + b * w]
        q, v = self._base[robot], self._speed[robot]
        self.data.qpos[q : q + 24] = [x, y, rest[2], *turned, *rest[7:]]
        self.data.qvel[v : v + 23] = 0
        start = robot * _CONTROLS
        self.data.ctrl[start : start + _CONTROLS] = self._standing
        self._gaits = self._gaits._replace(
            stride=jnp.asarray(self._gaits.stride).at[robot].set(0.0),
            set_points=jnp.asarray(self._gaits.set_points).at[robot].set(rest[7:19]),
        )

    def _put_ball(self, x: float, y: float) -> None:
        at, speed = self._ball
        self.data.qpos[at : at + 7] = [x, y, self.match.field.ball_radius, 1, 0, 0, 0]
        self.data.qvel[speed : speed + 6] = 0

    # Compiled: what is planned before the physics, what is judged after it.

    def _plan(self, state: State, action: Action, gaits: Gaits):
        match, env, old = self.match, self.env, state.robots
        may = ((state.game.phase == PLAY) | (state.game.phase == KICKOFF)) & (old.out <= 0)
        key = noise.key(state.game.seed, state.game.tick, old.lane)
        robots, _, busy = walking.act(match.bodies, old, action, may, key, match.dt)
        able = may & ~busy & ~robots.fallen
        column = lambda name: match.bodies.column("styles", name, action.walk.style)  # noqa: E731
        v, v_y, omega = (
            jnp.where(able & (jnp.abs(x) < 1e3), x, 0.0)
            for x in (action.walk.v, action.walk.v_y, action.walk.omega)
        )
        most = jnp.where(v >= 0, column("forward"), column("backward"))
        shares = v / most, v_y / jnp.maximum(column("lateral"), 1e-6), omega / column("turn")
        scale = 1 / jnp.sqrt(jnp.maximum(sum(s * s for s in shares), 1.0))
        wanted = jnp.stack([v, v_y, omega], -1)[:, 0] * scale
        head = walking.nod(robots, action, match.head, able, match.dt)
        ticks = jnp.arange(env.solver.substeps) * env.solver.timestep

        def one(phase, stride, last, wanted):
            stride = follow(env.gait, stride, wanted, env.dt)
            points = set_points(env.gait, phase + ticks / env.gait.period, stride)
            most = env.servo_speed * env.solver.timestep * jnp.asarray(SPEED)
            return stride, limit(points, last, most)

        stride, points = jax.vmap(one)(gaits.phase, gaits.stride, gaits.set_points, wanted)
        turns = gaits.phase + env.dt / env.gait.period
        new = Gaits(turns - jnp.floor(turns), stride, points[:, -1])
        tilts = jnp.stack([head.tilt, head.pan, head.roll], -1)[:, 0]
        told = robots.doing[:, 0], robots.busy[:, 0], jnp.swapaxes(points, 0, 1), tilts
        return robots, new, told

    def _judge(self, state: State, action: Action, planned: Any, stride: Any, measured: Any):
        match, old, game = self.match, state.robots, state.game
        pose, speed, head, rolled, touched = measured
        cos, sin = jax.vmap(lambda q: jnp.stack(heading(jnp.pad(q, (0, 12)))))(pose).T[:, :, None]
        x, y = pose[:, :1], pose[:, 1:2]
        upright = 1 - 2 * (pose[:, 4:5] ** 2 + pose[:, 5:6] ** 2)
        fell = (upright < self.env.fall_tilt) | (pose[:, 2:3] < self.env.fall_height)
        playing = (game.phase == PLAY) | (game.phase == KICKOFF)
        may = playing & (old.out <= 0)
        # Lying down is a posture, too: only who stands or walks can fall.
        low = (planned.doing >= walking.POSTURE) & (planned.busy > 0)
        got_up = old.fallen & ~planned.fallen
        fallen = ~got_up & (planned.fallen | (fell & ~low & may))
        v, v_y = unturn(speed[:, :1], speed[:, 1:2], cos, sin)
        turned = old.cos * sin - old.sin * cos
        told = stride[:, :, None] * match.dt
        zero = jnp.zeros_like(x)
        robots = planned._replace(
            x=x,
            y=y,
            cos=cos,
            sin=sin,
            v=v,
            v_y=v_y,
            omega=speed[:, 5:6],
            tilt=head[:, 0:1],
            pan=head[:, 1:2],
            roll=head[:, 2:3],
            fallen=fallen,
            turned=turned,
            # What the gait was asked for: slips and pushes are what odometry does not know.
            odometry_x=told[:, 0],
            odometry_y=told[:, 1],
            odometry_turn=told[:, 2],
            push_x=zero,
            push_y=zero,
            gained_x=v - old.v,
            gained_y=v_y - old.v_y,
            touching=touched[:, None] & may,
        )
        ball = RollingBall(*(rolled[k][None] for k in range(4)))
        ball = self._inside(ball)
        boxes = walking.boxes(match.bodies, robots, robots, match.dt)
        depth = balls.contact(ball, boxes, match.field.ball_radius)[0]
        talk, key = state.talk, noise.key(game.seed, game.tick, old.lane)
        if match.sound != "none":
            talk = sound.speak(talk, robots, action, may, match.air, key, match.dt)
        robots, ball, game, statistics = referee.judge(
            match.rules,
            match.field,
            match.rolling.deceleration,
            match.dt,
            match.half_steps,
            old,
            robots,
            ball,
            game,
            state.statistics,
            depth > -0.02,
        )
        far = jnp.maximum(jnp.abs(robots.x - x), jnp.abs(robots.y - y)) > _MOVED
        which = far | ((fallen | got_up) & ~robots.fallen)
        places = jnp.stack([robots.x, robots.y, robots.cos, robots.sin])[..., 0]
        at = jnp.concatenate([ball.x, ball.y])
        rolls = jnp.max(jnp.abs(at - rolled[:2])) > _MOVED
        return State(robots, ball, talk, game, statistics), (which[:, 0], places, rolls, at)

    def pictures(self, poses: list[np.ndarray], width: int, height: int) -> list[np.ndarray]:
        """Pictures uint8 [height, width, 3] of kept poses, by a camera that glides after the ball.
        Raises ValueError where no OpenGL back end works."""
        data, renderer = mujoco.MjData(self.model), render._renderer(self.model, height, width)
        camera, found = mujoco.MjvCamera(), []
        camera.distance, camera.elevation, camera.azimuth = 2.4, -32.0, 90.0
        at, place = self._ball[0], np.zeros(2)
        try:
            for qpos in poses:
                data.qpos[:] = qpos
                mujoco.mj_forward(self.model, data)
                ball = np.clip(qpos[at : at + 2], -1.4, 1.4)
                place = place + 0.06 * (0.8 * ball - place)
                camera.lookat[:] = (*place, 0.05)
                renderer.update_scene(data, camera)
                found.append(renderer.render().copy())
        finally:
            renderer.close()
        return found

    def _inside(self, ball: RollingBall) -> RollingBall:
        """A ball that jumped over a wall lies inside of it again."""
        field, r = self.match.field, self.match.field.ball_radius
        half_x, half_y = 0.5 * field.length, 0.5 * field.width
        in_mouth = jnp.abs(ball.y) < 0.5 * field.goal_width
        most = jnp.where(in_mouth, half_x + field.goal_depth, half_x - r)
        over_x, over_y = jnp.abs(ball.x) > most + 0.1, jnp.abs(ball.y) > half_y - r + 0.05
        return ball._replace(
            x=jnp.where(over_x, jnp.sign(ball.x) * (half_x - r), ball.x),
            y=jnp.where(over_y, jnp.sign(ball.y) * (half_y - r), ball.y),
        )
