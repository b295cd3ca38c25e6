"""The step map and its exact derivatives, with the event times as unknowns.

A gait is a zero of P(y) - y. The section's coordinates y are, just after heelstrike,
(stance angle, stance rate) for point feet, whose impact leaves no other freedom,
(stance angle, stance rate, swing rate) for straight legs, and, just before heelstrike,
(stance angle, old stance rate, old swing rate) for kneed ones, whose locked legs need no fourth coordinate.
Each phase is a flow over a given time; the value of its guard at the end is corrected to first order, which gives the
saltation terms exactly and makes the event times converge quadratically. In shapes, n counts lanes, m section
coordinates and k phases.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import heyoka as hy
import numpy as np

from tasks.mechanics.equations import ZERO, Solver, Sym, Symbols, rows
from tasks.mechanics.impacts import heelstrike, kneestrike
from tasks.mechanics.kernel import LANES, flow, prepare_compiler, whole_groups
from tasks.mechanics.lumped import Structure

#: Intervals at whose ends the motion is sampled to verify a step.
SAMPLES = 16


@dataclass
class Stride:
    """One step of n lanes, to first order, in scaled angles and rates and times in sqrt(leg/g).

    Attributes
    ----------
    y : ndarray, shape (m, n)
        Section coordinates at the start.
    image : ndarray, shape (m, n)
        P(y), the event times corrected.
    jacobian, inverse : ndarray, shape (m, m, n)
        dP/dy, and the inverse of I - dP/dy.
    newton : ndarray, shape (m, n)
        Newton step of P(y) = y.
    times : ndarray, shape (k, n)
        Kneestrike, for knees, and heelstrike, corrected.
    times_by_y : ndarray, shape (k, m, n)
    by_slope, times_by_slope : ndarray, shape (m, n) and (k, n)
        Derivatives of P(y) and of the times by the slope; empty where not asked for.
    impact, impact_by_y : ndarray, shape (2, n) and (2, m, n)
        Rates just before heelstrike.
    start : ndarray, shape (angles, n)
        State just after heelstrike.
    closing : ndarray, shape (n,)
        Rate of the heelstrike guard.
    knee, knee_by_y : ndarray, shape (6, n) and (6, m, n)
        State at kneestrike; empty for straight legs.
    motion : list of ndarray, shape (samples + 1, angles, n)
        Samples of each phase; of no samples where not asked for.
    """

    y: np.ndarray
    image: np.ndarray
    jacobian: np.ndarray
    inverse: np.ndarray
    newton: np.ndarray
    times: np.ndarray
    times_by_y: np.ndarray
    by_slope: np.ndarray
    times_by_slope: np.ndarray
    impact: np.ndarray
    impact_by_y: np.ndarray
    start: np.ndarray
    closing: np.ndarray
    knee: np.ndarray
    knee_by_y: np.ndarray
    motion: list[np.ndarray]

    def scaled_motion(self) -> list[np.ndarray]:
        """Samples of each phase over the stance angle, by which neighbours on a branch are compared.

        Returns
        -------
        list of ndarray, shape (samples + 1, angles, n)
        """
        return [phase / self.y[0] for phase in self.motion]

    def assign(self, lanes: np.ndarray, other: Stride) -> None:
        """Replace some lanes by those of another stride.

        Parameters
        ----------
        lanes : ndarray of int, shape (k,)
        other : Stride
            Of k lanes.
        """
        for name, values in vars(self).items():
            new = getattr(other, name)
            for a, b in zip(values, new, strict=True) if isinstance(values, list) else [(values, new)]:
                a[..., lanes] = b


def start_of_step(structure: Structure, p: Symbols, y: list[Sym]) -> list[Sym]:
    """State just after heelstrike at section coordinates y, as symbols."""
    if structure.kneed:
        return [y[0], -y[0], -y[0], *heelstrike(p, y[0], y[1], y[2], True)]
    if structure.point_foot:
        # The impulse has no moment about the hip of a leg whose mass is at the foot that leaves the ground.
        return [y[0], -y[0], y[1], y[1] * hy.cos(2.0 * p.scale * y[0])]
    return [y[0], -y[0], y[1], y[2]]


def lock_knee(p: Symbols, x: list[Sym]) -> list[Sym]:
    """State of two links after kneestrike from that of three before it, as symbols."""
    return [x[0], x[1], *kneestrike(p, x[:3], x[3:])]


def end_of_step(structure: Structure, p: Symbols, x: list[Sym]) -> list[Sym]:
    """Section coordinates of two links' state x just before heelstrike, as symbols."""
    if structure.kneed:
        return [x[1], x[2], x[3]]
    return [x[1], *heelstrike(p, x[1], x[2], x[3], False)[: structure.dimension - 1]]


