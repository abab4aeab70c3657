"""Small algebra written out in components, for code that is vectorised over its batch.

Vectors are tuples of three components of any shape.  A component that is the Python number 0.0
is known to be zero and drops out.
"""

from typing import NamedTuple


def mul(a, b):
    zero = (isinstance(a, float) and a == 0.0) or (isinstance(b, float) and b == 0.0)
    return 0.0 if zero else a * b


def total(*terms):
    terms = [t for t in terms if not (isinstance(t, float) and t == 0.0)]
    result = terms[0] if terms else 0.0
    for t in terms[1:]:
        result = result + t
    return result


def dot(a, b):
    return total(*(mul(x, y) for x, y in zip(a, b)))


def cross(a, b):
    def minor(i, j):
        return total(mul(a[i], b[j]), mul(-1.0, mul(a[j], b[i])))

    return minor(1, 2), minor(2, 0), minor(0, 1)


def scale(s, a):
    return tuple(mul(s, x) for x in a)


def add(*vectors):
    return tuple(total(*parts) for parts in zip(*vectors))


def sub(a, b):
    return add(a, scale(-1.0, b))


def turn_inertia(inertia, axis, spin):
    """Inertia of a body of revolution times a vector."""
    across, along = inertia
    return add(scale(across, spin), scale(mul(along - across, dot(axis, spin)), axis))


def over_legs(x):
    """Sum over the four legs."""
    return 0.0 if isinstance(x, float) else (x[0] + x[1]) + (x[2] + x[3])


def ldl(a):
    """Factor a symmetric positive definite matrix (lower triangle a[i][j], j <= i): unit lower
    triangle and the inverse of the diagonal."""
    n = len(a)
    low, inverse, scaled = [[None] * n for _ in range(n)], [], [[None] * n for _ in range(n)]
    for i in range(n):
        for j in range(i):
            x = a[i][j]
            for k in range(j):
                x = x - scaled[i][k] * low[j][k]
            scaled[i][j] = x
            low[i][j] = x * inverse[j]
        x = a[i][i]
        for k in range(i):
            x = x - scaled[i][k] * low[i][k]
        inverse.append(1 / x)
    return low, inverse


def ldl_solve(factor, b):
    low, inverse = factor
    n = len(b)
    x = list(b)
    for i in range(n):
        for k in range(i):
            x[i] = x[i] - low[i][k] * x[k]
    x = [v * d for v, d in zip(x, inverse)]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            x[i] = x[i] - low[k][i] * x[k]
    return x


class Arrow(NamedTuple):
    """Symmetric matrix of a trunk with legs: base[i][j] (j <= i) [], and a leg's coupling
    cross[i][k] and own block leg[k][l] (l <= k) [4]."""

    base: list
    cross: list
    leg: list


def solve_arrow(m: Arrow, base, leg):
    """Solve for the trunk by its Schur complement, then for each leg."""
    factor = ldl(m.leg)
    shares = [ldl_solve(factor, row) for row in m.cross]
    schur = [
        [m.base[i][j] - over_legs(dot(m.cross[i], shares[j])) for j in range(i + 1)]
        for i in range(6)
    ]
    rhs = [base[i] - over_legs(dot(shares[i], leg)) for i in range(6)]
    x = ldl_solve(ldl(schur), rhs)
    own = [leg[k] - total(*(m.cross[i][k] * x[i] for i in range(6))) for k in range(3)]
    return x, ldl_solve(factor, own)
