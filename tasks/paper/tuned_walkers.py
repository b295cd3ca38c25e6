"""Tuning: statics, and the way from the tuned walkers to the machine (sections 5.1 and 5.2 of the paper, figure 8)."""

from __future__ import annotations

import functools

import numpy as np

from tasks.continuation import atlas as atlases
from tasks.continuation.branch import Branch
from tasks.continuation.special_points import special_points
from tasks.continuation.tracking import follow
from tasks.fixed_points.search import search
from tasks.paper.claim import ClaimResult, claim, verdict
from tasks.paper.lines import LONG, SHORT, line, numbers
from tasks.walkers.catalogue import CATALOGUE
from tasks.walkers.tuning import is_tuned, statics
from tasks.walkers.walker import Walker

#: The compass gait of Goswami et al. 1996: m = 5, m_h = 10, a = b = 0.5, point masses.
GOSWAMI = Walker(
    l_t=0.5,
    w_t=0.0,
    m_t=0.0,
    r_t=0.0,
    c_t=0.0,
    l_s=0.5,
    w_s=0.0,
    m_s=5.0,
    r_s=0.0,
    c_s=0.0,
    R=0.0,
    eps_T=0.0,
    m_h=10.0,
    g=9.81,
    units="SI",
)
#: Panels of figure 8 between the tuned walker and the machine.
PANELS = (0.05, 0.2, 0.4, 0.6)
#: Fore-aft offsets that are tried in place of the tuned ones [m].
OFFSETS = (
    ("A", "w_t", -0.0219),
    ("A", "w_t", -0.0228),
    ("A", "w_t", -0.0230),
    ("A", "w_t", -0.0239),
    ("A", "w_s", 0.0234),
    ("A", "w_s", 0.0214),
)
_RUN = "gaitsweep run data/studies/paper/figure8.toml"


@claim(
    "T1",
    "zero-slope walkers meet two static conditions; Goswami's compass gaits do",
    "section 5.1",
    "figure3/walker",
    "gaitsweep walkers C",
)
def conditions() -> ClaimResult:
    worst = {name: max(abs(x) for x in statics(w).values()) for name, w in CATALOGUE.items()}
    tuned = [name for name, w in CATALOGUE.items() if is_tuned(w)]
    off = {name: worst[name] for name in worst if name not in tuned}
    compass = max(abs(x) for x in statics(GOSWAMI).values())
    return ClaimResult(
        f"met by {', '.join(tuned)} and Goswami's compass gait (residual {compass:g}); largest residual of "
        f"the others in m: {numbers(off, 3)}",
        verdict(set(tuned) == {"A", "B", "C", "D", "E", "F"} and is_tuned(GOSWAMI)),
        off["C-printed"],
    )


@claim(
    "T2",
    "A and C have two gaits at every slope below 0.04",
    "section 5.2",
    "figure8/locus",
    "gaitsweep solve --walker C --slope 0.04",
)
def two_gaits() -> ClaimResult:
    share = {w: np.isfinite(line(w).grid(1e-8, 0.04, 65)["stance_angle"][:, :2]).all(axis=1).mean() for w in "AC"}
    top = {w: min(float(np.exp(b.q.max())) for b in line(w).branches) for w in "AC"}
    return ClaimResult(
        f"both gaits at every one of 65 slopes from 1e-8 to 0.04, and on to {numbers(top, 3)}",
        verdict(all(s == 1 for s in share.values())),
        top["C"],
    )


@claim("T3", "the long step is stable at small slopes, the short one unstable", "section 5.2", "figure8/locus", _RUN)
def stability() -> ClaimResult:
    radius = {w: line(w).grid(1e-8, 0.04, 65)["spectral_radius"] for w in "AC"}
    long = {w: float(r[:, LONG].max()) for w, r in radius.items()}
    short = {w: float(r[:, SHORT].min()) for w, r in radius.items()}
    return ClaimResult(
        f"over slopes 1e-8 to 0.04: largest multiplier of the long step at most {numbers(long, 5)}, of the "
        f"short step at least {numbers(short, 5)}",
        verdict(max(long.values()) < 1 and min(short.values()) > 1),
        long["C"],
    )


def _long_branch(detuning: float) -> int:
    """Number of the branch that holds the long step at slope 0.02."""
    own = line("C", detuning=detuning)
    for k in range(len(own.branches)):
        found = own.curve(k)
        # A tangential end, where the label is noise, lies far from that slope.
        if (~found["short"] & (np.abs(np.log(found["slope"] / 0.02)) < 0.2)).any():
            return k
    raise ValueError("no long step at slope 0.02")


