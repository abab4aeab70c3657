"""A match: N robots a side, ball, field, referee.  Pure functions of one match or of a batch.

    match = Match()
    state = match.reset(kickoff=0, seed=1)           # 0: the home team kicks off
    senses = match.sense(state)                      # leaves [R, ...], R = 2 N robots
    state = match.step(state, action)                # leaves [R, ...]; 0.1 s of play
    match.score(state), match.snapshot(state)

One match has leaves with the robots in front: [R, ...]; `jax.vmap` makes batches of it.  Those who
want the speed put the batch last instead and call `step_batch` and `sense_batch`, whose leaves are
[..., R, B] (components, robots, matches): whole registers then hold neighbouring matches.
"""

import dataclasses
import math
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from envs.base import Action, Camera, Field, Head, Senses, Truth
from envs.field import FIELD, bearing
from envs.soccer import ball as balls
from envs.soccer import bodies as walking
from envs.soccer import camera as seeing
from envs.soccer import feel, noise, pictures, referee, sound, tables, voices
from envs.soccer.state import (
    CALLS,
    FINISHED,
    KICKOFF,
    PLAY,
    Game,
    Robots,
    RollingBall,
    State,
    Statistics,
    total,
    upright,
)

CAMERAS, SOUNDS = ("objects", "image", "perfect"), ("symbols", "audio", "none")
# A ball of 3 m/s moves 10 cm in one and a dog 1 cm, together less than the 11.8 cm from a body's
# surface to its axis, ball included: it is then still on the side from which it came.
SUB_STEPS = 3


class Picture(NamedTuple):
    """What a viewer draws of one match: m and rad in the field's frame.

    robots: x, y, heading; head: tilt, pan, roll; upright, out: of each robot; kicking: plays a kick
    or posture; ball: x, y; score: home, away; clock: s of this half; half: 0, 1, 2 at the
    end; phase: 0 play, 1 kick-off, 2 break, 3 finished; attack: +1 where home plays towards +x;
    call, caller: of the referee in this step, index into `envs.soccer.CALLS` and robot (or team).
    """

    robots: Float[Array, "R 3"]
    head: Float[Array, "R 3"]
    upright: Bool[Array, " R"]
    out: Bool[Array, " R"]
    kicking: Bool[Array, " R"]
    ball: Float[Array, "2"]
    score: Int[Array, "2"]
    clock: Float[Array, ""]
    half: Int[Array, ""]
    phase: Int[Array, ""]
    attack: Float[Array, ""]
    call: Int[Array, ""]
    caller: Int[Array, ""]


