"""The paper's walkers (figures 3 and 9), by name."""

from __future__ import annotations

import math
from dataclasses import replace

from gaitsweep.tasks.walkers.walker import Walker

_PHYSICAL = Walker(
    l_t=0.35,
    w_t=0.0,
    m_t=2.345,
    r_t=0.099,
    c_t=0.091,
    l_s=0.46,
    w_s=0.025,
    m_s=1.013,
    r_s=0.197,
    c_s=0.17,
    R=0.2,
    eps_T=0.097,
    g=9.81,
    knees=True,
    units="SI",
)
_C_PRINTED = replace(_PHYSICAL, w_t=-0.023, r_t=0.1882, c_t=0.084, w_s=0.022, r_s=0.1226)
_POINT = Walker(
    l_t=0.5, w_t=0.0, m_t=0.5, r_t=0.0, c_t=0.0, l_s=0.5, w_s=0.0, m_s=0.0, r_s=0.0, c_s=0.5, R=0.0, eps_T=0.0
)


def tune_exactly(walker: Walker) -> Walker:
    """Give a kneed walker the offsets w_t and w_s that meet section 5.1 exactly; those printed are rounded to 1 mm."""
    w_s = walker.c_s * math.tan(walker.eps_S)
    w_t = -math.tan(walker.eps_T) * (walker.c_t + walker.m_s * walker.l_t / walker.m_t)
    return replace(walker, w_t=w_t, w_s=w_s)


_C = tune_exactly(_C_PRINTED)
#: Walkers by name. A, C and the physical walker are in SI units, the others have g = 1.
CATALOGUE: dict[str, Walker] = {
    "A": replace(_C, knees=False),
    "B": replace(_POINT, m_t=0.4, m_s=0.1, R=0.2),
    "C": _C,
    "D": _POINT,
    "E": replace(_POINT, m_t=0.4, m_s=0.1),
    "F": replace(_POINT, m_t=0.45, m_s=0.05),
    "physical": _PHYSICAL,
    "physical-straight": replace(_PHYSICAL, knees=False),
    "A-printed": replace(_C_PRINTED, knees=False),
    "C-printed": _C_PRINTED,
}
#: Each walker in words.
DESCRIPTIONS = {
    "A": "straight-legged, round feet, exactly tuned",
    "B": "straight-legged, round feet, foot mass at the contact point",
    "C": "kneed, round feet, exactly tuned",
    "D": "the simplest walker: point feet of vanishing mass",
    "E": "point feet, each a tenth of the total mass",
    "F": "point feet, each a twentieth of the total mass",
    "physical": "the kneed physical walker of figure 3",
    "physical-straight": "the physical walker of figure 3, knees locked",
    "A-printed": "A with the offsets as printed",
    "C-printed": "C with the offsets as printed",
}
