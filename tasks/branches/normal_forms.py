"""Normal forms of the step map at flips and Neimark-Sacker points: whether what begins
there is stable.

On the centre manifold of a flip the change xi of the stance angle over itself becomes
-xi + b xi^3; at a Neimark-Sacker point the amplitude r of this change becomes r + d r^3.
Where b > 0, or d < 0, gaits of twice as many steps or invariant curves begin on the side
where the gait is unstable, and attract its neighbours in the manifold: the point is
supercritical. Formulas are those of Y. A. Kuznetsov, Elements of Applied Bifurcation
Theory, sections 5.4 and 8.

Derivatives of the exact derivative A of the map are central differences along the
critical eigenvector q: B(q, .) is the first of A and C(q, q, .) the second. Sections are
counted over the stance angle. In shapes, n counts lanes, d coordinates of a section, s
places along a direction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.gaits.rounding import UNITS
from gaitsweep.tasks.mechanics.arrays import Gait
from gaitsweep.tasks.mechanics.sums import matvec
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import from_largest, sections

SUPERCRITICAL = "supercritical"
SUBCRITICAL = "subcritical"


class _Stencil(NamedTuple):
    """Central differences: weights of the first and the second derivative at 1, 2, ...
    steps, and that of the middle in the second.
    """

    first: ndarray
    second: ndarray
    middle: float


_EIGHTH = _Stencil(
    first=np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280]),
    second=np.array([8 / 5, -1 / 5, 8 / 315, -1 / 560]),
    middle=-205 / 72,
)
_SIXTH = _Stencil(
    first=np.array([3 / 4, -3 / 20, 1 / 60]),
    second=np.array([3 / 2, -3 / 20, 1 / 90]),
    middle=-49 / 18,
)
#: Steps of the differences over the stance angle.
_STEPS = 2.0 ** -np.arange(4.0, 10.0)
#: How many of these steps, the finest, show how rounding grows with finer ones.
_FINEST = 3
#: Evaluations of a step in which its event times settle.
_TURNS = 8
#: Last change but one of settled times: each is of the order of the square of the one
#: before.
_SETTLED = 1e-8
#: Shares of its error by which the point is moved, in each unit.
_MOVED = np.array([0.0, 1.0, -1.0, 0.5])
#: Standard deviations in a bound.
_SAFETY = 8.0


@dataclass(frozen=True)
class NormalForm:
    """The coefficient of a normal form.

    Attributes
    ----------
    coefficient : float
        b of a flip, d of a Neimark-Sacker point; NaN where there is none.
    error : float
        Bound on its error.
    """

    coefficient: float
    error: float

    def criticality(self, kind: str) -> str:
        """Return whether a point of a kind is super- or subcritical; empty where the
        sign of its coefficient is not known.
        """
        if not abs(self.coefficient) > self.error:
            return ""
        is_super = self.coefficient * _FORMS[kind].of_supercritical > 0
        return SUPERCRITICAL if is_super else SUBCRITICAL


#: Of other points.
NONE = NormalForm(np.nan, np.nan)


def has_form(kind: str) -> bool:
    """Return whether points of a kind have a normal form."""
    return kind in _FORMS


# Where differences reach beyond steps there are none.
@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def normal_form(problem: Problem, kind: str, Z: Gait, error: float) -> NormalForm:
    """Return the normal form of a special point; `NONE` of kinds that have none.

    Parameters
    ----------
    problem : Problem
        Of one walker.
    kind : str
        Of the point.
    Z : ndarray, shape (c,)
    error : float
        Bound on the relative error of its slope.

    Notes
    -----
    Of several steps of the differences that with the least error counts. The error of a
    difference is at most its difference from one of lower order; how far rounding, and
    the error of the point, move it is measured: in each unit all operations round anew,
    and the point is another one within its error.
    """
    if not has_form(kind):
        return NONE

    at = _in_units(problem, Z, error)
    form = _FORMS[kind]
    high, low = _coefficients(form, at, _STEPS, (_EIGHTH, _SIXTH))
    angle = form.critical(at.jacobian).right[:, 0]
    by_angle = form.by_angle(angle)
    high = high * by_angle
    low = low * by_angle

    # The first lane is the point itself in the first unit.
    truncation = np.abs(high - low)[:, 0]
    deviation = high.std(axis=1, ddof=1)
    off = truncation + _SAFETY * (deviation + _rounding(deviation))
    if not np.isfinite(off).any():
        return NONE

    best = int(np.nanargmin(off))
    return NormalForm(float(high[best, 0]), float(off[best]))


def _rounding(deviation: ndarray) -> ndarray:
    """What rounding does to coefficients for each of `_STEPS`, from their deviations
    (steps,): with the inverse square of the step, as second differences have it.
    """
    finest = _STEPS[-_FINEST:]
    scaled = deviation[-_FINEST:] * finest**2
    return np.asarray(np.sqrt((scaled**2).mean()) / _STEPS**2)


@dataclass(frozen=True)
class _Sections:
    """Gaits of n lanes, taken apart.

    Attributes
    ----------
    problem : Problem
        Of a single step, of n lanes or of one walker.
    y : ndarray, shape (d, n)
        First sections, scaled.
    durations : ndarray, shape (steps, k, n) [sqrt(leg/g)]
        Of the phases of each step.
    drive, scale : ndarray, shape (n,)
    jacobian : ndarray, shape (n, d, d)
        Of all steps of a gait.
    """

    problem: Problem
    y: ndarray
    durations: ndarray
    drive: ndarray
    scale: ndarray
    jacobian: ndarray

    @classmethod
    def of(cls, at: Evaluation) -> _Sections:
        """Take apart gaits that are evaluated, in the units of the evaluation."""
        problem = at.problem
        d = len(at.stride.jacobian)
        y = at.stride.y[:d]
        _, durations = sections(at.w, at.m, problem.steps)

        return cls(
            problem=problem.of_steps(1),
            y=y,
            durations=durations,
            drive=np.exp(at.q),
            scale=np.exp(at.Z[0]) / y[0],
            jacobian=at.jacobians,
        )

    def along(self, direction: ndarray, places: ndarray) -> ndarray:
        """Return derivatives of all steps at places (s,) along directions (d, n) from the
        first sections, shape (s, n, d, d); NaN where there is no step.
        """
        s = len(places)
        d, n = self.y.shape
        in_sections = self.y[0] * direction
        shifts = places[:, None] * in_sections[:, None, :]
        moved = self.y[:, None, :] + shifts
        y = moved.reshape(d, -1)

        lanes = np.tile(np.arange(n), s)
        problem = self.problem.some(lanes)
        parameters = problem.parameters(self.drive[lanes], self.scale[lanes])

        product = np.eye(d)[:, :, None]
        for durations in self.durations:
            times = np.cumsum(durations, axis=0)[:, lanes]
            y, jacobian = _settled(problem, y, times, parameters)
            product = matvec(jacobian[:, :, None], product)

        lanes_first = np.moveaxis(product, -1, 0)
        return lanes_first.reshape(s, n, d, d)


def _settled(
    problem: Problem, y: ndarray, times: ndarray, parameters: ndarray
) -> tuple[ndarray, ndarray]:
    """Images (d, n) of sections and the derivatives there (d, d, n), the event times
    settled; NaN where they do not.
    """
    for _ in range(_TURNS):
        found = problem.step(y, times, parameters).times
        change = np.abs(found - times).max(axis=0)
        times = found
        is_settled = change < _SETTLED
        is_lost = np.isnan(found[-1])
        if (is_settled | is_lost).all():
            break

    stride = problem.step(y, times, parameters)
    image = np.where(is_settled, stride.image, np.nan)
    jacobian = np.where(is_settled, stride.jacobian, np.nan)
    return image, jacobian


def _in_units(problem: Problem, Z: Gait, error: float) -> _Sections:
    """A gait (c,) in every unit, its slope moved by shares of an error along the gaits of
    other slopes; several steps begin with the largest.
    """
    w = from_largest(Z[:-1, None], problem.m, problem.steps)
    Z = np.vstack([w, Z[-1:, None]])
    tangent = _by_log_slope(problem, Z)
    moved = Z + tangent[:, None] * error * _MOVED

    y, scale = problem.section(moved)
    units = np.array(UNITS)
    drive = np.exp(moved[-1])
    times = moved[problem.m : -1]
    parameters = problem.parameters(drive, scale * units)
    stride = problem.map(y / units, times, parameters, by_drive=True)
    return _Sections.of(Evaluation(moved, stride, problem))


def _by_log_slope(problem: Problem, Z: ndarray) -> ndarray:
    """Derivative (c,) of the unknowns Z (c, 1) of a gait by its ln slope, the last."""
    stride, _ = problem.stride(Z[:-1], Z[-1], by_drive=True)
    derivative = Evaluation(Z, stride, problem).derivative[:, :, 0]
    by_w = derivative[:, :-1]
    by_slope = derivative[:, -1]
    return np.append(np.linalg.solve(by_w, -by_slope), 1.0)


class _Eigen(NamedTuple):
    """Critical multipliers (n,), their right vectors of unit length and left ones, whose
    product with the right ones is 1, both (n, d).
    """

    value: ndarray
    right: ndarray
    left: ndarray


def _eigen(jacobian: ndarray, off: Callable[[ndarray], ndarray]) -> _Eigen:
    """The multipliers of derivatives (n, d, d) that are least `off` of all (n, d)."""
    finite = np.where(np.isfinite(jacobian), jacobian, 0.0)
    values, right = np.linalg.eig(finite)
    left = np.linalg.pinv(right)

    nearest = off(values).argmin(axis=1)
    lanes = np.arange(len(values))
    return _Eigen(
        value=values[lanes, nearest],
        right=right[lanes, :, nearest],
        left=left[lanes, nearest],
    )


def _nearest_to_flip(jacobian: ndarray) -> _Eigen:
    """The multiplier nearest to -1, real."""
    eigen = _eigen(jacobian, lambda values: np.abs(values + 1))
    return _Eigen(eigen.value.real, eigen.right.real, eigen.left.real)


def _upper_of_pair(jacobian: ndarray) -> _Eigen:
    """The upper multiplier of a complex pair."""
    eigen = _eigen(jacobian, lambda values: -values.imag)
    return _Eigen(*(part.astype(complex) for part in eigen))


class _Line(NamedTuple):
    """Derivatives of steps on both sides of a gait along a direction.

    Attributes
    ----------
    places : ndarray, shape (s,)
    more, less : ndarray, shape (s, n, d, d)
        At these places and opposite to them.
    middle : ndarray, shape (n, d, d)
    """

    places: ndarray
    more: ndarray
    less: ndarray
    middle: ndarray

    @classmethod
    def along(cls, at: _Sections, direction: ndarray, places: ndarray) -> _Line:
        """Evaluate steps at places (s,) along a direction (d, n)."""
        both_sides = np.hstack([places, -places])
        more, less = np.split(at.along(direction, both_sides), 2)
        return cls(places, more, less, at.jacobian)

    def differences(self, stencil: _Stencil, step: float) -> tuple[ndarray, ndarray]:
        """First and second derivatives along the direction (n, d, d)."""
        reach = step * np.arange(1, len(stencil.first) + 1)
        some = np.searchsorted(self.places, reach)
        more = self.more[some]
        less = self.less[some]

        first = np.tensordot(stencil.first, more - less, 1)
        second = np.tensordot(stencil.second, more + less, 1)
        second = second + stencil.middle * self.middle
        return first / step, second / step**2


def _coefficients(
    form: _Form, at: _Sections, steps: ndarray, stencils: tuple[_Stencil, ...]
) -> list[ndarray]:
    """Coefficients by each stencil, for each step of the differences, shape (steps, n)."""
    eigen = form.critical(at.jacobian)
    parts = [eigen.right.real]
    if np.iscomplexobj(eigen.right):
        parts.append(eigen.right.imag)

    reach = np.arange(1, len(stencils[0].first) + 1)
    places = np.unique(np.outer(steps, reach))
    lines = [_Line.along(at, part.T, places) for part in parts]

    found = []
    for stencil in stencils:
        rows = []
        for step in steps.tolist():
            differences = [line.differences(stencil, step) for line in lines]
            rows.append(form.coefficient(at.jacobian, eigen, differences))
        found.append(np.array(rows))

    return found


def _times(matrices: ndarray, vectors: ndarray) -> ndarray:
    """Products of matrices (n, d, d) and vectors (n, d)."""
    columns = matrices @ vectors[..., None]
    return np.asarray(columns[..., 0])


def _solved(matrices: ndarray, vectors: ndarray) -> ndarray:
    """Solutions of equations (n, d, d) for vectors (n, d); NaN where there is none."""
    regular = np.isfinite(matrices).all(axis=(1, 2))
    regular &= np.isfinite(vectors).all(axis=1)
    regular[regular] = np.linalg.det(matrices[regular]) != 0

    out = np.full(vectors.shape, np.nan, np.result_type(matrices, vectors))
    columns = vectors[regular][..., None]
    solutions = np.linalg.solve(matrices[regular], columns)
    out[regular] = solutions[..., 0]
    return out


def _of_flip(
    A: ndarray, eigen: _Eigen, differences: list[tuple[ndarray, ndarray]]
) -> ndarray:
    """Of a flip, shape (n,): b = <p, C(q, q, q)> / 6 + <p, B(q, (I - A)^-1 B(q, q))> / 2.

    Derivatives along q are matrices, B = B(q, .) and C = C(q, q, .), shape (n, d, d).
    """
    ((B, C),) = differences
    q = eigen.right
    p = eigen.left
    one = np.eye(A.shape[-1])

    h = _solved(one - A, _times(B, q))
    vectors = _times(C, q) / 6 + _times(B, h) / 2
    return np.asarray((p * vectors).sum(axis=1))


def _of_pair(
    A: ndarray, eigen: _Eigen, differences: list[tuple[ndarray, ndarray]]
) -> ndarray:
    """Of a pair, shape (n,): d = Re e^(-i theta) (<p, C(q, q, q')>
    + 2 <p, B(q, (I - A)^-1 B(q, q'))>
    + <p, B(q', (e^(2 i theta) I - A)^-1 B(q, q))>) / 2, with q' conjugate to q.

    Derivatives along the real and the imaginary part of q are matrices, shape (n, d, d),
    from which B = B(q, .), complex, and C = C(q, q', .), real.
    """
    (B_real, C_real), (B_imag, C_imag) = differences
    B = B_real + 1j * B_imag
    C = C_real + C_imag
    q = eigen.right
    p = eigen.left
    one = np.eye(A.shape[-1])
    turn = eigen.value / np.abs(eigen.value)
    twice = (turn**2)[:, None, None]

    mean = _solved(one - A, _times(B, q.conj()))
    double = _solved(twice * one - A, _times(B, q))
    vectors = _times(C, q) + 2 * _times(B, mean) + _times(B.conj(), double)
    products = (p * vectors).sum(axis=1)
    return np.asarray((products / turn).real / 2)


class _Form(NamedTuple):
    """The normal form of a kind of points.

    Attributes
    ----------
    critical : callable
        The multipliers on the unit circle of derivatives (n, d, d).
    coefficient : callable
        For critical vectors of unit length, shape (n,).
    by_angle : callable
        What makes that the coefficient of changes of the stance angle, by its component
        (n,) in the critical vectors, shape (n,).
    of_supercritical : int
        Sign of the coefficient at supercritical points.
    """

    critical: Callable[[ndarray], _Eigen]
    coefficient: Callable[..., ndarray]
    by_angle: Callable[[ndarray], ndarray]
    of_supercritical: int


_FORMS = {
    "flip": _Form(
        critical=_nearest_to_flip,
        coefficient=_of_flip,
        by_angle=lambda angle: 1 / angle**2,
        of_supercritical=1,
    ),
    # Changes of the angle are twice the real part.
    "neimark_sacker": _Form(
        critical=_upper_of_pair,
        coefficient=_of_pair,
        by_angle=lambda angle: 1 / (4 * np.abs(angle) ** 2),
        of_supercritical=-1,
    ),
}
