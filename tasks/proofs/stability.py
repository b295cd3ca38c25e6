"""Stability from an enclosure of the step map's derivative, by the conditions of Schur,
Cohn and Jury.
"""

from __future__ import annotations

from flint import acb, arb, arb_mat


def step_derivative(derivative: arb_mat, m: int, events: int) -> arb_mat:
    """Derivative of the step map, the event times eliminated.

    Parameters
    ----------
    derivative : arb_mat, shape (events + m, m + events)
        Of guards and image by section state and event times.
    m, events : int
        Dimension of the section, and number of events.

    Returns
    -------
    arb_mat, shape (m, m)

    Raises
    ------
    ZeroDivisionError
        If the strikes' rates are not told from zero.
    """
    rows = derivative.tolist()
    guards = rows[:events]
    image = rows[events:]
    guard_x, guard_t = _split(guards, m, events)
    image_x, image_t = _split(image, m, events)
    return image_x - image_t * guard_t.inv() * guard_x


def _split(
    rows: list[list[arb]],
    m: int,
    events: int,
) -> tuple[arb_mat, arb_mat]:
    """Derivatives by section state and by event times."""
    by_state = [row[:m] for row in rows]
    by_times = [row[m : m + events] for row in rows]
    return arb_mat(by_state), arb_mat(by_times)


def characteristic(matrix: arb_mat) -> list[arb]:
    """Coefficients of det(z - A), leading one first.

    Parameters
    ----------
    matrix : arb_mat, shape (2, 2) or (3, 3)

    Returns
    -------
    list of arb
    """
    a = matrix.tolist()
    if len(a) == 2:
        return [arb(1), -matrix.trace(), matrix.det()]

    minors = arb(0)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        diagonal = a[i][i] * a[j][j]
        minors += diagonal - a[i][j] * a[j][i]

    return [arb(1), -matrix.trace(), minors, -matrix.det()]


def multipliers(matrix: arb_mat) -> list[acb]:
    """Enclosures of the multipliers, each of one, or none where two are not told apart.

    Parameters
    ----------
    matrix : arb_mat, shape (n, n)
        Derivative of the step map.

    Returns
    -------
    list of acb
        The imaginary part of a real one is exactly 0.
    """
    try:
        found = matrix.eig()
    except ValueError:
        return []
    return [z if _may_be_paired(z, found) else acb(z.real) for z in found]


def _may_be_paired(z: acb, found: list[acb]) -> bool:
    """Whether a multiplier's conjugate, which is one too, may lie in the ball of another;
    if not, it is the multiplier itself, which is real.
    """
    others = [x for x in found if x is not z]
    return any(z.conjugate().overlaps(x) for x in others)


def is_stable(matrix: arb_mat) -> bool | None:
    """True where every multiplier lies inside the unit circle, False where one lies
    outside, else None.

    Parameters
    ----------
    matrix : arb_mat, shape (2, 2) or (3, 3)
        Derivative of the step map.

    Returns
    -------
    bool or None

    Notes
    -----
    All zeros of p lie inside the circle just if p(1) > 0, (-1)^n p(-1) > 0, |p_n| < 1 and, for n = 3,
    |p_3 p_1 - p_2| < 1 - p_3^2 (Jury 1964). Each is necessary for the closed disc with its sign weakened, so one that
    fails strictly puts a multiplier outside.
    """
    p = characteristic(matrix)
    at_one = sum(p, arb(0))
    at_minus_one = flip_function(matrix)
    margins = [at_one, at_minus_one, 1 - abs(p[-1])]
    if len(p) == 4:
        left = abs(p[3] * p[1] - p[2])
        margins.append(1 - p[3] ** 2 - left)

    if all(x > 0 for x in margins):
        return True
    if any(x < 0 for x in margins[:3]) or _last_fails(margins):
        return False

    return None


def _last_fails(margins: list[arb]) -> bool:
    """Whether the last condition fails; it has this form while the others hold, whose
    failures are decided first.
    """
    return bool(len(margins) == 4 and margins[3] < 0 and margins[2] > 0)


def flip_function(matrix: arb_mat) -> arb:
    """(-1)^n p(-1) = det(A + 1): it changes sign where a multiplier passes -1.

    Parameters
    ----------
    matrix : arb_mat, shape (n, n)

    Returns
    -------
    arb
    """
    rows = matrix.tolist()
    for i, row in enumerate(rows):
        row[i] += 1
    return arb_mat(rows).det()
