"""Beyond period one: doublings, chaos and its end, counts of gaits, re-pairing (sections 3, 5.2, 7 and 8 of the paper).

A claim reads the tables of the study that wants it; what that study has not is made here.
"""

from __future__ import annotations

import functools
from dataclasses import asdict

import numpy as np

from tasks.count_gaits import census
from tasks.follow_curves import curve
from tasks.iterate_orbits import orbit
from tasks.locate_cascade import cascade
from tasks.paper.claim import NOT_REPRODUCED, ClaimResult, claim, verdict, within
from tasks.paper.lines import Arrays, line, numbers, table
from tasks.paper.published import HALF_UNITS
from tasks.paper.rounding_intervals import changed, interval
from tasks.solve_points import atlas
from tasks.walkers.catalogue import CATALOGUE

#: Where each walker's doublings are sought: window of slopes, searched slopes in it, first periods.
WINDOWS: dict[str, tuple[float, float, int, tuple[int, ...]]] = {
    "A": (0.05, 0.1, 2, (1,)),
    "B": (3e-4, 0.03, 2, (1,)),
    "E": (5e-3, 0.01, 2, (2,)),
    "F": (5e-3, 0.05, 2, (1,)),
    "C": (0.07, 0.1, 2, (1,)),
    "C-printed": (0.07, 0.1, 2, (1,)),
    "D": (0.01, 0.0195, 20, (1, 3)),
}
WALKERS = ("A", "B", "C", "D", "E", "F", "physical", "physical-straight")
#: Window of slopes in which kneed walkers at the corners of their rounding double and fall.
CORNER = (0.06, 0.12)
_CASCADE, _KNEED = (f"gaitsweep run data/studies/paper/{name}.toml" for name in ("cascade", "cascade-kneed"))


def _made(walker: str, families: tuple[int, ...], **options: int) -> Arrays:
    low, high, n, _ = WINDOWS[walker]
    own = line(walker)
    return cascade({**own.params, "slope": np.linspace(low, high, n), "families": families, **options}, [own.arrays])


def doublings(walker: str, family: str, group: str = "cascade") -> Arrays:
    """Rows of one family in a table of a walker's cascade."""
    found = table(group, walker, lambda: _made(walker, WINDOWS[walker][3]))
    mine = found["family"] == family
    return {name: column[mine] for name, column in found.items()}


def flips(walker: str, family: str) -> np.ndarray:
    """Slopes of a family's flips."""
    found = doublings(walker, family)
    return found["slope"][found["kind"] == "flip"]


def end(walker: str, family: str) -> tuple[float, float]:
    """Slopes between which a family's last attractor is lost."""
    found = doublings(walker, family, "lost")
    return float(found["low"][0]), float(found["high"][0])


def exponent(walker: str, slopes: np.ndarray, starts: int) -> tuple[float, float, float]:
    """Largest Lyapunov exponent per stride of a walker's attractors, its standard error, and which slope has it."""
    own = line(walker)
    found = orbit(
        {**own.params, "slope": slopes, "starts": starts, "transient": 100, "strides": 176, "shown": 1}, [own.arrays]
    )
    most = int(np.argmax(found["lyapunov/exponent"]))
    value, error, slope = (float(found[f"lyapunov/{k}"][most]) for k in ("exponent", "standard_error", "slope"))
    return value, error, slope


@claim(
    "D8", "period doublings from about 0.015, and chaos, up to about 0.019", "section 3", "chaos/bifurcation", _CASCADE
)
def doublings_to_chaos() -> ClaimResult:
    at, limit = flips("D", "1"), doublings("D", "1", "accumulation")
    low, high = end("D", "1")
    value, error, _ = exponent("D", np.array([0.0189]), 64)
    chaotic = value > 4 * error
    begins = within(0.015, at[0] - 5e-4, at[0] + 5e-4)
    last = 0.5 * (low + high)
    return ClaimResult(
        f"doublings at {', '.join(f'{s:.10f}' for s in at)}; their ratio comes to {limit['ratio'][0]:.4f}; "
        f"they accumulate at {limit['slope'][0]:.10f} ({limit['low'][0]:.10f} to {limit['high'][0]:.10f}); "
        f"Lyapunov exponent at 0.0189 {value:.4f} ({error:.4f}) a stride; walking "
        f"lost between {low:.6f} and {high:.6f}",
        verdict(chaotic and begins != NOT_REPRODUCED and 0.0185 <= last <= 0.0195),
        last,
        0.0185,
        0.0195,
    )


