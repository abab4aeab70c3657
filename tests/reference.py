"""A second, naive FNTG: float64 NumPy, written from the paper and the design alone.

It shares no code with the project and reads only the `parameters`, `output` and `limits` of an
exported JSON document, so it also shows that the file can be evaluated without knowing layouts.
"""

import math


def sigmoid_label(a: float, c: float, x: float) -> float:
    return 1.0 / (1.0 + math.exp(-a * (x - c)))


def bell(sigma: float, theta: float) -> float:
    """exp(-theta^2 / 2 sigma^2); at sigma = 0 its limit."""
    if sigma * sigma == 0.0:
        return 1.0 if theta == 0.0 else 0.0
    return math.exp(-(theta**2) / (2.0 * sigma**2))


def direction_label(sigma: list[float], label: int, theta: float) -> float:
    if label == 2:
        return 1.0 - bell(sigma[2], theta)
    on_the_left = theta > 0
    return bell(sigma[label], theta) if on_the_left == (label == 0) else 0.0


def rules(parameters: dict, observation, near_only: bool = False):
    """Yield (firing strength, V, Omega) of the 24 rules or, with `near_only`, of the 16."""
    d_ball, d_obstacle, theta_ball, theta_obstacle = (float(x) for x in observation)
    labels = {
        name: [sigmoid_label(parameters[name]["a"][n], parameters[name]["c"][n], x) for n in (0, 1)]
        for name, x in (("A", d_ball), ("B", d_obstacle), ("C", theta_ball))
    }
    for i in (0, 1):
        for j in (0, 1):
            for k in (0, 1):
                strength = labels["A"][i] * labels["B"][j] * labels["C"][k]
                for m in (0, 1, 2):
                    values = parameters["V"][i][j][k][m], parameters["Omega"][i][j][k][m]
                    if near_only and j == 1:
                        if m == 0:
                            yield strength, *values
                        continue
                    d = direction_label(parameters["sigma"], m, theta_obstacle)
                    yield strength * d, *values


def averages(parameters: dict, observation, near_only: bool = False) -> tuple[float, float]:
    """The paper's weighted averages of V and Omega (NaN where no rule fires at all)."""
    total = v = omega = 0.0
    for strength, rule_v, rule_omega in rules(parameters, observation, near_only):
        total += strength
        v += strength * rule_v
        omega += strength * rule_omega
    return (v / total, omega / total) if total > 0.0 else (math.nan, math.nan)


def command(document: dict, observation, near_only: bool = False) -> tuple[float, float]:
    """(v, omega) in m/s and rad/s of an exported controller."""
    v, omega = averages(document["parameters"], observation, near_only)
    bias, limits = document["parameters"]["bias"], document["limits"]
    v, omega = v + bias[0], omega + bias[1]
    if document["output"] == "scale":
        v, omega = v * limits["v_max"] / 5.0, omega * limits["omega_max"] / 5.0
    return (
        min(max(v, limits["v_min"]), limits["v_max"]),
        min(max(omega, -limits["omega_max"]), limits["omega_max"]),
    )


# The trial: a unicycle on the field, a ball and discs that may move, all in closed form.

HALF_LENGTH, HALF_WIDTH, BALL_RADIUS = 1.4, 0.9, 0.042
CLEARANCE = 0.145


def fold(x: float, half: float) -> float:
    """Straight motion between two elastic walls at -half and half, unfolded."""
    return abs((x - half) % (4 * half) - 2 * half) - half


def ball_at(start, velocity, deceleration: float, t: float) -> tuple[float, float]:
    """A ball that slows down steadily and bounces off the walls, at time t."""
    speed = math.hypot(*velocity)
    if speed == 0.0:
        return float(start[0]), float(start[1])
    t = min(t, speed / deceleration)
    way = speed * t - deceleration * t * t / 2
    return tuple(
        fold(p + u / speed * way, half - BALL_RADIUS)
        for p, u, half in zip(start, velocity, (HALF_LENGTH, HALF_WIDTH))
    )


