"""The timed problems: one step, its Jacobian, a fixed point, a grid and the branches of
one walker.
"""

from dataclasses import dataclass, field
from typing import Any

import heyoka as hy
import numpy as np

from benchmarks import peers
from benchmarks.harness import Case, largest_error
from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.contract.registry import COSTLY, GAITS, VARIABLES
from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.mechanics.equations import system
from gaitsweep.tasks.mechanics.kernel import FLOWS
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies import solve_points
from gaitsweep.tasks.walkers.resolve import resolve
from soak.extended_reference import Precise, best_kind

#: Lanes that gaitsweep's methods carry at a time; times are for one lane.
LANES = 64
EPS = float(np.finfo(float).eps)
#: Tolerances of work-precision curves.
OURS = (EPS, 1e-13, 1e-10, 1e-7, 1e-4)
THEIRS = {
    "scipy DOP853": (1e-13, 1e-10, 1e-7, 1e-4),
    "scipy RK45": (1e-11, 1e-8, 1e-5),
    "scipy LSODA": (1e-12, 1e-9, 1e-6),
    "scipy Radau": (1e-9, 1e-6, 1e-4),
    "numba DOP853": (1e-14, 1e-11, 1e-8, 1e-5),
    "heyoka scalar": (EPS, 1e-11, 1e-7),
}
#: Peers that also solve fixed points, lines of slopes and branches.
SOLVERS = ("scipy DOP853", "numba DOP853", "heyoka scalar")
GRID_WANT = tuple(v for v in VARIABLES if VARIABLES[v].group not in COSTLY)


@dataclass
class Family:
    """One walker at one slope: its gait in double and in extended precision, and the
    compiled maps.
    """

    name: str
    slope: float
    problem: Problem
    atlas: dict[str, np.ndarray]
    w: np.ndarray
    slopes: np.ndarray
    kind: str
    precise: Precise
    algebra: peers.Algebra
    exact: dict[str, np.ndarray]
    exact_y: np.ndarray
    others: dict[str, Precise] = field(default_factory=dict)

    def in_kind(self, kind: str, wide: Any) -> Precise:
        """The step map in a floating-point type, compiled once."""
        if kind not in self.others:
            self.others[kind] = Precise(self.problem.structure, wide)
        return self.others[kind]

    @property
    def scale(self) -> np.ndarray:
        """Powers of two that divide the states."""
        return np.exp2(np.floor(np.log2(np.exp(self.w[0]))))

    @property
    def y(self) -> np.ndarray:
        """Scaled section coordinates of every lane."""
        angle = np.exp(self.w[0])
        return np.vstack([angle, angle * self.w[1 : self.problem.m]]) / self.scale


def family(name: str, slope: float) -> Family:
    """Solve a walker's long gait on lanes around a slope, and its first lane in
    extended precision.
    """
    problem = Problem(resolve(name, {}))
    arrays = atlases.to_arrays(atlases.survey(problem))
    slopes = slope * np.concatenate([[1.0], np.linspace(0.9, 1.1, LANES - 1)])
    q = np.log(slopes)
    for branch in atlases.from_arrays(arrays):
        for index, Z, _ in branch.guesses(q):
            if len(index) == LANES:
                w, converged = newton(problem, Z[:-1], q)
                if converged.all():
                    return _with_reference(name, slope, problem, arrays, w, slopes)
    raise ValueError(f"`slope` must have a gait of {name} all around it; got {slope}.")


def _with_reference(
    name: str,
    slope: float,
    problem: Problem,
    arrays: dict[str, np.ndarray],
    w: np.ndarray,
    slopes: np.ndarray,
) -> Family:
    kind, wide = best_kind()
    precise = Precise(problem.structure, wide)
    family = Family(
        name,
        slope,
        problem,
        arrays,
        w,
        slopes,
        kind,
        precise,
        peers.Algebra(problem),
        {},
        np.zeros(0),
        {kind: precise},
    )
    y, times, parameters = _lane(family, precise)
    family.exact = precise.settled_stride(y, times, parameters)
    family.exact_y, _ = precise.fixed_point(y, times, parameters)
    return family


