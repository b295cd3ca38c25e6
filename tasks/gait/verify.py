"""Is a solved stride a step? The guards' signs along the motion that was flown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class Verdict:
    """What the sampled motion of n lanes shows.

    `step` (n,) the first heelstrike (and kneestrike) are the ones solved for and run the right way; `passes` (n,)
    how often the swing leg passes the stance leg; `doubt` (n,) a guard comes so near zero between samples that
    finer ones must decide; `hyperextends` (n,) the freed knee first moves against its stop.
    """

    step: np.ndarray
    passes: np.ndarray
    doubt: np.ndarray
    hyperextends: np.ndarray

    @property
    def anthropomorphic(self) -> np.ndarray:
        """Lanes whose legs pass exactly once."""
        return self.step & (self.passes == 1)


def _slack(g: np.ndarray) -> np.ndarray:
    """Largest distance of a guard from its chord between samples, shape (intervals, n).

    |g - chord| <= h^2/8 max|g''|, with g'' from second differences of the neighbouring samples, doubled.
    """
    second = np.abs(np.diff(g, 2, axis=0))
    padded = np.vstack([second[:1], second, second[-1:]])
    return 2.0 / 8.0 * np.maximum(padded[:-1], padded[1:])


def verify(motion: list[np.ndarray], closing: np.ndarray, times: np.ndarray) -> Verdict:
    """Judge a stride by samples of its motion.

    Parameters
    ----------
    motion : list of ndarray, shape (samples + 1, angles, n)
        Each phase's angles and rates at equal times; three links before two.
    closing : ndarray, shape (n,)
        Rate of the heelstrike guard at the solved time.
    times : ndarray, shape (phases, n)
        The solved event times, which must follow each other.

    Notes
    -----
    A step ends when stance + swing angle, once positive, falls to zero with the stance angle negative. So the
    guard must be positive wherever the stance angle is negative, once it has become so.
    """
    two = motion[-1]
    a, b = two[:, 0], two[:, 1]
    n = a.shape[1]
    guard, slack = a + b, _slack(a + b)
    # Between samples i and i + 1: a strike needs the guard at or below zero with the stance angle negative.
    behind = np.minimum(a[:-1], a[1:]) < 0
    low = np.minimum(np.abs(guard[:-1]), np.abs(guard[1:]))
    low[-1] = np.abs(guard[-2])
    falls = (guard[1:] <= 0) & (guard[:-1] > 0) & (a[1:] < 0)
    falls[-1] = False
    # A guard that closes at zero was positive just before: the swing foot has come up behind the stance foot.
    step = (closing < 0) & ~falls.any(axis=0) & (a[-1] < 0) & (np.diff(times, axis=0, prepend=0) > 0).all(axis=0)
    # The last interval ends at zero, so the chord's own slope must win over the curvature.
    margin = slack.copy()
    margin[-1] *= 4
    doubt = (behind & (low < margin)).any(axis=0)
    apart = np.vstack([m[:, 0] - m[:, 1] if i == 0 else (m[:, 0] - m[:, 1])[1:] for i, m in enumerate(motion)])
    passes = (np.signbit(apart[1:]) != np.signbit(apart[:-1])).sum(axis=0)
    near = np.minimum(np.abs(apart[1:]), np.abs(apart[:-1])) < _slack(apart)
    doubt |= (near & (np.signbit(apart[1:]) == np.signbit(apart[:-1]))).any(axis=0)
    hyperextends = np.zeros(n, bool)
    if len(motion) == 2:
        flexion = motion[0][:, 1] - motion[0][:, 2]
        hyperextends = motion[0][0, 4] < motion[0][0, 5]
        inner = flexion[1:-1]
        bent = np.maximum.accumulate(inner > 0, axis=0)
        straight_again = (bent[:-1] & (inner[1:] <= 0)).any(axis=0)
        step = step & bent.any(axis=0) & ~straight_again & (inner[-1] > 0)
        doubt |= (bent & (np.abs(inner) < 0.25 * _slack(flexion)[:-1])).any(axis=0)
    return Verdict(step, passes, doubt & np.isfinite(closing), hyperextends)