def _matrix(name: str, n: int, m: int) -> list[list[Sym]]:
    """Variables of an n x m matrix."""
    flat = hy.make_vars(*(f"{name}{i}_{j}" for i in range(n) for j in range(m)))
    return [list(flat[i * m : (i + 1) * m]) for i in range(n)]


def _flat(matrix: list[list[Sym]]) -> list[Sym]:
    """Entries of a matrix, row by row."""
    return [x for row in matrix for x in row]


def _inverse(J: list[list[Sym]]) -> list[list[Sym]]:
    """Inverse of a 2 x 2 or 3 x 3 matrix of symbols by its adjugate."""
    n = len(J)
    if n == 2:
        det = J[0][0] * J[1][1] - J[0][1] * J[1][0]
        return [[J[1][1] / det, -J[0][1] / det], [-J[1][0] / det, J[0][0] / det]]
    minor = [
        [
            J[(i + 1) % 3][(j + 1) % 3] * J[(i + 2) % 3][(j + 2) % 3]
            - J[(i + 1) % 3][(j + 2) % 3] * J[(i + 2) % 3][(j + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]
    det = J[0][0] * minor[0][0] + J[0][1] * minor[0][1] + J[0][2] * minor[0][2]
    return [[minor[j][i] / det for j in range(3)] for i in range(3)]


def _derivatives_along(values: list[Sym], x: list[Sym], D: list[list[Sym]]) -> list[list[Sym]]:
    """Derivative of each value by x along the directions D."""
    gradients = [[hy.diff(v, coordinate) for coordinate in x] for v in values]
    return [[sum((g * D[i][d] for i, g in enumerate(row)), ZERO) for d in range(len(D[0]))] for row in gradients]


def matvec(A: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Product A v of every lane, always added in the same order.

    Parameters
    ----------
    A : ndarray, shape (i, j, n)
    v : ndarray, shape (j, n)

    Returns
    -------
    ndarray, shape (i, n)
    """
    total = A[:, 0] * v[0]
    for j in range(1, A.shape[1]):
        total = total + A[:, j] * v[j]
    return total


class StrideMap:
    """The step map of one structure: compiled flows and the compiled algebra between them."""

    def __init__(self, structure: Structure):
        self.structure, self.m = structure, structure.dimension
        self.kneed = structure.kneed
        self.start_size = 6 if self.kneed else 4
        self._start = self._compile_start()
        if self.kneed:
            self._knee = self._compile_knee()
        self._finish = self._compile_finish()

    def _function(self, outputs: list[Sym], variables: list[Sym]) -> hy.cfunc:
        return hy.cfunc(outputs, vars=variables, compact_mode=False)

    def _compile_start(self) -> hy.cfunc:
        p = Symbols(self.structure)
        y = list(hy.make_vars(*(f"y{i}" for i in range(self.m))))
        state = start_of_step(self.structure, p, y)
        return self._function(state + _flat([[hy.diff(x, v) for v in y] for x in state]), [*y, *p.variables])

    def _compile_knee(self) -> hy.cfunc:
        """From the end of three links to the start of two, with directions (y, defect, slope).

        The flow of two links carries its own field and three unit vectors beside it, whatever the directions: a part
        along the field is only a shift of time, which the next event takes up. So each direction is given by its
        four parts, the field's first.
        """
        p = Symbols(self.structure)
        m = self.m + 1
        x = list(hy.make_vars(*(f"x{i}" for i in range(6))))
        D = _matrix("d", 6, m)
        q, rate = x[:3], x[3:]
        M, f = rows(p, q, rate, True)
        field = [*rate, *Solver(M)(f)]
        closing = rate[1] - rate[2]
        shift = -(q[1] - q[2]) / closing
        shift_by = [-(D[1][d] - D[2][d]) / closing for d in range(m)]
        moved = [[D[i][d] + field[i] * shift_by[d] for d in range(m)] for i in range(6)]
        defect = [field[i] * shift for i in range(6)]
        lock = lock_knee(p, x)
        columns = [[*moved[i][: self.m], defect[i], *moved[i][self.m :]] for i in range(6)]
        by_direction = _derivatives_along(lock, x, columns)
        M, f = rows(p, lock[:2], lock[2:], False)
        after = [lock[2], lock[3], *Solver(M)(f)]
        along = [d / after[0] for d in by_direction[0]]
        parts = [along] + [[d - c * after[i] for d, c in zip(by_direction[i], along, strict=True)] for i in range(1, 4)]
        strike = [x[i] + defect[i] for i in range(6)] + _flat([moved[i][: self.m] for i in range(6)])
        return self._function(lock + _flat(parts) + [shift, *shift_by, *strike], [*x, *_flat(D), *p.variables])

    def _compile_finish(self) -> hy.cfunc:
        """From the end of two links to the image on the section, its derivatives and the Newton step."""
        p = Symbols(self.structure)
        m, defect = self.m, int(self.kneed)
        y = list(hy.make_vars(*(f"y{i}" for i in range(m))))
        x = list(hy.make_vars(*(f"x{i}" for i in range(4))))
        carried = D = _matrix("d", 4, 4 if self.kneed else m + 1)
        parts: list[list[Sym]] = _matrix("c", 4, m + 2) if self.kneed else []
        if self.kneed:
            D = [
                [
                    sum((parts[1 + k][d] * carried[i][k] for k in range(3)), carried[i][3] if d > m else ZERO)
                    for d in range(m + 2)
                ]
                for i in range(4)
            ]
        M, f = rows(p, x[:2], x[2:], False)
        field = [x[2], x[3], *Solver(M)(f)]
        closing = x[2] + x[3]
        base = [(defect and D[i][m]) or ZERO for i in range(4)]
        shift = -(x[0] + x[1] + base[0] + base[1]) / closing
        shift_by = [-(D[0][d] + D[1][d]) / closing for d in range(m + defect + 1)]
        keep = [d for d in range(m + defect + 1) if not (defect and d == m)]
        columns = [[D[i][d] + field[i] * shift_by[d] for d in keep] + [base[i] + field[i] * shift] for i in range(4)]
        image = end_of_step(self.structure, p, x)
        by_direction = _derivatives_along(image, x, columns)
        jacobian = [row[:m] for row in by_direction]
        moved = [image[i] + by_direction[i][-1] for i in range(m)]
        inverse = _inverse([[float(i == j) - jacobian[i][j] for j in range(m)] for i in range(m)])
        residual = [image[i] - y[i] + by_direction[i][-1] for i in range(m)]
        newton = [sum((inverse[i][j] * residual[j] for j in range(m)), ZERO) for i in range(m)]
        impact = [x[2] + base[2] + field[2] * shift, x[3] + base[3] + field[3] * shift]
        if parts:
            shift, shift_by = shift - parts[0][m], [a - b for a, b in zip(shift_by, parts[0], strict=True)]
        outputs = [
            *moved,
            *_flat(jacobian),
            *_flat(inverse),
            *newton,
            shift,
            *(shift_by[d] for d in keep),
            *impact,
            *columns[2][:m],
            *columns[3][:m],
            closing,
            *(row[m] for row in by_direction),
        ]
        return self._function(outputs, [*y, *x, *_flat(carried), *_flat(parts), *p.variables])

    def _apply(self, function: hy.cfunc, inputs: np.ndarray) -> np.ndarray:
        """Call a compiled function on lanes padded to whole SIMD groups, so that every lane runs the same code."""
        # A register's sines are computed in another way if one of its arguments is not finite.
        lost = ~np.isfinite(inputs).all(axis=0)
        result = function(whole_groups(np.where(lost, 0.0, inputs), 4 * LANES))[:, : inputs.shape[1]]
        result[:, lost] = np.nan
        return result

    def start(self, y: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """State just after heelstrike, then its derivatives by y.

        Parameters
        ----------
        y : ndarray, shape (m, n)
            Scaled section coordinates.
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.

        Returns
        -------
        ndarray, shape (start_size (1 + m), n)
            Scaled angles and rates; the matrix of derivatives follows row by row.
        """
        return self._apply(self._start, np.vstack([y, parameters]))

    def __call__(
        self,
        y: np.ndarray,
        times: np.ndarray,
        parameters: np.ndarray,
        slope: bool = False,
        samples: int = 0,
        coarse: bool = False,
    ) -> Stride:
        """Evaluate steps and their derivatives.

        Parameters
        ----------
        y : ndarray, shape (m, n)
            Scaled section coordinates.
        times : ndarray, shape (k, n) [sqrt(leg/g)]
            Initial guesses of the heelstrike time, or of (kneestrike, heelstrike).
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.
        slope : bool
            Also differentiate by the slope.
        samples : int
            Equal intervals of each phase at whose ends the motion is also returned.
        coarse : bool
            Integrate to the search's tolerance only.

        Returns
        -------
        Stride
            NaN in lanes whose integration failed.
        """
        m, n = y.shape
        size = self.start_size
        start, by_y = np.split(self.start(y, parameters), [size])
        D = by_y.reshape(size, m, n)
        if slope:
            D = np.concatenate([D, np.zeros((size, 1, n))], axis=1)
        motion, strike, parts = [], np.empty((0, n)), np.empty((0, n))
        if self.kneed:
            integrate = flow(self.structure, True, m + slope, slope, coarse)
            final, phase = integrate(np.vstack([start, _lanes(D)]), parameters, times[0], samples)
            motion.append(phase)
            out = self._apply(self._knee, np.vstack([final[:6], _unlanes(final[6:], 6, m + 1), parameters]))
            start2, parts, knee_shift, strike = np.split(out, np.cumsum([4, 4 * (m + 2), 2 + m]))
            D = np.broadcast_to(np.eye(4, 3 + slope, -1)[:, :, None], (4, 3 + slope, n))
            duration = times[1] - times[0]
        else:
            start2, duration = start, times[0]
        integrate = flow(self.structure, False, D.shape[1], slope, coarse)
        final, phase = integrate(np.vstack([start2, _lanes(D)]), parameters, duration, samples)
        motion.append(phase)
        directions = _unlanes(final[4:], 4, 4 if self.kneed else m + 1)
        out = self._apply(self._finish, np.vstack([y, final[:4], directions, parts, parameters]))
        image, jacobian, inverse, newton, shift, shift_by, impact, impact_by_y, closing, by_slope = np.split(
            out, np.cumsum([m, m * m, m * m, m, 1, m + 1, 2, 2 * m, 1])
        )
        all_times, all_by = times[-1:] + shift, shift_by[None]
        if self.kneed:
            first = times[:1] + knee_shift[:1]
            first_by = knee_shift[1:][None]
            # Heelstrike is timed from the start of the step; its flow begins at kneestrike.
            all_times = np.vstack([first, all_times + knee_shift[:1]])
            all_by = np.concatenate([first_by, all_by + first_by])
        return Stride(
            y,
            image,
            jacobian.reshape(m, m, n),
            inverse.reshape(m, m, n),
            newton,
            all_times,
            all_by[:, :m],
            by_slope if slope else by_slope[:0],
            all_by[:, m] if slope else all_by[:0, m],
            impact,
            impact_by_y.reshape(2, m, n),
            start,
            closing[0],
            strike[:6],
            strike[6:].reshape(len(strike[:6]), m, n),
            motion,
        )


def _lanes(D: np.ndarray) -> np.ndarray:
    """Directions (size, d, n) in the order of the flow's states: angles, then rates, one direction after another."""
    return D.transpose(1, 0, 2).reshape(-1, D.shape[2])


def _unlanes(flat: np.ndarray, size: int, directions: int) -> np.ndarray:
    """Back from the flow's order to rows of (size, directions); the slope's direction is zero where it has none."""
    n = flat.shape[1]
    rows = np.zeros((size, directions, n))
    rows[:, : len(flat) // size] = flat.reshape(-1, size, n).transpose(1, 0, 2)
    return rows.reshape(-1, n)


@functools.lru_cache(maxsize=64)
def stride_map(structure: Structure) -> StrideMap:
    """Return the compiled step map of a structure, one a process."""
    prepare_compiler()
    return StrideMap(structure)
