"""The physical walker of figure 3, with knees free and locked (section 4.2 of the
paper, figure 6).
"""

from __future__ import annotations

import math

import numpy as np

from gaitsweep.tasks.ledger.claim import PRINTED, VERDICTS, Found, claim, found, verdict
from gaitsweep.tasks.ledger.lines import WALKERS, Arrays, Paper
from gaitsweep.tasks.ledger.rounding_intervals import LANDMARKS, interval, place
from gaitsweep.tasks.measures.kinematics import step_length


@claim("P1")
def smallest_slopes(paper: Paper) -> Found:
    """Locate the folds at the smallest slopes."""
    kneed, straight = (
        interval(paper, "smallest slope, kneed"),
        interval(paper, "smallest slope, straight"),
    )
    marks = {"P1": kneed, "P1, straight legs": straight}
    verdicts = [PRINTED[name].compare(*mark.bounds) for name, mark in marks.items()]

    return found(
        max(verdicts, key=VERDICTS.index), *kneed.bounds, kneed=kneed, straight=straight
    )


@claim("P2")
def stability(paper: Paper) -> Found:
    """Evaluate the multipliers along both curves."""
    shown = [
        c["spectral_radius"][c["slope"] < 0.1]
        for c in paper.line("physical-straight").curves
    ]
    least = min(r.min() for r in shown if len(r))
    stable = paper.line("physical").stable()
    kneed = " and ".join(
        f"from the {a['kind']} at slope {a['slope']:.7g} rad to the {b['kind']} at {b['slope']:.7g} rad"
        for a, b in stable
    )
    value = stable[0][1]["slope"] if stable else math.nan

    return found(
        verdict(least > 1 and bool(stable)),
        value,
        least=least,
        kneed=kneed or "nowhere",
    )


@claim("P3")
def one_stable(paper: Paper) -> Found:
    """Count the stable gaits at each slope."""
    stable = np.concatenate(
        [(paper.line(w).grid()["spectral_radius"] < 1).sum(axis=1) for w in WALKERS]
    )
    return found(
        verdict(stable.max() == 1), stable.max(), most=stable.max(), points=len(stable)
    )


@claim("P4")
def point_1(paper: Paper) -> Found:
    """Locate the end of the kneed curve at large slopes."""
    mark, last = (
        interval(paper, "point 1"),
        paper.line("physical").curves[0]["knee_share"][[0, -1]].max(),
    )
    return found(
        verdict(abs(last - 1) < 1e-9), *mark.bounds, mark=mark, last=100 * last
    )


@claim("P5")
def point_2(paper: Paper) -> Found:
    """Locate the end of the straight-legged curve at large slopes."""
    mark = interval(paper, "point 2")
    closing = min(
        np.abs(c["closing"][[0, -1]]).min()
        for c in paper.line("physical-straight").curves
    )
    return found(verdict(closing < 1e-5), *mark.bounds, mark=mark, closing=closing)


@claim("P6")
def points_3_4(paper: Paper) -> Found:
    """Locate the ends of both curves at small steps."""
    third = interval(paper, "point 3")
    fourth = paper.line("physical-straight").special_of("end_zero_step")[0]
    end = paper.line("physical").special_of("end_tangential_heelstrike")
    beyond = (
        f"; the branch continues, flagged, to slope {end[0]['slope']:.5f} rad"
        if end
        else ""
    )

    return found(
        verdict(fourth["stance_angle"] < 1e-4),
        *third.bounds,
        third=third,
        fourth=fourth,
        beyond=beyond,
    )


@claim("P7")
def slowest(paper: Paper) -> Found:
    """Compare the speeds at the curves' ends and smallest slopes with those of all
    their gaits.
    """
    curves = _from_point_3(paper), paper.line("physical-straight").curves[0]
    least = [int(np.argmin(gaits["slope"])) for gaits in curves]
    kneed, straight = (
        (gaits["speed"][k], gaits["slope"][k])
        for gaits, k in zip(curves, least, strict=True)
    )
    fourth = paper.line("physical-straight").special_of("end_zero_step")[0]
    slowest, vanishing = curves[0]["speed"][0], curves[1]["speed"][int(fourth["place"])]
    are_slowest = (
        slowest == curves[0]["speed"].min() and vanishing == curves[1]["speed"].min()
    )
    holds = verdict(
        are_slowest and vanishing < 1e-4 * straight[0] and slowest < 0.5 * kneed[0]
    )

    return found(
        holds,
        slowest,
        slope=curves[0]["slope"][0],
        kneed=kneed,
        straight=straight,
        fourth=fourth,
    )


@claim("P8")
def later_kneestrike(paper: Paper) -> Found:
    """Follow the time of kneestrike along the kneed curve."""
    share = _from_point_3(paper)["knee_share"]
    falls = np.minimum(np.diff(share), 0).sum()
    rising = (
        "rising throughout"
        if falls == 0
        else f"with decreases of {-100 * falls:.2f} % in total"
    )
    holds = verdict(falls == 0, -falls < 0.02)

    return found(
        holds, share[0], first=100 * share[0], last=100 * share[-1], rising=rising
    )


def _from_point_3(paper: Paper) -> Arrays:
    """Gaits of the kneed curve from point 3, itself the first, along its nodes to point
    1.

    Returns
    -------
    dict of ndarray, shape (n,)
        slope, knee_share and speed, as from `Line.curve`.
    """
    kneed = paper.line("physical")
    third, first = (
        kneed.special_of(k)[0]
        for k in ("release_hyperextension", "end_kneestrike_at_heelstrike")
    )
    angle, *_, knee, period, q = place(kneed, LANDMARKS["point 3"])
    speed = step_length(kneed.walker, np.exp(angle)) / (period * kneed.walker.time_unit)
    at = {"slope": np.exp(q), "knee_share": knee / period, "speed": speed}
    nodes = kneed.curves[third["branch"]]
    rises = third["place"] < first["place"]
    beyond = (
        slice(int(np.ceil(third["place"])), None)
        if rises
        else slice(int(np.floor(third["place"])), None, -1)
    )
    return {name: np.append(value, nodes[name][beyond]) for name, value in at.items()}