@claim(
    "T4",
    "detuned, the cusp breaks; the long step shifts to larger slopes, with an unstable piece at low speed",
    "section 5.2, 1",
    "figure8/locus",
    _RUN,
)
def cusp_breaks() -> ClaimResult:
    least, unstable, stable = {}, {}, []
    for d in PANELS:
        found = line("C", detuning=d).curve(_long_branch(d))
        fold = int(np.argmin(found["slope"]))
        slow = found["speed"] < found["speed"][fold]
        least[f"{d:g}"] = float(found["slope"][fold])
        unstable[f"{d:g}"] = float(found["slope"][slow & (found["spectral_radius"] > 1)].max(initial=0.0))
        above = ~slow & (found["slope"] > 1.05 * found["slope"][fold]) & (found["slope"] < 0.04)
        stable.append(bool((found["spectral_radius"][above] < 1).all()))
    shifts = bool(np.all(np.diff(list(least.values())) > 0)) and min(least.values()) > 0
    return ClaimResult(
        f"smallest slope of the long step at detuning {numbers(least)}; below the fold's speed unstable up "
        f"to slope {numbers(unstable)}; above it stable to 0.04 at detuning "
        + ", ".join(f"{d:g}" for d, s in zip(PANELS, stable, strict=True) if s),
        verdict(shifts and all(u > 0 for u in unstable.values()) and all(stable)),
        least["0.05"],
    )


@claim(
    "T5",
    "the short step's end (heelstrike at kneestrike) moves up with detuning",
    "section 5.2, 2",
    "figure8/locus",
    _RUN,
)
def short_end() -> ClaimResult:
    ends = {f"{d:g}": line("C", detuning=d).special_of("end_kneestrike_at_heelstrike")[0] for d in PANELS[1:]}
    ends["1"] = line("physical").special_of("end_kneestrike_at_heelstrike")[0]
    slopes, angles = {k: p["slope"] for k, p in ends.items()}, {k: p["stance_angle"] for k, p in ends.items()}
    first = line("C", detuning=PANELS[0]).special_of("end_tangential_heelstrike")
    other = (
        f"; at {PANELS[0]:g} the short step ends as heelstrike turns tangential, at {first[-1]['slope']:.4g}"
        if first
        else ""
    )
    rises = all(np.all(np.diff(list(x.values())) > 0) for x in (slopes, angles))
    return ClaimResult(
        f"slope of the end at detuning {numbers(slopes)}; its angle {numbers(angles)}{other}",
        verdict(rises),
        slopes["0.2"],
    )


@functools.lru_cache(maxsize=1)
def offsets() -> dict[str, np.ndarray]:
    """Table of the smallest slope against fore-aft offsets from exact tuning."""
    rows = [
        (name, key, value, value - getattr(CATALOGUE[name], key), line(name, **{key: value}).ends()[0])
        for name, key, value in OFFSETS
    ]
    names = ("walker", "key", "key_value", "offset", "smallest_slope")
    return {name: np.array([row[k] for row in rows]) for k, name in enumerate(names)}


@claim(
    "T7",
    "zero-slope capability is not generic: any fore-aft offset ends it",
    "section 8",
    "figure8/locus",
    "gaitsweep solve --walker A --set w_t=-0.0219 --slope 1e-5",
)
def not_generic() -> ClaimResult:
    table = offsets()
    least = {
        f"{w} {k} off by {1e3 * o:+.3f} mm": float(x)
        for w, k, o, x in zip(table["walker"], table["key"], table["offset"], table["smallest_slope"], strict=True)
    }
    thigh = (table["walker"] == "A") & (table["key"] == "w_t")
    offset, slope = table["offset"][thigh], table["smallest_slope"][thigh]
    grows = all(np.all(np.diff(slope[side][np.argsort(abs(offset[side]))]) > 0) for side in (offset > 0, offset < 0))
    return ClaimResult(
        f"smallest slope of {numbers(least, 3)}; of C with its offsets as printed, which are rounded, "
        f"{line('C-printed').ends()[0]:.3g}",
        verdict(min(least.values()) > 1e-7 and bool(grows)),
        float(slope[0]),
    )


@functools.lru_cache(maxsize=1)
def high_slope_branch() -> Branch:
    """The machine's gaits at high slopes, which no path through its gaits at low slopes leads to."""
    for found in line("physical").branches:
        if np.exp(found.q.max()) > 0.3:
            return found
    problem = line("physical").problem
    w, _, verify_steps = search(problem, 0.2)
    assert verify_steps is not None
    starts = w[:, verify_steps.anthropomorphic]
    pairs = follow(problem, starts, np.full(starts.shape[1], np.log(0.2)))
    return next(b for pair in pairs if (b := atlases._from_tracks(problem, pair)) is not None)


@claim(
    "T8",
    "the high-slope branch continues beyond figure 8",
    "section 5.2, 3",
    "figure8/locus",
    "gaitsweep solve --walker physical --slope 0.2",
)
def high_slopes() -> ClaimResult:
    found = high_slope_branch()
    points = special_points(line("physical").problem, found)
    fold = next(p for p in points if p["kind"] == "fold")
    rest = ", ".join(
        f"{p['kind']} at {p['slope']:.6f}" for p in points if p["kind"] in ("flip", "end_kneestrike_at_heelstrike")
    )
    top = float(np.exp(found.q.max()))
    return ClaimResult(
        f"its fold is at slope {fold['slope']:.9f}, angle {fold['stance_angle']:.6f}; {rest}; followed to "
        f"slope {top:.2f}",
        verdict(top > 0.3),
        float(fold["slope"]),
    )
