"""Whether fixed points are steps that happen, and what kind of gait they are."""

from __future__ import annotations

import numpy as np

from tasks.step.problem import Problem
from tasks.step.step_map import SAMPLES, Stride
from tasks.step.verify_step import StepCheck, verify


def verify_steps(
    problem: Problem, w: np.ndarray, log_slope: np.ndarray, sampled: Stride | None = None
) -> tuple[Stride, StepCheck]:
    """Verify that fixed points are steps; lanes that samples leave in doubt are sampled 16 times as finely.

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
    """
    stride = sampled or problem.stride(w, log_slope, samples=SAMPLES)[0]
    check = verify(stride.motion, stride.closing, stride.times)
    lanes = np.nonzero(check.doubt)[0]
    if len(lanes):
        fine, _ = problem.some(lanes).stride(w[:, lanes], log_slope[lanes], samples=16 * SAMPLES)
        closer = verify(fine.motion, fine.closing, fine.times)
        for name in ("step", "leg_passes", "doubt"):
            getattr(check, name)[lanes] = getattr(closer, name)
    return stride, check


# Where heelstrike is tangential to the last digit its rates have no value.
@np.errstate(invalid="ignore", divide="ignore")
def gait_ratio(stride: Stride) -> np.ndarray:
    """Return the gait ratio (swing rate - stance rate)/|stance rate| just before heelstrike.

    Parameters
    ----------
    stride : Stride
        Of n lanes.

    Returns
    -------
    ndarray, shape (n,)
        Below 1/2 a gait is long.
    """
    return (stride.impact[1] - stride.impact[0]) / np.abs(stride.impact[0])