@claim(
    "D9",
    "an unconnected period-three branch near 0.0125 with doublings of its own, beside a stable gait of period "
    "one; two separate chaotic ranges",
    "section 3",
    "basin/basin",
    _CASCADE,
)
def period_three() -> ClaimResult:
    found, limit = doublings("D", "3"), doublings("D", "3", "accumulation")
    fold, at = float(found["slope"][found["kind"] == "fold"][0]), flips("D", "3")
    low, high = end("D", "3")
    first, first_end = doublings("D", "1", "accumulation")["slope"][0], end("D", "1")[0]
    sidecar_path = at[0] < flips("D", "1")[0]
    four, four_at = doublings("D", "4"), flips("D", "4")
    more = (
        f"; period four (Li & Yang 2012) likewise, from its fold at "
        f"{four['slope'][four['kind'] == 'fold'][0]:.10f} to its flip at {four_at[0]:.10f}"
        if len(four_at)
        else ""
    )
    apart = limit["slope"][0] < high < first < first_end
    return ClaimResult(
        f"stable from the fold at {fold:.10f} to its flip at {at[0]:.10f}, where period one is stable too; "
        f"doubled on at {', '.join(f'{s:.9f}' for s in at[1:])}, accumulating at {limit['slope'][0]:.9f}; "
        f"chaos to between {low:.6f} and {high:.6f}, and again from {first:.7f} to {first_end:.5f}{more}",
        verdict(fold < 0.0125 < at[0] and sidecar_path and apart and len(at) > 2),
        fold,
        0.01245,
        0.01255,
    )


@claim(
    "K1",
    "the kneed walker's period one gives way at about 0.084 to period two, then four, and so on",
    "section 7",
    "figure12/bifurcation",
    _KNEED,
)
def kneed_doublings() -> ClaimResult:
    exact, printed = interval("C flip"), interval("C-printed flip")
    at = {w: doublings(w, "1", "accumulation") for w in ("C", "C-printed")}
    said = [
        f"{w} at {', '.join(f'{s:.8f}' for s in flips(w, '1'))}, accumulating at {a['slope'][0]:.9f} (ratio "
        f"{a['ratio'][0]:.4f})"
        for w, a in at.items()
    ]
    follow = all(a["flips"][0] >= 3 for a in at.values())
    found = within(0.084, printed.low, printed.high)
    return ClaimResult(
        f"{'; '.join(said)}; rounding leaves {printed.low:.4f} to {printed.high:.4f} for the offsets as "
        f"printed, {exact.low:.4f} to {exact.high:.4f} exactly tuned",
        found if follow else NOT_REPRODUCED,
        printed.value,
        printed.low,
        printed.high,
    )


def corners(walker: str) -> list[tuple[float, float]]:
    """Brackets of the loss of walking at the two corners of a walker's rounding, lower one first.

    Notes
    -----
    The loss has no derivative, so two walkers are made whose keys are all off by their half units, each the way that
    moves the flip down, or up.
    """
    by = interval(f"{walker} flip").sensitivity
    found = []
    for way in (-1, 1):
        corner = CATALOGUE[walker]
        for key, half in HALF_UNITS[walker].items():
            corner = changed(walker, corner, key, way * float(np.sign(by[key])) * half)
        params = {"line": {"walker": asdict(corner), "set": {}}}
        ends = cascade({**params, "slope": np.array(CORNER), "periods": 8, "strides": 40}, [atlas(params, [])])
        found.append((float(ends["lost/low"][0]), float(ends["lost/high"][0])))
    return found


@claim("K2", "persistent walking up to slopes of about 0.103, none above", "section 7", "figure12/bifurcation", _KNEED)
def kneed_end() -> ClaimResult:
    ends = {w: end(w, "1") for w in ("C", "C-printed")}
    (low, _), (_, high) = corners("C-printed")
    said = ", ".join(f"{w} between {a:.6f} and {b:.6f}" for w, (a, b) in ends.items())
    return ClaimResult(
        f"the chaos ends in falls: {said}; at the corners of the rounding of the offsets and lengths as "
        f"printed at {low:.4f} and {high:.4f}",
        within(0.103, low, high),
        float(np.mean(ends["C-printed"])),
        low,
        high,
    )


