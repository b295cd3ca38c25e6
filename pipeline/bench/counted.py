"""Work that is counted, not timed, and where the time of a line goes."""

from __future__ import annotations

import gc
import time
from typing import Any

import numpy as np

from pipeline.bench import problems
from tasks import solve
from tasks.gait.stride import StrideMap
from tasks.mechanics.kernel import Flow
from tasks.registry import GAITS


def flows() -> list[Flow]:
    """Every compiled flow of this process."""
    return [x for x in gc.get_objects() if type(x) is Flow]


class Clock:
    """Adds up the time spent in some methods while it is running."""

    def __init__(self, *methods: tuple[type, str]):
        self.methods, self.seconds = methods, 0.0
        self._kept: list[Any] = []

    def __enter__(self) -> Clock:
        for owner, name in self.methods:
            kept = getattr(owner, name)
            self._kept.append(kept)

            def timed(*args: Any, kept: Any = kept, **kwargs: Any) -> Any:
                start = time.perf_counter()
                try:
                    return kept(*args, **kwargs)
                finally:
                    self.seconds += time.perf_counter() - start
            setattr(owner, name, timed)
        return self

    def __exit__(self, *_: object) -> None:
        for (owner, name), kept in zip(self.methods, self._kept, strict=True):
            setattr(owner, name, kept)


def line(f: problems.Family, n: int) -> dict[str, float]:
    """Strides a gait (each is one Newton step) and the compiled share of the wall time, on one line of n slopes."""
    slopes = np.geomspace(1e-3, f.slope * 3, n)
    params = {"line": {"walker": f.name, "set": {}}, "slope": slopes, "want": problems.GRID_WANT, "gaits": GAITS}
    solve.points(params, [f.atlas])
    for flow in flows():
        flow.evaluations = 0
    with Clock((Flow, "_group"), (StrideMap, "_apply")) as clock:
        start = time.perf_counter()
        found = solve.points(params, [f.atlas])
        wall = time.perf_counter() - start
    gaits = int((found["status"] == 0).sum())
    # Every stride ends with the locked flow: it counts strides, whatever the walker.
    strides = sum(flow.evaluations for flow in flows() if flow.angles == 4)
    flown = sum(flow.evaluations for flow in flows())
    return {"grid points": n, "gaits": gaits, "microseconds a grid point": 1e6 * wall / n,
            "microseconds a gait": 1e6 * wall / max(gaits, 1), "strides a gait": strides / max(gaits, 1),
            "flights a gait": flown / max(gaits, 1),
            "share in compiled code": clock.seconds / wall}


def roofline(f: problems.Family, peak: float, repeats: int = 5) -> list[dict[str, float | str]]:
    """Floating-point rate of each flow of a walker's points, from its decomposition, beside the machine's peak.

    Notes
    -----
    A Taylor step of order p costs about p^2 operations for each product, quotient, power, sine or cosine among the
    u-variables (twice that for the last two), 2 p for each linear one and 2 p for each state's sum.
    """
    q = np.log(f.slopes)
    f.problem.stride(f.w, q)
    kept = []
    for flow in flows():
        before = flow.evaluations
        flow.evaluations = 0
        kept.append((flow, before))
    f.problem.stride(f.w, q)
    used = [flow for flow, _ in kept if flow.evaluations]
    found: list[dict[str, float | str]] = []
    for flow in used:
        ta, order = flow._ta, flow._ta.order
        lanes = ta.state.shape[1]
        nonlinear, trigonometric, linear = _counts(ta)
        flops = lanes * (order**2 * (nonlinear + 2 * trigonometric) + 2 * order * (linear + 2 * flow.size))
        ta.set_time(0.0)
        ta.state[:] = 0.1
        ta.pars[:] = 0.5
        steps, best = 24, np.inf
        tiny = np.full(lanes, 1e-6)
        for _ in range(repeats):
            start = time.perf_counter()
            for _ in range(steps):
                ta.step(tiny)
            best = min(best, (time.perf_counter() - start) / steps)
        found.append({
            "flow": "free knee" if flow.angles == 6 else "locked", "states": flow.size,
            "u-variables": float(len(ta.decomposition)), "products": float(nonlinear),
            "sines and cosines": float(trigonometric), "order": float(order),
            "kilobytes of coefficients": len(ta.decomposition) * (order + 1) * lanes * 8 / 1024,
            "microseconds a step": 1e6 * best, "GFlop/s": flops / best / 1e9, "share of peak": flops / best / peak})
    return found


def _counts(ta: Any) -> tuple[int, int, int]:
    """Nonlinear, trigonometric and linear u-variables of an integrator."""
    nonlinear = trigonometric = linear = 0
    for expression, _ in ta.decomposition:
        text = str(expression)
        if "sin(" in text or "cos(" in text:
            trigonometric += 1
        elif text.count("u_") >= 2 and ("*" in text or "div(" in text or "prod" in text) or "**" in text:
            nonlinear += 1
        elif "u_" in text:
            linear += 1
    return nonlinear, trigonometric, linear
