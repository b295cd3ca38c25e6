"""Tuning: statics, and the transition from tuned to physical walkers (sections 5.1 and
5.2 of the paper, figure 8).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gaitsweep.tasks.ledger.claim import Found, claim, found, verdict
from gaitsweep.tasks.ledger.lines import (
    LONG,
    SHORT,
    TUNED,
    Line,
    Paper,
    coarse_lines,
    memoize,
)
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import from_table
from gaitsweep.tasks.walkers.statics import is_tuned, statics

#: The compass walker of Goswami et al. 1996 [SI]: m = 5, m_h = 10, a = b = 0.5, point
#: masses.
GOSWAMI = from_table(
    {
        "l": 1.0,
        "m": 5.0,
        "c": 0.5,
        "m_h": 10.0,
        "g": 9.81,
        "knees": False,
        "units": "SI",
    }
)
#: Detuning of the panels of figure 8 between the tuned and the physical walker.
PANELS = (0.05, 0.2, 0.4, 0.6)
#: Least and largest of the slopes at which both gaits of A and C are solved [rad], and
#: their number.
SLOPES = (1e-8, 0.04, 65)
#: Fore-aft offsets that replace the tuned ones: walker, key, value [m].
OFFSETS = (
    ("A", "w_t", -0.0219),
    ("A", "w_t", -0.0228),
    ("A", "w_t", -0.0230),
    ("A", "w_t", -0.0239),
    ("A", "w_s", 0.0234),
    ("A", "w_s", 0.0214),
)


@claim("T1")
def conditions(paper: Paper) -> Found:
    """Evaluate the residuals of the static conditions for every walker of the
    catalogue.
    """
    worst = {
        name: max(abs(x) for x in statics(w).values()) for name, w in CATALOGUE.items()
    }
    tuned = [name for name, w in CATALOGUE.items() if is_tuned(w)]
    untuned = {name: worst[name] for name in worst if name not in tuned}
    compass = max(abs(x) for x in statics(GOSWAMI).values())
    holds = verdict(set(tuned) == set(TUNED) and is_tuned(GOSWAMI))

    return found(
        holds, untuned["C-printed"], tuned=tuned, compass=compass, untuned=untuned
    )


@claim("T2")
def two_gaits(paper: Paper) -> Found:
    """Solve both gaits of A and C over a grid of slopes."""
    solved = [
        np.isfinite(paper.line(w).grid(*SLOPES)["stance_angle"][:, :2]).all()
        for w in "AC"
    ]
    top = {w: paper.line(w).reaches[1].min() for w in "AC"}
    return found(verdict(all(solved)), top["C"], top=top)


@claim("T3")
def stability(paper: Paper) -> Found:
    """Evaluate the multipliers of both gaits of A and C over a grid of slopes."""
    radius = {w: paper.line(w).grid(*SLOPES)["spectral_radius"] for w in "AC"}
    long, short = (
        {w: r[:, LONG].max() for w, r in radius.items()},
        {w: r[:, SHORT].min() for w, r in radius.items()},
    )
    return found(
        verdict(max(long.values()) < 1 < min(short.values())),
        long["C"],
        long=long,
        short=short,
    )


def _long_branch(paper: Paper, detuning: float) -> int:
    """Number of the branch that holds the long step at slope 0.02."""
    for k, curve in enumerate(paper.line("C", detuning=detuning).curves):
        # A tangential end, where the label is noise, lies far from that slope.
        if (~curve["short"] & (np.abs(np.log(curve["slope"] / 0.02)) < 0.2)).any():
            return k
    raise ValueError("no long step at slope 0.02")


@claim("T4")
def cusp_breaks(paper: Paper) -> Found:
    """Locate the fold of the long step at each detuning and evaluate the multipliers on
    both sides.
    """
    least, unstable, stable = {}, {}, []
    for d in PANELS:
        curve = paper.line("C", detuning=d).curves[_long_branch(paper, d)]
        slope, radius = curve["slope"], curve["spectral_radius"]
        fold = int(np.argmin(slope))
        slow = curve["speed"] < curve["speed"][fold]
        least[f"{d:g}"] = slope[fold]
        unstable[f"{d:g}"] = slope[slow & (radius > 1)].max(initial=0.0)
        fast = ~slow & (slope > 1.05 * slope[fold]) & (slope < 0.04)
        stable += [d] if (radius[fast] < 1).all() else []

    shifts = np.all(np.diff(list(least.values())) > 0) and min(least.values()) > 0
    holds = verdict(
        shifts and min(unstable.values()) > 0 and len(stable) == len(PANELS)
    )
    return found(holds, least["0.05"], least=least, unstable=unstable, stable=stable)


@claim("T5")
def short_end(paper: Paper) -> Found:
    """Locate the end of the short step at each detuning."""
    walkers = {f"{d:g}": paper.line("C", detuning=d) for d in PANELS} | {
        "1": paper.line("physical")
    }
    ends = {k: _short_end(gaits) for k, gaits in walkers.items()}
    slopes, angles = (
        {k: p["slope"] for k, p in ends.items()},
        {k: p["stance_angle"] for k, p in ends.items()},
    )
    shares = {
        k: walkers[k].curves[p["branch"]]["knee_share"][int(p["place"])]
        for k, p in ends.items()
    }
    others = "".join(
        f"; at detuning {k} the foot meets the ground at kneestrike, at {100 * shares[k]:.2f} % of the step, and rises "
        f"again before heelstrike"
        for k, p in ends.items()
        if p["kind"] == "end_earlier_strike"
    )
    rises = all(np.all(np.diff(list(x.values())) > 0) for x in (slopes, angles))

    return found(
        verdict(rises), slopes["0.2"], slopes=slopes, angles=angles, others=others
    )


def _short_end(gaits: Line) -> dict[str, Any]:
    """The special point at small slopes where short steps end; long steps end with a
    tangential heelstrike.
    """
    kinds = ("end_kneestrike_at_heelstrike", "end_earlier_strike")
    return min(
        (p for kind in kinds for p in gaits.special_of(kind)), key=lambda p: p["slope"]
    )


@memoize
def offsets(paper: Paper) -> list[dict[str, Any]]:
    """Rows of the smallest slope against fore-aft offsets from exact tuning.

    Each has walker, key, key_value and offset [m], smallest_slope [rad].
    """
    surveyed = coarse_lines([(name, {key: value}) for name, key, value in OFFSETS])
    return [
        {
            "walker": name,
            "key": key,
            "key_value": value,
            "offset": value - getattr(CATALOGUE[name], key),
            "smallest_slope": float(gaits.reaches[0].min()),
        }
        for (name, key, value), gaits in zip(OFFSETS, surveyed, strict=True)
    ]


@claim("T7")
def not_generic(paper: Paper) -> Found:
    """Compute the smallest slope for offsets on both sides of exact tuning."""
    rows = offsets(paper)
    least = {
        f"{row['walker']} ({row['key']} {1e3 * row['offset']:+.3f} mm)": row[
            "smallest_slope"
        ]
        for row in rows
    }
    thigh = [row for row in rows if (row["walker"], row["key"]) == ("A", "w_t")]
    offset, slope = (
        np.array([row[name] for row in thigh]) for name in ("offset", "smallest_slope")
    )
    grows = all(
        np.all(np.diff(slope[side][np.argsort(abs(offset[side]))]) > 0)
        for side in (offset > 0, offset < 0)
    )
    printed = paper.line("C-printed").reaches[0].min()

    return found(
        verdict(min(least.values()) > 1e-7 and grows),
        slope[0],
        least=least,
        printed=printed,
    )


@claim("T8")
def high_slopes(paper: Paper) -> Found:
    """Locate the special points of the branch at high slopes, which may be another than
    that at low slopes.
    """
    tops = paper.line("physical").reaches[1]
    points = [p for p in paper.line("physical").special if p["branch"] == tops.argmax()]
    fold = next(p for p in points if p["kind"] == "fold")
    others = ", ".join(
        f"{p['kind'].replace('_', ' ')} at {p['slope']:.6f} rad"
        for p in points
        if p["kind"] in ("flip", "end_kneestrike_at_heelstrike")
    )
    told = {"angle": fold["stance_angle"], "others": others, "top": tops.max()}
    return found(verdict(tops.max() > 0.3), fold["slope"], **told)
