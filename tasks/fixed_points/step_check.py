"""Whether fixed points are steps that happen, and which kind of gait they are."""

from __future__ import annotations

import numpy as np

from tasks.step.problem import Problem
from tasks.step.step_map import SAMPLES, Stride
from tasks.step.verify_step import StepCheck, verify


def verify_steps(problem: Problem, w: np.ndarray, log_slope: np.ndarray) -> tuple[Stride, StepCheck]:
    """Strides with their verdicts; where samples leave a doubt, finer ones decide."""
    stride, _ = problem.stride(w, log_slope, samples=SAMPLES)
    return stride, settled(problem, stride, w, log_slope)


def settled(problem: Problem, stride: Stride, w: np.ndarray, log_slope: np.ndarray) -> StepCheck:
    """The verdict on sampled strides; lanes in doubt are sampled again, sixteen times as finely."""
    assert stride.motion is not None
    verdict = verify(stride.motion, stride.closing, stride.times)
    lanes = np.nonzero(verdict.doubt)[0]
    if len(lanes):
        fine, _ = problem.some(lanes).stride(w[:, lanes], log_slope[lanes], samples=16 * SAMPLES)
        assert fine.motion is not None
        closer = verify(fine.motion, fine.closing, fine.times)
        verdict.step[lanes], verdict.leg_passes[lanes], verdict.doubt[lanes] = (
            closer.step,
            closer.leg_passes,
            closer.doubt,
        )
    return verdict


# Where heelstrike is tangential to the last digit its rates have no value.
@np.errstate(invalid="ignore", divide="ignore")
def gait_ratio(stride: Stride) -> np.ndarray:
    """u = (swing rate - stance rate)/|stance rate| just before heelstrike: below 1/2 a gait is long."""
    return (stride.impact[1] - stride.impact[0]) / np.abs(stride.impact[0])
