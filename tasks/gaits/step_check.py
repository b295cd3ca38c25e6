"""Whether fixed points are steps that happen, and what kind of gait they are."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.step.lanes import replace_lanes
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import AnyStride
from gaitsweep.tasks.step.step_map import SAMPLES
from gaitsweep.tasks.step.verify_step import StepCheck, verify

#: A gait is long if its ratio just before heelstrike (`gait_ratio`) lies below this.
LONG_BELOW = 0.5
#: Samples of each phase where fewer leave a doubt.
_FINER = (16 * SAMPLES, 256 * SAMPLES)


def verified(stride: AnyStride) -> StepCheck:
    """What the sampled motion of gaits shows of all their steps."""
    each = stride.singles
    return verify(each.motion, each.closing, each.times).of_all(stride.steps)


def verify_steps(
    problem: Problem,
    w: np.ndarray,
    log_slope: np.ndarray,
    sampled: AnyStride | None = None,
) -> tuple[AnyStride, StepCheck]:
    """Verify that fixed points are steps; lanes that samples leave in doubt are sampled
    16 times as finely, twice.

    Parameters
    ----------
    w : ndarray, shape (m + phases, n)
        Fixed points in similarity coordinates.
    log_slope : ndarray, shape (n,)
        ln of the slope in rad.
    sampled : Stride, optional
        The steps with samples of their motion, where they were integrated already.

    Returns
    -------
    stride : Stride
        The sampled steps.
    check : StepCheck
        Where a doubt is left, the finest samples do not tell whether a guard only comes
        near zero.
    """
    stride = sampled or problem.stride(w, log_slope, samples=SAMPLES)[0]
    check = verified(stride)
    for samples in _FINER:
        lanes = np.flatnonzero(check.doubt)
        if not len(lanes):
            break
        fine, _ = problem.some(lanes).stride(
            w[:, lanes], log_slope[lanes], samples=samples
        )
        replace_lanes(check, lanes, verified(fine))

    return stride, check


# Where heelstrike is tangential to the last digit its rates have no value.
@np.errstate(invalid="ignore", divide="ignore")
def gait_ratio(stride: AnyStride) -> np.ndarray:
    """Return the gait ratio (swing rate - stance rate)/|stance rate| just before
    heelstrike.

    Of gaits of several steps it is that of the step with the largest stance angle.

    Parameters
    ----------
    stride : Stride or Strides
        Of n lanes.

    Returns
    -------
    ndarray, shape (n,)
        Below LONG_BELOW a gait is long.
    """
    each = stride.singles
    stance, swing = each.impact
    ratio, angle = (
        values.reshape(stride.steps, -1)
        for values in ((swing - stance) / np.abs(stance), each.y[0])
    )
    return np.take_along_axis(ratio, angle.argmax(axis=0)[None], axis=0)[0]