@dataclasses.dataclass(frozen=True)
class Match:
    """A kind of match.

    players: robots a side, 1 to 5.  home, away: bodies, shipped ("ers210", "wheels") or a file.
    camera: "objects" (noise, misses, occlusion), "image" (pixels) or "perfect" (truth).  sound:
    "symbols", "audio" (samples) or "none".
    minutes: of a half; 0 for the rules' 10.  noise: factor on the camera's errors and misses at the
    objects level.  hearing: m, where half of the messages are lost as symbols; 0 as measured.
    Raises ValueError naming field, value, what is allowed.
    """

    players: int = 3
    home: str = "ers210"
    away: str = "ers210"
    camera: str = "objects"
    sound: str = "symbols"
    minutes: float = 0.0
    noise: float = 1.0
    hearing: float = 0.0
    dt: float = 0.1
    field: Field = FIELD
    lens: Camera = Camera()
    head: Head = Head()

    def __post_init__(self):
        if not 1 <= self.players <= 5:
            raise ValueError(f"players = {self.players}: allowed are 1 to 5 a side")
        if self.camera not in CAMERAS:
            raise ValueError(f"camera = {self.camera!r}: allowed are {', '.join(CAMERAS)}")
        if self.sound not in SOUNDS:
            raise ValueError(f"sound = {self.sound!r}: allowed are {', '.join(SOUNDS)}")
        if not (self.minutes == 0 or 0.01 <= self.minutes <= 1000):
            raise ValueError(f"minutes = {self.minutes}: allowed are 0.01 to 1000 a half")
        if not 0 <= self.noise <= 10:
            raise ValueError(f"noise = {self.noise}: allowed are 0 to 10")
        if not 0 <= self.hearing <= 100:
            raise ValueError(f"hearing = {self.hearing}: allowed are 0 to 100 m")
        if not 0.01 <= self.dt <= 0.2:
            raise ValueError(f"dt = {self.dt}: allowed are 0.01 to 0.2 s")
        if self.sound == "audio" and self.dt != 0.1:
            raise ValueError(f"dt = {self.dt}: with sound = 'audio' allowed is 0.1 s")
        _ = self.bodies, self.rules  # read and checked now

    @cached_property
    def bodies(self) -> walking.Bodies:
        return walking.Bodies(tables.load_body(self.home), tables.load_body(self.away))

    @cached_property
    def rules(self) -> tables.Rules:
        rules = tables.load("rules", tables.Rules)
        return rules._replace(half_minutes=self.minutes) if self.minutes else rules

    @cached_property
    def rolling(self) -> tables.Rolling:
        return tables.load("ball", tables.Rolling)

    @cached_property
    def feelings(self) -> tables.Feelings:
        return tables.load("senses", tables.Feelings)

    @cached_property
    def sights(self) -> tables.Sights:
        sights = tables.load_sights()
        if self.noise == 1:
            return sights
        return tables.Sights(*(tables.Sight(*(self.noise * x for x in one)) for one in sights))

    @cached_property
    def air(self) -> tables.Air:
        air = tables.load("sound", tables.Air)
        return air._replace(half=self.hearing) if self.hearing else air

    @property
    def calls(self) -> tuple[str, ...]:
        """The referee's words, in the order of `Picture.call`."""
        return CALLS

    @property
    def robots(self) -> int:
        """R, of both teams."""
        return 2 * self.players

    @property
    def vivid(self) -> bool:
        """Pixels or samples are computed: a match at a time is then the best that a CPU can do."""
        return self.camera == "image" or self.sound == "audio"

    @property
    def half_steps(self) -> int:
        """Control steps of a half."""
        return referee.play_time(self.rules, self.dt)

    @property
    def steps(self) -> int:
        """Control steps until every match has finished: two halves and the break."""
        return 2 * self.half_steps + math.ceil(self.rules.break_time / self.dt) + 2

    @property
    def identify(self) -> Any:
        """How a body's table is found from recordings: `envs.soccer.identify`."""
        from envs.soccer import identify

        return identify

    # One match.

    def reset(self, kickoff: Int[Array, ""] | int = 0, seed: Int[Array, ""] | int = 0) -> State:
        """The kick-off of a match.  kickoff: team that kicks off, 0 home, 1 away; seed: decides all
        noise.  With arrays [B] of both: a batch, leaves [R, B]."""
        shape = jnp.broadcast_shapes(jnp.shape(kickoff), jnp.shape(seed))
        fill = lambda value, dtype: jnp.full(shape, value, dtype)  # noqa: E731
        many = lambda value, dtype: jnp.full((self.robots, *shape), value, dtype)  # noqa: E731
        robots = Robots(*(many(0, jnp.float32) for _ in Robots._fields))._replace(
            doing=many(0, jnp.int32),
            fallen=many(False, bool),
            touching=many(False, bool),
            cos=many(1, jnp.float32),
        )
        lanes = jnp.arange(self.robots, dtype=jnp.uint32)
        robots = robots._replace(
            lane=jnp.broadcast_to(upright(lanes, robots.x), (self.robots, *shape))
        )
        kicker = jnp.broadcast_to(jnp.asarray(kickoff, jnp.int32), shape)
        zero, whole = fill(0, jnp.float32), fill(0, jnp.int32)
        game = Game(
            tick=whole,
            played=whole,
            half=whole,
            phase=fill(KICKOFF, jnp.int32),
            waited=zero,
            first=kicker,
            kicker=kicker,
            attack=fill(1, jnp.float32),
            spot_x=zero,
            spot_y=zero,
            stuck=zero,
            toucher=fill(-1, jnp.int32),
            shot=whole,
            call=whole,
            caller=whole,
            seed=jnp.broadcast_to(jnp.asarray(seed).astype(jnp.uint32), shape),
            hand=fill(1, jnp.float32),
        )
        rolling = RollingBall(zero, zero, zero, zero)
        robots, rolling, game = referee.restart(
            self.rules, robots, rolling, game, fill(True, bool), kicker
        )
        counts = jnp.zeros((2, *shape), jnp.int32)
        statistics = Statistics(*(counts for _ in Statistics._fields))
        talk = voices.silence(robots, game) if self.sound == "audio" else sound.silence(robots)
        return State(robots, rolling, talk, game, statistics)

    def step(self, state: State, action: Action) -> State:
        """0.1 s of play: bodies, ball in sub-steps, sound, referee.  action: leaves [R, ...]."""
        return self.step_batch(state, jax.tree.map(_front, action))

    def sense(self, state: State) -> Senses:
        """What every robot knows, leaves [R, ...]."""
        return jax.tree.map(_back, self.sense_batch(state))

    def truth(self, state: State) -> Truth:
        """What is so, for every robot, leaves [R, ...]: for teams that need no perception."""
        return jax.tree.map(_back, self.truth_batch(state))

    def score(self, state: State) -> Int[Array, "2"]:
        """Goals of home and away."""
        return state.statistics.goals

    def finished(self, state: State) -> Bool[Array, ""]:
        return state.game.phase == FINISHED

    def snapshot(self, state: State) -> Picture:
        """Of one match, for pictures and histories."""
        r, game = state.robots, state.game
        return Picture(
            robots=jnp.stack([r.x, r.y, bearing(r.cos, r.sin)], -1),
            head=jnp.stack([r.tilt, r.pan, r.roll], -1),
            upright=~r.fallen,
            out=r.out > 0,
            kicking=r.busy > 0,
            ball=jnp.stack([state.ball.x, state.ball.y], -1),
            score=state.statistics.goals,
            clock=game.played * jnp.float32(self.dt),
            half=game.half,
            phase=game.phase,
            attack=game.attack,
            call=game.call,
            caller=game.caller,
        )

    def place(self, state: State, robots: Float[Array, "R 3"], ball: Float[Array, "4"]) -> State:
        """One match in full play with robots (x, y, heading; m, rad, field's frame) and ball (x, y,
        vx, vy; m, m/s) put somewhere: how scenes for a behaviour are made."""
        r = state.robots._replace(
            x=robots[:, 0], y=robots[:, 1], cos=jnp.cos(robots[:, 2]), sin=jnp.sin(robots[:, 2])
        )
        game = state.game._replace(
            phase=jnp.full_like(state.game.phase, PLAY), spot_x=ball[0], spot_y=ball[1]
        )
        return state._replace(robots=r, ball=RollingBall(*ball), game=game)

    # A batch, its axis last; also one match, its components first.

    def step_batch(self, state: State, action: Action) -> State:
        """`step` with leaves [..., R, B]: head [3, R, B], say [2, R, B]."""
        old, game, dt = state.robots, state.game, self.dt
        playing = (game.phase == PLAY) | (game.phase == KICKOFF)
        on = old.out <= 0
        may = playing & on
        key = noise.key(game.seed, game.tick, old.lane)
        lane_key = noise.key(game.seed, jnp.full_like(game.tick, -1), old.lane)

        robots, kick, busy = walking.act(self.bodies, old, action, may, key, dt)
        kicked = walking.strike(
            self.bodies, robots, kick, state.ball, key, game.hand, self.rolling.max_speed
        )
        able = may & ~busy & ~robots.fallen
        robots = walking.walk(
            self.bodies, robots, action, able, key, lane_key, game.hand, self.feelings, dt
        )
        robots = walking.nod(robots, action, self.head, able, dt)
        free = robots
        robots = walking.push(self.bodies, robots, self.field)
        robots = referee.keep_off(self.rules, old, robots, game)
        still = ~may
        robots = robots._replace(
            x=jnp.where(still, old.x, robots.x),
            y=jnp.where(still, old.y, robots.y),
            cos=jnp.where(still, old.cos, robots.cos),
            sin=jnp.where(still, old.sin, robots.sin),
            v=jnp.where(still, 0.0, robots.v),
            v_y=jnp.where(still, 0.0, robots.v_y),
            omega=jnp.where(still, 0.0, robots.omega),
            push_x=jnp.where(still, 0.0, robots.x - free.x),
            push_y=jnp.where(still, 0.0, robots.y - free.y),
            turned=jnp.where(still, 0.0, old.cos * robots.sin - old.sin * robots.cos),
        )
        robots = walking.topple(self.bodies, robots, action.walk.style, may, key, dt)

        boxes = walking.boxes(self.bodies, robots, old, dt)
        ball, touching = self._roll(state.ball, kicked, boxes)
        ball = jax.tree.map(lambda new, was: jnp.where(playing, new, was), ball, state.ball)
        # Bodies give way to a ball that cannot: between them and a wall, or between two of them.
        ends = boxes._replace(x=robots.x, y=robots.y, cos=robots.cos, sin=robots.sin)
        depth, nx, ny, _ = balls.contact(ball, ends, self.field.ball_radius)
        near = depth > -0.02
        back = jnp.where(may, jnp.maximum(depth, 0), 0.0)
        robots = robots._replace(
            x=robots.x - back * (robots.cos * nx - robots.sin * ny),
            y=robots.y - back * (robots.sin * nx + robots.cos * ny),
            touching=(touching | kicked.by) & may,
        )
        talk = state.talk
        if self.sound == "audio":
            talk = voices.speak(talk, robots, action, may, game)
        elif self.sound != "none":
            talk = sound.speak(talk, robots, action, may, self.air, key, dt)
        robots, ball, new_game, statistics = referee.judge(
            self.rules,
            self.field,
            self.rolling.deceleration,
            dt,
            self.half_steps,
            old,
            robots,
            ball,
            game,
            state.statistics,
            near,
        )
        return State(robots, ball, talk, new_game, statistics)

    def _roll(self, ball, kicked, boxes):
        """The ball through all sub-steps, and who touched it."""
        hits = total(kicked.by.astype(jnp.float32))
        share = 1 / jnp.maximum(hits, 1)
        struck = hits > 0
        vx, vy = (total(jnp.where(kicked.by, v, 0.0)) * share for v in (kicked.vx, kicked.vy))
        ball = ball._replace(vx=jnp.where(struck, vx, ball.vx), vy=jnp.where(struck, vy, ball.vy))
        dt = self.dt / SUB_STEPS

        def sub_step(n, carry):
            ball, touching = carry
            time = dt * (n + 1)
            now = boxes._replace(
                x=boxes.x + time * boxes.vx,
                y=boxes.y + time * boxes.vy,
                cos=boxes.cos - time * boxes.omega * boxes.sin,
                sin=boxes.sin + time * boxes.omega * boxes.cos,
            )
            ball, hit = balls.sub_step(ball, now, dt, self.rolling, self.field)
            return ball, touching | hit

        return jax.lax.fori_loop(0, SUB_STEPS, sub_step, (ball, jnp.zeros_like(boxes.on)))

    def sense_batch(self, state: State) -> Senses:
        """`sense` with leaves [..., R, B]: frame [K, R, B], heard [N, 2, R, B] ..."""
        robots, game = state.robots, state.game
        perfect = self.camera == "perfect"
        key = noise.key(game.seed, game.tick, robots.lane ^ jnp.uint32(0x10000))
        lane_key = noise.key(game.seed, jnp.full_like(game.tick, -1), robots.lane)
        height = self.bodies.value("height", robots.x)
        if self.sound == "audio":
            heard = state.talk.samples
            whole = jnp.zeros((self.players, *robots.x.shape), bool)
        else:
            heard, whole = sound.heard(state.talk)
        if self.camera == "image":
            frame: Any = pictures.look(state, self.field, self.lens, self.head, key, lane_key)
        else:
            frame = seeing.look(
                state, self.field, self.lens, self.head, self.sights, height, key, perfect
            )
        return Senses(
            frame=frame,
            head=jnp.stack([robots.tilt, robots.pan, robots.roll]),
            displacement=feel.displacement(state),
            proximity=feel.proximity(
                state, self.field, self.head, height, self.feelings, key, perfect
            ),
            gyro=feel.gyro(state, self.feelings, key, lane_key, self.dt, perfect),
            acceleration=feel.acceleration(state, self.feelings, key, self.dt, perfect),
            heard=heard,
            heard_valid=whole,
            signal=referee.signal(robots, game),
        )

    def truth_batch(self, state: State) -> Truth:
        """`truth` with leaves [..., R, B]."""
        r, game, n = state.robots, state.game, self.players
        direction = referee.directions(r, game)
        own = lambda a: direction * a  # noqa: E731
        pose = jnp.stack([own(r.x), own(r.y), bearing(own(r.cos), own(r.sin))])
        ball = jnp.stack([own(a) for a in state.ball])

        def order(a):  # own team by shirt, then the others: [R, R]
            home = jnp.broadcast_to(a[:, None], (2 * n, n, *a.shape[1:]))
            away = jnp.broadcast_to(
                jnp.concatenate([a[n:], a[:n]])[:, None], (2 * n, n, *a.shape[1:])
            )
            return jnp.concatenate([home, away], axis=1)

        robots = jnp.stack([order(r.x) * direction, order(r.y) * direction], axis=1)
        return Truth(
            pose=pose,
            ball=ball,
            robots=robots,
            on=order(r.out) <= 0,
            upright=~r.fallen,
            head=jnp.stack([r.tilt, r.pan, r.roll]),
            signal=referee.signal(r, game),
        )


def _front(a: Array) -> Array:
    """[R, ...] to [..., R]: components in front."""
    return jnp.moveaxis(jnp.asarray(a), 0, -1)


def _back(a: Array) -> Array:
    return jnp.moveaxis(a, -1, 0)