def disc_at(disc, velocity, t: float) -> tuple[float, float, float]:
    x, y, radius = (float(n) for n in disc)
    if velocity is None:
        return x, y, radius
    return (
        fold(x + float(velocity[0]) * t, HALF_LENGTH - radius),
        fold(y + float(velocity[1]) * t, HALF_WIDTH - radius),
        radius,
    )


def nearest(x: float, y: float, discs) -> tuple[float, float]:
    """Signed distance to the nearest surface and the direction of its point, field frame."""
    found = [
        (HALF_LENGTH - x, 0.0),
        (HALF_LENGTH + x, math.pi),
        (HALF_WIDTH - y, math.pi / 2),
        (HALF_WIDTH + y, -math.pi / 2),
    ]
    for cx, cy, radius in discs:
        found.append((math.hypot(cx - x, cy - y) - radius, math.atan2(cy - y, cx - x)))
    return min(found, key=lambda pair: pair[0])


def wrapped(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle))


def observe(pose, ball, discs) -> tuple[float, float, float, float]:
    x, y, heading = pose
    d_obstacle, direction = nearest(x, y, discs)
    return (
        math.hypot(ball[0] - x, ball[1] - y),
        d_obstacle,
        wrapped(math.atan2(ball[1] - y, ball[0] - x) - heading),
        wrapped(direction - heading),
    )


def drive(pose, v: float, omega: float, dt: float) -> tuple[float, float, float]:
    """Constant v and omega for dt: a chord of the circle with radius v / omega."""
    x, y, heading = pose
    middle, turn = heading + omega * dt / 2, omega * dt / 2
    chord = v * dt * (math.sin(turn) / turn if turn else 1.0)
    return x + chord * math.cos(middle), y + chord * math.sin(middle), heading + omega * dt


def simulate(document: dict, start, ball, discs, ball_velocity=(0.0, 0.0), disc_velocities=None):
    """One trial of 220 steps: what the paper's fitness needs, as a dictionary."""
    dt, deceleration = document["control_dt"], 0.05
    pose = tuple(float(n) for n in start)
    ball_start = [float(n) for n in ball]
    ball_velocity = [float(n) for n in ball_velocity]
    velocities = [None] * len(discs) if disc_velocities is None else disc_velocities
    out = {"distance": [], "v": [], "omega": []}
    nearest_yet, v_peak = math.inf, -math.inf
    for step in range(1, 221):
        t = (step - 1) * dt
        seen = observe(
            pose,
            ball_at(ball_start, ball_velocity, deceleration, t),
            [disc_at(d, u, t) for d, u in zip(discs, velocities)],
        )
        v, omega = command(document, seen)
        pose = drive(pose, v, omega, dt)
        after = observe(
            pose,
            ball_at(ball_start, ball_velocity, deceleration, t + dt),
            [disc_at(d, u, t + dt) for d, u in zip(discs, velocities)],
        )
        nearest_yet, v_peak = min(nearest_yet, seen[1], after[1]), max(v_peak, v)
        if step in (170, 200, 220):
            out["distance"].append(after[0])
            out["v"].append(v)
            out["omega"].append(omega)
    return {**out, "clearance": nearest_yet, "v_peak": v_peak, "pose": pose}


def paper_fitness(trials: list[dict]) -> float:
    """F of one genome over its trials, as printed (|v| for v: the design's reading)."""
    n = len(trials)
    d_1, d, d_2 = (sum(t["distance"][m] for t in trials) / n for m in range(3))
    v_fit = sum(abs(v) for t in trials for v in t["v"]) / (3 * n)
    omega_fit = sum(abs(w) for t in trials for w in t["omega"]) / (3 * n)
    delta = sum((20 * (0.145 - min(t["clearance"], 0.145))) ** 2 for t in trials) / n
    phi = sum(0 if t["v_peak"] > 0.05 else 1 for t in trials) / n
    return 10 / (0.001 + (6 * d) ** 2 + d_1 + d_2 + 2 * v_fit + 0.5 * omega_fit + delta + 60 * phi)


def success(trial: dict) -> tuple[bool, bool, bool]:
    """(reach, safe, stop) of one trial."""
    return (
        trial["distance"][1] < 0.10,
        trial["clearance"] >= 0.145,
        sum(abs(v) for v in trial["v"]) / 3 < 0.03,
    )
