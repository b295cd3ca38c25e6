"""The machine of figure 3, kneed and with its knees locked (section 4.2 of the paper, figure 6)."""

from __future__ import annotations

import numpy as np

from tasks.paper.claim import ClaimResult, claim, verdict
from tasks.paper.lines import line
from tasks.paper.rounding_intervals import Interval, interval

_RUN = "gaitsweep run data/studies/paper/figure6.toml"


def _said(found: Interval) -> str:
    return f"{found.value:.7g} ({found.low:.4g} to {found.high:.4g}; {found.most} matters most)"


@claim(
    "P1",
    "no gaits below about 0.020 with knees, 0.016 without",
    "section 4.2, 4",
    "figure6/locus",
    "gaitsweep solve --walker physical --slope 0.01912288",
)
def smallest_slopes() -> ClaimResult:
    kneed, straight = interval("smallest slope, kneed"), interval("smallest slope, straight")
    both = kneed.low <= 0.020 <= kneed.high and straight.low <= 0.016 <= straight.high
    return ClaimResult(
        f"folds at {_said(kneed)} kneed, {_said(straight)} straight", verdict(both), kneed.value, kneed.low, kneed.high
    )


@claim(
    "P2",
    "the straight-legged gaits are unstable, a part of the kneed ones is stable",
    "section 4.2, 1",
    "figure6/locus",
    _RUN,
)
def stability() -> ClaimResult:
    straight = [line("physical-straight").curve(k) for k in range(len(line("physical-straight").branches))]
    shown = [c["spectral_radius"][c["slope"] < 0.1] for c in straight]
    least = min(float(r.min()) for r in shown if len(r))
    kneed = line("physical").curve(0)
    stable = kneed["spectral_radius"] < 1
    slopes = kneed["slope"][stable]
    flips = [f"{p['slope']:.7f}" for p in line("physical").special_of("flip")]
    return ClaimResult(
        f"straight: largest multiplier at least {least:.3f} below slope 0.1; kneed: stable from slope "
        f"{slopes.min():.5f} to {slopes.max():.5f} (flips at {', '.join(flips)})",
        verdict(least > 1 and bool(stable.any()) and not stable.all()),
        float(slopes.max()),
    )


@claim(
    "P3",
    "at most one stable period-one gait for any walker and slope",
    "section 4.2, 1",
    "figure6/locus",
    "gaitsweep solve --walker physical --slope 0.03 --all",
)
def one_stable() -> ClaimResult:
    most, points = 0, 0
    for name in ("A", "B", "C", "D", "E", "F", "physical", "physical-straight"):
        stable = (line(name).grid()["spectral_radius"] < 1).sum(axis=1)
        most, points = max(most, int(stable.max())), points + len(stable)
    return ClaimResult(
        f"at most {most} over {points} walkers and slopes from 1e-8 to 0.2", verdict(most == 1), float(most)
    )


@claim(
    "P4",
    "the kneed curve ends where kneestrike and heelstrike coincide (point 1)",
    "section 4.2, 2",
    "figure6/locus",
    "gaitsweep solve --walker physical --slope 0.036387",
)
def point_1() -> ClaimResult:
    found = interval("point 1")
    last = line("physical").curve(0)["knee_share"][[0, -1]]
    return ClaimResult(
        f"at slope {_said(found)}, angle {found.angle:.7g}; kneestrike at {last.max():.12g} of the step",
        verdict(abs(last.max() - 1) < 1e-9),
        found.value,
        found.low,
        found.high,
    )


@claim(
    "P5",
    "the straight curve ends as heelstrike turns tangential (point 2)",
    "section 4.2, 2",
    "figure6/locus",
    "gaitsweep solve --walker physical-straight --slope 0.05611781",
)
def point_2() -> ClaimResult:
    found = interval("point 2")
    own = line("physical-straight")
    closing = min(float(np.abs(own.curve(k)["closing"][[0, -1]]).min()) for k in range(len(own.branches)))
    return ClaimResult(
        f"at slope {_said(found)}, angle {found.angle:.7g}, where the foot meets the ground at a rate of "
        f"{closing:.0e} of the angle",
        verdict(closing < 1e-5),
        found.value,
        found.low,
        found.high,
    )


@claim(
    "P6",
    "the straight curve ends in steps of no length (point 4), the kneed one in kneestrike at once (point 3)",
    "section 4.2, 3",
    "figure6/locus",
    "gaitsweep solve --walker physical --slope 0.0215416",
)
def points_3_4() -> ClaimResult:
    third = interval("point 3")
    fourth = line("physical-straight").special_of("end_zero_step")[0]
    end = line("physical").special_of("end_tangential_heelstrike")
    goes_on = f"; the branch goes on, flagged, to slope {end[0]['slope']:.5f}" if end else ""
    return ClaimResult(
        f"point 4 at slope {fourth['slope']:.6g}, angle {fourth['stance_angle']:.1e}; point 3, where the "
        f"released knee first moves against its stop, at slope {_said(third)}, angle "
        f"{third.angle:.6g}{goes_on}",
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
    _RUN,
)
def slowest() -> ClaimResult:
    said, right = [], []
    for name, end in (("physical", interval("point 3").angle), ("physical-straight", 0.0)):
        found = line(name).curve(0)
        shown = found["stance_angle"] >= end
        slope, speed = found["slope"][shown], found["speed"][shown]
        slow, small = int(np.argmin(speed)), int(np.argmin(slope))
        said.append(
            f"{name}: slowest {speed[slow]:.3g} m/s at slope {slope[slow]:.5f}, and {speed[small]:.3g} m/s at "
            f"its smallest slope {slope[small]:.5f}"
        )
        right.append(speed[slow] < 0.5 * speed[small])
    return ClaimResult("; ".join(said), verdict(all(right)), float(speed[small]))


@claim(
    "P8",
    "kneestrike comes later and later in the step from point 3 to point 1",
    "section 4.2, 2",
    "figure6/locus",
    _RUN,
)
def later_kneestrike() -> ClaimResult:
    found = line("physical").curve(0)
    share = found["knee_share"] if found["knee_share"][-1] > found["knee_share"][0] else found["knee_share"][::-1]
    angle = found["stance_angle"] if found["knee_share"][-1] > found["knee_share"][0] else found["stance_angle"][::-1]
    first = int(np.argmin(np.abs(np.log(angle[: len(angle) // 2] / interval("point 3").angle))))
    rises = np.diff(share[first:])
    falls = float(np.minimum(rises, 0).sum())
    return ClaimResult(
        f"from {share[first]:.4f} of the step at point 3 to {share[-1]:.4f} at point 1, "
        + ("rising throughout" if falls == 0 else f"with falls of {-falls:.4f} in all"),
        verdict(falls == 0, -falls < 0.02),
        float(share[first]),
    )