def _lane(f: Family, precise: Precise) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Section coordinates, event times and parameters of the first lane in the wider
    type.
    """
    parameters = f.problem.parameters(f.slopes[:1], f.scale[:1])[:, 0]
    times = f.exact["times"] if f.exact else f.w[f.problem.m :, 0]
    return precise.array(f.y[:, 0]), precise.array(times), precise.array(parameters)


class Lanes:
    """Steps by gaitsweep's integrator at a given tolerance, without variations, over
    given event times.
    """

    def __init__(self, f: Family, tolerance: float):
        structure = f.problem.structure
        self.f, self.width = f, hy.recommended_simd_size()

        self.times = np.tile(
            np.asarray([float(t) for t in f.exact["times"]])[:, None], LANES
        )
        self.y, self.parameters = (
            f.y[:, [0] * LANES],
            f.problem.parameters(f.slopes[[0] * LANES], f.scale[[0] * LANES]),
        )

        def build(free: bool) -> Any:
            motion = system(structure, free, 0, False)
            flow = hy.taylor_adaptive_batch(
                motion.equations,
                np.zeros((len(motion.equations), self.width)),
                tol=tolerance,
            )
            return flow, motion.parameters()(np.ascontiguousarray(self.parameters))

        self.locked = build(False)
        self.free = build(True) if structure.kneed else None

    def _integrate(
        self, flow: Any, state: np.ndarray, duration: np.ndarray
    ) -> np.ndarray:
        integrator, constants = flow
        out = np.empty_like(state)
        for k in range(0, LANES, self.width):
            lanes = slice(k, k + self.width)
            integrator.set_time(0.0)
            integrator.state[:] = state[:, lanes]
            integrator.pars[:] = constants[:, lanes]
            integrator.propagate_until(duration[lanes])
            out[:, lanes] = integrator.state
        return out

    def __call__(self) -> np.ndarray:
        """Images of all lanes, shape (m, LANES)."""
        state = self.f.algebra.start(self.y, self.parameters)
        duration = self.times[-1]
        if self.free is not None:
            state = self._integrate(self.free, state, self.times[0])
            state = self.f.algebra.lock(np.vstack([state, self.parameters]))
            duration = self.times[1] - self.times[0]
        state = self._integrate(self.locked, state, duration)
        return self.f.algebra.image(np.vstack([state, self.parameters]))


def _peer_integrators(f: Family) -> dict[str, Any]:
    """Integration to an event, by each peer."""
    integrators = {
        name: peers.by_scipy(name.split()[1])
        for name in THEIRS
        if name.startswith("scipy")
    }
    if "numba DOP853" in THEIRS:
        integrators["numba DOP853"] = peers.by_numba()
    if "heyoka scalar" in THEIRS:
        integrators["heyoka scalar"] = peers.Scalar(f.problem)
    return integrators


def _tolerances(name: str, quick: bool, newton: bool = False) -> tuple[float, ...]:
    """A peer's tolerances; for Newton's method, which takes dozens of steps, without
    the loosest.
    """
    chosen = THEIRS[name][:-1] if newton else THEIRS[name]
    return chosen[::2] if quick else chosen


def strides(f: Family, quick: bool) -> list[Case]:
    """One step, against its image in extended precision."""
    exact = f.exact["image"]
    cases = []
    for tolerance in OURS:
        run = Lanes(f, tolerance)
        case = Case(f.name, "stride", "heyoka, lanes", tolerance, run, LANES)
        case.error = largest_error(run()[:, 0], exact)
        cases.append(case)
    y = f.y[:, 0] * f.scale[0]
    for name, integrate in _peer_integrators(f).items():
        for tolerance in _tolerances(name, quick):
            peer = peers.Peer(f.algebra, f.slope, integrate, tolerance)
            case = Case(
                f.name, "stride", name, tolerance, lambda peer=peer: peer.stride(y)
            )
            case.error = largest_error(
                case.run()[: f.problem.m], exact * f.precise.kind(f.scale[0])
            )
            cases.append(case)
    return cases


def jacobians(f: Family, quick: bool) -> list[Case]:
    """The Jacobian of a step, exact in two tolerances and two precisions, and by
    differences.
    """
    exact = f.exact["jacobian"]
    q, m = np.log(f.slopes), f.problem.m
    cases = []
    for setting, coarse in ((EPS, False), (1e-7, True)):

        def ours(coarse: bool = coarse) -> np.ndarray:
            return f.problem.stride(f.w, q, coarse=coarse)[0].jacobian

        case = Case(f.name, "jacobian", "ours, exact", setting, ours, LANES)
        case.error = largest_error(ours()[..., 0], exact)
        cases.append(case)
    for kind, wide in (
        ("long double", np.longdouble),
        *([("real128", hy.real128)] if f.kind == "real128" else []),
    ):
        precise = f.in_kind(kind, wide)
        lane = _lane(f, precise)

        def widened(precise: Precise = precise, lane: Any = lane) -> np.ndarray:
            return precise.stride(*lane)["jacobian"]

        rounding = (
            2.0**-113 if kind == "real128" else float(np.finfo(np.longdouble).eps)
        )
        case = Case(f.name, "jacobian", f"{kind}, exact", rounding, widened)
        # The reference has no error against itself.
        case.error = float("nan") if kind == f.kind else largest_error(widened(), exact)
        cases.append(case)
    y = f.y[:, 0] * f.scale[0]
    for name, integrate in _peer_integrators(f).items():
        if name not in SOLVERS:
            continue
        for tolerance in _tolerances(name, quick, newton=True):
            peer = peers.Peer(f.algebra, f.slope, integrate, tolerance)
            case = Case(
                f.name,
                "jacobian",
                f"{name}, differences",
                tolerance,
                lambda peer=peer: peer.jacobian(y),
            )
            case.error = largest_error(case.run(), exact)
            cases.append(case)

    def differences() -> np.ndarray:
        """Central differences of gaitsweep's own map, with the directions of one gait
        as lanes.
        """
        h = f.y[0, 0] * EPS ** (1 / 3)
        changes = np.concatenate([np.eye(m) * h, -np.eye(m) * h]).T
        n = 2 * m
        stride = f.problem.map(
            f.y[:, [0] * n] + changes,
            f.w[m:, [0] * n],
            f.problem.parameters(f.slopes[[0] * n], f.scale[[0] * n]),
        )
        return (stride.image[:, :m] - stride.image[:, m:]) / (2 * h)

    case = Case(f.name, "jacobian", "ours, differences", EPS, differences)
    case.error = largest_error(differences(), exact)
    cases.append(case)
    return cases


def fixed_points(f: Family, quick: bool) -> list[Case]:
    """Newton's method from a guess with a relative error of a thousandth, multipliers
    included.
    """
    exact, m, q = f.exact_y, f.problem.m, np.log(f.slopes)
    start = f.w.copy()
    start[0] += 1e-3
    start[1:m] *= 0.999
    cases = []
    for setting, coarse in ((EPS, False), (1e-7, True)):

        def ours(coarse: bool = coarse) -> np.ndarray:
            w, _ = newton(f.problem, start, q, coarse=coarse)
            stride, scale = f.problem.stride(w, q, coarse=coarse)
            multipliers(stride.jacobian, 3)
            return (stride.y + stride.newton) * scale / f.scale

        before = _evaluations(f)
        error = largest_error(ours()[:, 0], exact)
        case = Case(f.name, "fixed point", "ours", setting, ours, LANES, error)
        case.work = (_evaluations(f) - before) / LANES
        cases.append(case)
    wide = f.in_kind("long double", np.longdouble)
    lane = _lane(f, wide)

    def polished() -> np.ndarray:
        return wide.fixed_point(*lane, turns=1)[0]

    case = Case(
        f.name,
        "fixed point",
        "long double, from double",
        float(np.finfo(np.longdouble).eps),
        polished,
    )
    case.error = largest_error(polished(), exact)
    cases.append(case)
    y = f.y[:, 0] * f.scale[0] * np.exp(1e-3) * np.where(np.arange(m) == 0, 1.0, 0.999)
    for name, integrate in _peer_integrators(f).items():
        if name not in SOLVERS:
            continue
        for tolerance in _tolerances(name, quick, newton=True):
            peer = peers.Peer(f.algebra, f.slope, integrate, tolerance)
            case = Case(
                f.name,
                "fixed point",
                f"{name}, differences",
                tolerance,
                lambda peer=peer: peer.fixed_point(y),
            )
            case.error = largest_error(
                case.run()[:m], exact * f.precise.kind(f.scale[0])
            )
            cases.append(case)
    return cases


def _evaluations(f: Family) -> int:
    return sum(flow.evaluations for flow in FLOWS.values() if flow.angles == 4)


def grid(f: Family, n: int) -> list[Case]:
    """A line of slopes with all variables but the violations; the error is that of the
    angle at its first point.
    """
    slopes = np.concatenate([[f.slope], np.geomspace(1e-3, f.slope * 3, n - 1)])
    line = {"walker": f.name, "set": {}}
    last: dict[str, np.ndarray] = {}

    def run() -> np.ndarray:
        last.update(
            solve_points.points(
                {"line": line, "slope": slopes, "want": GRID_WANT, "gaits": GAITS},
                [f.atlas],
            )
        )
        return last["stance_angle"]

    case = Case(f.name, "grid", "ours", EPS, run, n)
    angles = run()[0]
    exact = float(abs(f.exact_y[0])) * f.scale[0]
    case.error = float(np.nanmin(np.abs(angles / exact - 1)))
    case.work = float((last["status"] == 0).sum() / n)
    return [case, *_peers_along(f, "grid", f.slope * np.geomspace(1.0, 1.1, 4))]


def _peers_along(f: Family, problem: str, slopes: np.ndarray) -> list[Case]:
    """Peers on the long gait alone, each slope from the solution at the one before; the
    error is that at the first.
    """
    m, cases = f.problem.m, []
    first = f.y[:, 0] * f.scale[0]
    for name, integrate in _peer_integrators(f).items():
        if name not in SOLVERS:
            continue
        for tolerance in (
            _tolerances(name, quick=False, newton=True)
            if problem == "grid"
            else THEIRS[name][:1]
        ):

            def run(
                integrate: Any = integrate, tolerance: float = tolerance
            ) -> np.ndarray:
                y, solutions = first * np.exp(1e-3), []
                for slope in slopes:
                    # A gait scales roughly as the cube root of the slope, a good enough
                    # guess for Newton's method.
                    solution = peers.Peer(
                        f.algebra, float(slope), integrate, tolerance
                    ).fixed_point(y)[:m]
                    solutions.append(solution)
                    y = solution * (slopes[1] / slopes[0]) ** (1 / 3)
                return solutions[0]

            case = Case(
                f.name, problem, f"{name}, differences", tolerance, run, len(slopes)
            )
            case.error = largest_error(run(), f.exact_y * f.precise.kind(f.scale[0]))
            case.work = 1.0
            cases.append(case)
    return cases


def branches(f: Family) -> list[Case]:
    """All branches of the walker with their folds and ends: the cost of one line of a
    study before its points.
    """

    def run() -> np.ndarray:
        return np.array([len(b.q) for b in atlases.survey(f.problem)], float)

    nodes = int(f.atlas["lengths"].sum())
    # A node of the peers is a fixed point, without folds, ends or tangents.
    return [
        Case(f.name, "branch", "ours, whole", EPS, run, nodes, np.nan, float(nodes)),
        *_peers_along(f, "branch", f.slope * np.geomspace(1.0, 0.8, 4)),
    ]
