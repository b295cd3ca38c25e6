"""The physical walker of figure 3, with knees free and locked (section 4.2 of the paper, figure 6)."""

from __future__ import annotations

import math

import numpy as np

from gaitsweep.tasks.measures.kinematics import step_length
from gaitsweep.tasks.paper.claim import PRINTED, VERDICTS, ClaimResult, claim, verdict
from gaitsweep.tasks.paper.lines import WALKERS, Arrays, Paper
from gaitsweep.tasks.paper.rounding_intervals import LANDMARKS, Interval, interval, place


def _format(mark: Interval) -> str:
    return f"{mark.value:.7g} (rounding allows {mark.low:.4g}-{mark.high:.4g}, dominated by {mark.most})"


@claim("P1")
def smallest_slopes(paper: Paper) -> ClaimResult:
    """Locate the folds at the smallest slopes."""
    kneed, straight = interval(paper, "smallest slope, kneed"), interval(paper, "smallest slope, straight")
    marks = {"P1": kneed, "P1, straight legs": straight}
    verdicts = [PRINTED[name].compare(*mark.bounds) for name, mark in marks.items()]
    return ClaimResult(
        f"folds at slope {_format(kneed)} kneed, {_format(straight)} straight-legged",
        max(verdicts, key=VERDICTS.index),
        *kneed.bounds,
    )


@claim("P2")
def stability(paper: Paper) -> ClaimResult:
    """Evaluate the multipliers along both curves."""
    shown = [c["spectral_radius"][c["slope"] < 0.1] for c in paper.line("physical-straight").curves]
    least = min(float(r.min()) for r in shown if len(r))
    stable = paper.line("physical").stable()
    kneed = " and ".join(
        f"from the {a['kind']} at slope {a['slope']:.7g} to the {b['kind']} at {b['slope']:.7g}" for a, b in stable
    )
    return ClaimResult(
        f"straight-legged: spectral radius at least {least:.3f} below slope 0.1; kneed: stable {kneed or 'nowhere'}",
        verdict(least > 1 and bool(stable)),
        stable[0][1]["slope"] if stable else math.nan,
    )


@claim("P3")
def one_stable(paper: Paper) -> ClaimResult:
    """Count the stable gaits at each slope."""
    most, points = 0, 0
    for name in WALKERS:
        stable = (paper.line(name).grid()["spectral_radius"] < 1).sum(axis=1)
        most, points = max(most, int(stable.max())), points + len(stable)
    return ClaimResult(
        f"at most {most} at {points} combinations of walker and slope from 1e-8 to 0.2", verdict(most == 1), float(most)
    )


@claim("P4")
def point_1(paper: Paper) -> ClaimResult:
    """Locate the end of the kneed curve at large slopes."""
    mark = interval(paper, "point 1")
    last = paper.line("physical").curves[0]["knee_share"][[0, -1]]
    return ClaimResult(
        f"at slope {_format(mark)}, stance angle {mark.angle:.7g}; kneestrike at {100 * last.max():.12g} % of the step",
        verdict(abs(last.max() - 1) < 1e-9),
        *mark.bounds,
    )


@claim("P5")
def point_2(paper: Paper) -> ClaimResult:
    """Locate the end of the straight-legged curve at large slopes."""
    mark = interval(paper, "point 2")
    closing = min(float(np.abs(c["closing"][[0, -1]]).min()) for c in paper.line("physical-straight").curves)
    return ClaimResult(
        f"at slope {_format(mark)}, stance angle {mark.angle:.7g}, where the foot meets the ground at a rate of "
        f"{closing:.0e} of the angle",
        verdict(closing < 1e-5),
        *mark.bounds,
    )


@claim("P6")
def points_3_4(paper: Paper) -> ClaimResult:
    """Locate the ends of both curves at small steps."""
    third = interval(paper, "point 3")
    fourth = paper.line("physical-straight").special_of("end_zero_step")[0]
    end = paper.line("physical").special_of("end_tangential_heelstrike")
    beyond = f"; the branch continues, flagged, to slope {end[0]['slope']:.5f}" if end else ""
    return ClaimResult(
        f"point 4, where steps vanish (followed to stance angle {fourth['stance_angle']:.0e}), at slope "
        f"{fourth['slope']:.7g}; point 3, where the released knee first moves against its stop, at slope "
        f"{_format(third)}, stance angle {third.angle:.6g}{beyond}",
        verdict(fourth["stance_angle"] < 1e-4),
        *third.bounds,
    )


@claim("P7")
def slowest(paper: Paper) -> ClaimResult:
    """Compare the speeds at the curves' ends and smallest slopes with those of all their gaits."""
    kneed, straight = _from_point_3(paper), paper.line("physical-straight").curves[0]
    fourth = paper.line("physical-straight").special_of("end_zero_step")[0]
    least = [int(np.argmin(gaits["slope"])) for gaits in (kneed, straight)]
    knees, locked = (float(gaits["speed"][k]) for gaits, k in zip((kneed, straight), least, strict=True))
    slowest, vanishing = float(kneed["speed"][0]), float(straight["speed"][int(fourth["place"])])
    return ClaimResult(
        f"physical: slowest gait that is not flagged {slowest:.4g} m/s, at point 3, slope {kneed['slope'][0]:.7g}, and "
        f"{knees:.4g} m/s at the smallest slope {kneed['slope'][least[0]]:.7g}; physical-straight: the speed vanishes "
        f"at point 4, slope {fourth['slope']:.7g}, and is {locked:.4g} m/s at the smallest slope "
        f"{straight['slope'][least[1]]:.7g}",
        verdict(
            slowest == kneed["speed"].min()
            and vanishing == straight["speed"].min()
            and vanishing < 1e-4 * locked
            and slowest < 0.5 * knees
        ),
        slowest,
    )


@claim("P8")
def later_kneestrike(paper: Paper) -> ClaimResult:
    """Follow the time of kneestrike along the kneed curve."""
    share = _from_point_3(paper)["knee_share"]
    falls = float(np.minimum(np.diff(share), 0).sum())
    return ClaimResult(
        f"from {100 * share[0]:.2f} % of the step at point 3 to {100 * share[-1]:.2f} % at point 1, "
        + ("rising throughout" if falls == 0 else f"with decreases of {-100 * falls:.2f} % in total"),
        verdict(falls == 0, -falls < 0.02),
        float(share[0]),
    )


def _from_point_3(paper: Paper) -> Arrays:
    """Gaits of the kneed curve from point 3, itself the first, along its nodes to point 1.

    Returns
    -------
    dict of ndarray, shape (n,)
        slope, knee_share and speed, as from `Line.curve`.
    """
    kneed = paper.line("physical")
    third, first = (kneed.special_of(k)[0] for k in ("release_hyperextension", "end_kneestrike_at_heelstrike"))
    angle, *_, knee, period, q = place(kneed, LANDMARKS["point 3"])
    speed = step_length(kneed.walker, np.exp(angle)) / (period * kneed.walker.time_unit)
    at = {"slope": np.exp(q), "knee_share": knee / period, "speed": speed}
    nodes = kneed.curves[third["branch"]]
    rises = third["place"] < first["place"]
    beyond = slice(int(np.ceil(third["place"])), None) if rises else slice(int(np.floor(third["place"])), None, -1)
    return {name: np.append(value, nodes[name][beyond]) for name, value in at.items()}