@claim("K3", "unstable gaits continue at larger slopes", "figure 12", "figure8/locus", _KNEED)
def unstable_beyond() -> ClaimResult:
    beyond = end("C", "1")[1]
    found = [line("C").curve(k) for k in range(len(line("C").branches))]
    top = {("short" if c["short"][len(c["slope"]) // 2] else "long"): float(c["slope"].max()) for c in found}
    least = min(float(c["spectral_radius"][c["slope"] > beyond].min()) for c in found)
    return ClaimResult(
        f"both gaits of C go on where nothing walks any more, to slope {numbers(top, 5)}, with a largest "
        f"multiplier of at least {least:.3f}",
        verdict(min(top.values()) > beyond and least > 1),
        min(top.values()),
    )


def _crossings(x: np.ndarray, y: np.ndarray, at: float) -> list[float]:
    """y wherever a curve through points (x, y) passes x = at, in straight lines between them."""
    k = np.nonzero((x[1:] - at) * (x[:-1] - at) < 0)[0]
    return [float(v) for v in y[k] + (y[k + 1] - y[k]) * (at - x[k]) / (x[k + 1] - x[k])]


@claim(
    "T6",
    "the branches come near, touch and re-pair as the walker is detuned",
    "section 5.2, 3",
    "figure8/locus",
    "gaitsweep run data/studies/paper/repairing.toml",
)
def repairing() -> ClaimResult:
    def made() -> Arrays:
        own = line("C", detuning=1.0)
        return curve(
            {
                **own.params,
                "slope": np.array([1e-3, 0.3]),
                "key": "detuning",
                "from": 0.0,
                "to": 1.2,
                "kinds": ["fold"],
            },
            [own.arrays],
        )

    turns = table("turnings", "C", made)
    touch = np.nonzero((turns["turn"] == "key") & (turns["kind"] == "fold"))[0]
    if not len(touch):
        return ClaimResult("no turning of the curve of folds", NOT_REPRODUCED)
    value, slope, angle, bound = (
        float(turns[name][touch[0]]) for name in ("value", "slope", "stance_angle", "error_bound")
    )
    folds = table("curves", "C", made)
    mine = folds["curve"] == turns["curve"][touch[0]]
    near = {d: _crossings(folds["value"][mine], folds["slope"][mine], d) for d in (value - 0.004, value + 0.004)}
    said = "; ".join(
        f"at {d:.4f} folds beside it at {', '.join(f'{s:.4f}' for s in f) or 'no slope'}" for d, f in near.items()
    )
    return ClaimResult(
        f"at detuning {value:.9f} and slope {slope:.9f} (angle {angle:.6f}; relative error {bound:.0e}); {said}",
        verdict(sorted(map(len, near.values())) == [0, 2]),
        value,
    )


@claim(
    "G1",
    "never more than two anthropomorphic gaits of period one",
    "section 8",
    "figure11/linear",
    "gaitsweep run data/studies/paper/census.toml",
)
def never_more() -> ClaimResult:
    slopes = np.array([1e-3, 0.01, 0.03, 0.1])
    found = {
        w: table("coverage", w, functools.partial(census, {"line": {"walker": w, "set": {}}, "slope": slopes}, []))
        for w in WALKERS
    }
    most = max(int(f["anthropomorphic"].max()) for f in found.values())
    starts, lines = (
        sum(int(n) for n in counts)
        for counts in ([f["starts"].sum() for f in found.values()], [len(f["slope"]) for f in found.values()])
    )
    unseen = max(float(f["unseen"][f["converged"] > 0].max()) for f in found.values() if (f["converged"] > 0).any())
    more = sum(int(f["found_deflated"].sum()) for f in found.values())
    others = {w: int(f["non_anthropomorphic"].sum()) for w, f in found.items() if f["non_anthropomorphic"].any()}
    return ClaimResult(
        f"at most {most} in {starts} starts over {len(found)} walkers and {lines} slopes of them; of "
        f"those that converged at most {unseen:.3f} may lead to gaits not seen; kept from those found, the "
        f"starts lead to {more} more, which are counted; gaits whose legs pass more than once are counted "
        f"apart: {numbers(others)}",
        verdict(most <= 2),
        float(most),
    )


@functools.lru_cache(maxsize=8)
def chaos(walker: str) -> tuple[int, str]:
    """Figure 10's last column: whether a walker's doublings lead to chaos, and where.

    Notes
    -----
    The exponent is the largest of three slopes beyond the accumulation, by parts of its distance from the second flip:
    in the chaos and before its end, where some slopes fall into windows of stable gaits of long periods.
    """
    family = str(WINDOWS[walker][3][0])
    found = _made(walker, (int(family),), periods=8, strides=0)
    at, limit = found["cascade/slope"][found["cascade/kind"] == "flip"], float(found["accumulation/slope"][0])
    value, error, slope = exponent(walker, limit + np.array([0.3, 0.5, 0.7]) * (limit - at[1]), 12)
    return int(value > 4 * error), (
        f"doublings of period {family} from {at[0]:.6g}, accumulating at {limit:.6g}; "
        f"exponent {value:.3f} ({error:.3f}) at {slope:.5g}"
    )
