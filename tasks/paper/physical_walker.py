"""The physical walker of figure 3, with knees free and locked (section 4.2 of the paper, figure 6)."""

from __future__ import annotations

import numpy as np

from tasks.paper.claim import VERDICTS, ClaimResult, claim, compare, verdict
from tasks.paper.lines import line
from tasks.paper.rounding_intervals import Interval, interval


def _format(mark: Interval) -> str:
    return f"{mark.value:.7g} (rounding allows {mark.low:.4g}-{mark.high:.4g}, mostly that of {mark.most})"


@claim(
    "P1",
    "no gaits below about 0.020 with knees, 0.016 without",
    "section 4.2, 4",
    "figure6/locus",
)
def smallest_slopes() -> ClaimResult:
    """Locate the folds at the smallest slopes."""
    kneed, straight = interval("smallest slope, kneed"), interval("smallest slope, straight")
    marks = ((0.020, kneed), (0.016, straight))
    verdicts = [compare(number, 5e-4, mark.value, mark.low, mark.high) for number, mark in marks]
    return ClaimResult(
        f"folds at slope {_format(kneed)} kneed, {_format(straight)} straight-legged",
        max(verdicts, key=VERDICTS.index),
        kneed.value,
        kneed.low,
        kneed.high,
        0.020,
        5e-4,
    )


@claim(
    "P2",
    "the straight-legged gaits are unstable, a part of the kneed ones is stable",
    "section 4.2, 1",
    "figure6/locus",
)
def stability() -> ClaimResult:
    """Evaluate the multipliers along both curves."""
    straight = [line("physical-straight").curve(k) for k in range(len(line("physical-straight").branches))]
    shown = [c["spectral_radius"][c["slope"] < 0.1] for c in straight]
    least = min(float(r.min()) for r in shown if len(r))
    kneed = line("physical").curve(0)
    stable = kneed["spectral_radius"] < 1
    slopes = kneed["slope"][stable]
    flips = [f"{p['slope']:.7f}" for p in line("physical").special_of("flip")]
    return ClaimResult(
        f"straight-legged: spectral radius at least {least:.3f} below slope 0.1; kneed: stable from slope "
        f"{slopes.min():.5f} to {slopes.max():.5f} (flips at {', '.join(flips)})",
        verdict(least > 1 and bool(stable.any()) and not stable.all()),
        float(slopes.max()),
    )


@claim(
    "P3",
    "at most one stable period-one gait for any walker and slope",
    "section 4.2, 1",
    "figure11/multipliers",
)
def one_stable() -> ClaimResult:
    """Count the stable gaits at each slope."""
    most, points = 0, 0
    for name in ("A", "B", "C", "D", "E", "F", "physical", "physical-straight"):
        stable = (line(name).grid()["spectral_radius"] < 1).sum(axis=1)
        most, points = max(most, int(stable.max())), points + len(stable)
    return ClaimResult(
        f"at most {most} at {points} combinations of walker and slope from 1e-8 to 0.2", verdict(most == 1), float(most)
    )


@claim(
    "P4",
    "the kneed curve ends where kneestrike and heelstrike coincide (point 1)",
    "section 4.2, 2",
    "figure6/locus",
)
def point_1() -> ClaimResult:
    """Locate the end of the kneed curve at large slopes."""
    mark = interval("point 1")
    last = line("physical").curve(0)["knee_share"][[0, -1]]
    return ClaimResult(
        f"at slope {_format(mark)}, stance angle {mark.angle:.7g}; kneestrike at {100 * last.max():.12g} % of the step",
        verdict(abs(last.max() - 1) < 1e-9),
        mark.value,
        mark.low,
        mark.high,
    )


@claim(
    "P5",
    "the straight-legged curve ends as heelstrike becomes tangential (point 2)",
    "section 4.2, 2",
    "figure6/locus",
)
def point_2() -> ClaimResult:
    """Locate the end of the straight-legged curve at large slopes."""
    mark = interval("point 2")
    straight = line("physical-straight")
    closing = min(float(np.abs(straight.curve(k)["closing"][[0, -1]]).min()) for k in range(len(straight.branches)))
    return ClaimResult(
        f"at slope {_format(mark)}, stance angle {mark.angle:.7g}, where the foot meets the ground at a rate of "
        f"{closing:.0e} of the angle",
        verdict(closing < 1e-5),
        mark.value,
        mark.low,
        mark.high,
    )


@claim(
    "P6",
    "the straight-legged curve ends at zero step length (point 4), the kneed one with immediate kneestrike (point 3)",
    "section 4.2, 3",
    "figure6/locus",
)
def points_3_4() -> ClaimResult:
    """Locate the ends of both curves at small steps."""
    third = interval("point 3")
    fourth = line("physical-straight").special_of("end_zero_step")[0]
    end = line("physical").special_of("end_tangential_heelstrike")
    beyond = f"; the branch continues, flagged, to slope {end[0]['slope']:.5f}" if end else ""
    return ClaimResult(
        f"point 4 at slope {fourth['slope']:.6g}, stance angle {fourth['stance_angle']:.1e}; point 3, where the "
        f"released knee first moves against its stop, at slope {_format(third)}, stance angle "
        f"{third.angle:.6g}{beyond}",
        verdict(fourth["stance_angle"] < 1e-4),
        third.value,
        third.low,
        third.high,
    )


@claim(
    "P7",
    "points 3 and 4 are the slowest gaits; the slowest walking is not at the smallest slope",
    "section 4.2, 3",
    "figure6/locus",
)
def slowest() -> ClaimResult:
    """Locate the slowest gait of each curve."""
    sentences, agrees = [], []
    for name, end in (("physical", interval("point 3").angle), ("physical-straight", 0.0)):
        gaits = line(name).curve(0)
        shown = gaits["stance_angle"] >= end
        slope, speed = gaits["slope"][shown], gaits["speed"][shown]
        slow, small = int(np.argmin(speed)), int(np.argmin(slope))
        sentences.append(
            f"{name}: slowest gait {speed[slow]:.3g} m/s at slope {slope[slow]:.5f}, and {speed[small]:.3g} m/s at "
            f"the smallest slope {slope[small]:.5f}"
        )
        agrees.append(speed[slow] < 0.5 * speed[small])
    return ClaimResult("; ".join(sentences), verdict(all(agrees)), float(speed[small]))


@claim(
    "P8",
    "kneestrike comes later and later in the step from point 3 to point 1",
    "section 4.2, 2",
    "figure6/locus",
)
def later_kneestrike() -> ClaimResult:
    """Follow the time of kneestrike along the kneed curve."""
    gaits = line("physical").curve(0)
    share, angle = gaits["knee_share"], gaits["stance_angle"]
    if share[-1] <= share[0]:
        share, angle = share[::-1], angle[::-1]
    first = int(np.argmin(np.abs(np.log(angle[: len(angle) // 2] / interval("point 3").angle))))
    falls = float(np.minimum(np.diff(share[first:]), 0).sum())
    return ClaimResult(
        f"from {100 * share[first]:.2f} % of the step at point 3 to {100 * share[-1]:.2f} % at point 1, "
        + ("rising throughout" if falls == 0 else f"with decreases of {-100 * falls:.2f} % in total"),
        verdict(falls == 0, -falls < 0.02),
        float(share[first]),
    )
