"""How near points of branches must be to be the same, for what.

Points are compared in similarity coordinates, which are of order one over decades of
slope, by the largest difference of a coordinate; of gaits of several steps, whichever
is the first (`tasks.step.several_steps.distance`). Whether gaits with error bounds may
be one is another question (`tasks.gaits.polish.are_same`).

Tolerances of something else stay where they are used:

- places along a branch, apart by rounding: `_TWIN` (`branches.atlas`), `_SAME_PLACE`
  (`branches.sampling`);
- ln slopes alone: `_SAME_SLOPE` (`studies.locate_cascade`), `_BESIDE_FOLD`
  (`branches.settling`), within which two gaits may be one;
- steps of one gait, to tell it from one of fewer steps: `_LEAST_APART`
  (`branches.settling`);
- double multipliers, as accurate as the root of rounding: `_SAME_MULTIPLIER`
  (`branches.meetings`);
- points together with their keys, on a curve: `_SAME_TURNING` (`branches.meetings`);
- event times alone, against a simulated step: `_SAME_TIMES` (`branches.curves`).
"""

from __future__ import annotations

import numpy as np

#: Two gaits that Newton's method solved at one slope.
SAME_GAIT = 1e-6
#: Sections of a gait of several steps, over the first angle: one whose sections differ by
#: no more repeats after fewer steps. Beside a flip, two sections that are `a` apart are
#: solved to some 1e-15/a**2, so that nearer ones are not resolved.
SOONER = 1e-5
#: A solved gait and the polynomial of a branch, also a coarse one near a fold, or the
#: point to which other iterations led.
ON_BRANCH = 1e-4
#: Points that were located from two sides, or in two ways, or but coarsely.
SAME_POINT = 1e-3
#: A special point and a guess of it between nodes: farther away it may be another.
NEAR_POINT = 1e-2


def same(a: np.ndarray, b: np.ndarray, within: float) -> np.ndarray:
    """Return whether points are the same.

    Parameters
    ----------
    a, b : ndarray, shape (c,) or (c, n)
    within : float
        Largest difference of a coordinate: one of those of this module.

    Returns
    -------
    ndarray of bool, shape () or (n,)
    """
    return np.asarray(np.abs(a - b).max(axis=0) < within)
