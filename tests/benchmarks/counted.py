"""Counted work, and the share of a line's time that is spent in compiled flows and
maps.
"""

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any
from unittest import mock

import numpy as np

from benchmarks import problems
from benchmarks.harness import TICK
from gaitsweep.tasks.contract.registry import ALWAYS, GAITS, VARIABLES, nameable
from gaitsweep.tasks.gaits import polish
from gaitsweep.tasks.measures import gaits as measured
from gaitsweep.tasks.measures import violations
from gaitsweep.tasks.mechanics.kernel import FLOWS, Flow
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.step_map import StrideMap
from gaitsweep.tasks.studies import solve_points

#: Studies that want fewer and fewer variables: a name, the variables, and the gaits.
STUDIES: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    (
        "everything",
        tuple(v for v in nameable() if VARIABLES[v].group != "proofs"),
        GAITS,
    ),
    ("all but violations", problems.GRID_WANT, GAITS),
    (
        "angle and multipliers",
        ("stance_angle", "multiplier_real", "multiplier_imag"),
        GAITS,
    ),
    ("angle", ("stance_angle",), GAITS),
    ("angle of the long gait", ("stance_angle",), ("long",)),
)


@contextlib.contextmanager
def _watched(watch: Callable[..., Any], *places: tuple[Any, str]) -> Iterator[None]:
    """Call `watch(name, function, *arguments)` in place of functions of modules and
    methods of classes.
    """
    with contextlib.ExitStack() as stack:
        for owner, name in places:
            kept = getattr(owner, name)

            def instead(
                *arguments: Any, name: str = name, kept: Any = kept, **options: Any
            ) -> Any:
                return watch(name, kept, *arguments, **options)

            stack.enter_context(mock.patch.object(owner, name, instead))
        yield


def work(
    name: str,
    atlas: dict[str, np.ndarray],
    slopes: np.ndarray,
    want: Sequence[str],
    gaits: Sequence[str] = GAITS,
) -> dict[str, float]:
    """Count the work of the points of one line."""
    params = {
        "line": {"walker": name, "set": {}},
        "slope": slopes,
        "want": want,
        "gaits": gaits,
    }
    solve_points.points({**params, "slope": slopes[:1]}, [atlas])
    for flow in FLOWS.values():
        flow.evaluations = flow.idle = 0
    lanes: Counter[str] = Counter()
    sizes: dict[str, Callable[..., int]] = {
        "verify_steps": lambda problem, w, *others: w.shape[1],
        "multipliers": lambda jacobian, width: jacobian.shape[2],
        "measure": lambda walker, motion, impact, times, slope, *others: len(slope),
        "refine": lambda *others: 1,
    }

    def count(
        name: str, function: Callable[..., Any], *arguments: Any, **options: Any
    ) -> Any:
        lanes[name] += sizes[name](*arguments)
        return function(*arguments, **options)

    with _watched(
        count,
        *zip((polish, measured, violations, extended_precision), sizes, strict=True),
    ):
        points = solve_points.points(params, [atlas])
    flows = [flow for flow in FLOWS.values() if flow.evaluations]
    variables = [v for v in VARIABLES if v in want or v in ALWAYS]
    return {
        "gaits": float((points["status"] == 0).sum()),
        "strides": float(sum(flow.evaluations for flow in flows if flow.angles == 4)),
        "event checks": float(lanes["verify_steps"]),
        "eigenvalue problems": float(lanes["multipliers"]),
        "strides for violations": float(lanes["measure"]),
        "more digits": float(lanes["refine"]),
        "idle lanes": float(sum(flow.idle for flow in flows)),
        "bytes": float(sum(points[v].nbytes for v in variables)),
    }


def less_and_less(f: problems.Family, n: int) -> list[dict[str, float | str]]:
    """Count the work of the studies in `STUDIES` on one line of n slopes."""
    slopes = np.geomspace(1e-3, f.slope * 3, n)
    return [
        {"study": name, **work(f.name, f.atlas, slopes, want, gaits)}
        for name, want, gaits in STUDIES
    ]


def line(f: problems.Family, n: int) -> dict[str, float]:
    """Steps a gait (each is one Newton step) and the share of time in compiled flows
    and maps, on one line.
    """
    slopes = np.geomspace(1e-3, f.slope * 3, n)
    params = {
        "line": {"walker": f.name, "set": {}},
        "slope": slopes,
        "want": problems.GRID_WANT,
        "gaits": GAITS,
    }
    solve_points.points(params, [f.atlas])
    for flow in FLOWS.values():
        flow.evaluations = 0
    inside = 0.0

    def clock(
        name: str, function: Callable[..., Any], *arguments: Any, **options: Any
    ) -> Any:
        nonlocal inside
        start = time.process_time()
        found = function(*arguments, **options)
        inside += time.process_time() - start
        return found

    with _watched(clock, (Flow, "_advance"), (StrideMap, "_apply")):
        start = time.process_time()
        points = solve_points.points(params, [f.atlas])
        whole = time.process_time() - start
    gaits = int((points["status"] == 0).sum())
    # Every step ends with the flow of locked knees, which therefore counts steps.
    strides = sum(flow.evaluations for flow in FLOWS.values() if flow.angles == 4)
    flights = sum(flow.evaluations for flow in FLOWS.values())
    return {
        "grid points": n,
        "gaits": gaits,
        "microseconds a grid point": 1e6 * whole / n,
        "microseconds a gait": 1e6 * whole / max(gaits, 1),
        "strides a gait": strides / max(gaits, 1),
        "flights a gait": flights / max(gaits, 1),
        "share in flows and maps": inside / whole,
    }


def roofline(
    f: problems.Family, peak: float, repeats: int = 5
) -> list[dict[str, float | str]]:
    """Floating-point rate of each flow of a walker's points, from its decomposition,
    and its share of the peak rate.

    A Taylor step of order p costs about p^2 operations for each product, quotient,
    power, sine or cosine among the u-variables (twice that for the last two), 2 p for
    each linear one and 2 p for each state's sum.
    """
    q = np.log(f.slopes)
    f.problem.stride(f.w, q)
    for flow in FLOWS.values():
        flow.evaluations = 0
    f.problem.stride(f.w, q)
    rates: list[dict[str, float | str]] = []
    for flow in (flow for flow in FLOWS.values() if flow.evaluations):
        ta, order = flow._ta, flow._ta.order
        states, lanes = ta.state.shape
        nonlinear, trigonometric, linear = _counts(ta)
        flops = lanes * (
            order**2 * (nonlinear + 2 * trigonometric)
            + 2 * order * (linear + 2 * states)
        )
        ta.set_time(0.0)
        ta.state[:] = 0.1
        ta.pars[:] = 0.5
        best = np.inf
        tiny = np.full(lanes, 1e-6)
        for _ in range(repeats):
            start, steps = time.process_time(), 0
            while (seconds := time.process_time() - start) < TICK:
                for _ in range(24):
                    ta.step(tiny)
                steps += 24
            best = min(best, seconds / steps)
        rates.append(
            {
                "flow": "free knee" if flow.angles == 6 else "locked",
                "states": states,
                "u-variables": float(len(ta.decomposition)),
                "products": float(nonlinear),
                "sines and cosines": float(trigonometric),
                "order": float(order),
                "kilobytes of coefficients": len(ta.decomposition)
                * (order + 1)
                * lanes
                * 8
                / 1024,
                "microseconds a step": 1e6 * best,
                "GFlop/s": flops / best / 1e9,
                "share of peak": flops / best / peak,
            }
        )
    return rates


def _counts(ta: Any) -> tuple[int, int, int]:
    """Nonlinear, trigonometric and linear u-variables of an integrator."""
    nonlinear = trigonometric = linear = 0
    for expression, _ in ta.decomposition:
        text = str(expression)
        if "sin(" in text or "cos(" in text:
            trigonometric += 1
        elif (
            text.count("u_") >= 2 and ("*" in text or "div(" in text or "prod" in text)
        ) or "**" in text:
            nonlinear += 1
        elif "u_" in text:
            linear += 1
    return nonlinear, trigonometric, linear
