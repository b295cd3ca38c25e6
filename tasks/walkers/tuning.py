from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tasks.walkers.resolve import from_table, named
from tasks.walkers.walker import NUMBERS, Walker, WalkerError

#: Residual over the leg at which the conditions are met.
MET = 1e-12


def statics(walker: Walker) -> dict[str, float]:
    """Residuals of the two static conditions of section 5.1, as lengths; both vanish for a tuned walker.

    `leg_offset` is how far the extended leg's centre of mass lies behind the hip-foot-centre line;
    `shank_offset` how far the shank's lies behind the line through the knee parallel to it (kneed only).
    """
    leg = walker.m_t * walker.thigh_centre + walker.m_s * (walker.knee + walker.shank_centre)
    mass = walker.m_t + walker.m_s
    found = {"leg_offset": -leg.real / mass if mass else 0.0}
    if walker.knees:
        found["shank_offset"] = -walker.shank_centre.real
    return found


def is_tuned(walker: Walker) -> bool:
    """True where both static conditions hold to rounding."""
    return all(abs(x) < 1e-14 * walker.leg for x in statics(walker).values())


def tune(params: Mapping[str, Any]) -> dict[str, Any]:
    """The nearest zero-slope-capable walker: smallest relative change of the freed keys.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `free` (keys that may change; default `w_t`, `w_s`).

    Returns
    -------
    dict
        `walker` (a table ready to paste), `moved` (old and new value by key; empty where the walker meets the
        conditions as it is), `change` (relative change by key), `statics` before and after.

    Raises
    ------
    WalkerError
        If a key cannot be freed or no change of the freed keys meets the conditions.
    """
    start = named(params["walker"]) if isinstance(params["walker"], str) else from_table(params["walker"])
    free = list(dict.fromkeys(params.get("free") or ("w_t", "w_s")))
    for key in free:
        if key not in NUMBERS:
            raise WalkerError("free", key, f"must name walker keys ({', '.join(NUMBERS)})")
    met = _worst(start) <= MET
    found, change = (start, [0.0] * len(free)) if met else _nearest(start, free)
    moved = {k: [getattr(start, k), getattr(found, k)] for k in free if getattr(found, k) != getattr(start, k)}
    return {
        "walker": found.table(),
        "moved": moved,
        "change": dict(zip(free, change)),
        "before": statics(start),
        "after": statics(found),
    }


def _worst(walker: Walker) -> float:
    """Largest residual of the conditions, over the leg."""
    return max(map(abs, statics(walker).values())) / walker.leg


def _nearest(start: Walker, free: list[str]) -> tuple[Walker, list[float]]:
    """The nearest walker that meets the conditions, and the relative change of the freed keys."""
    import numpy as np

    # Offsets near zero have no relative size of their own: the leg is their scale.
    scale = np.array([abs(getattr(start, k)) or start.leg for k in free])

    def at(change: np.ndarray) -> Walker:
        return replace(start, **{k: float(getattr(start, k) + s * c) for k, s, c in zip(free, scale, change)})

    def residual(change: np.ndarray) -> np.ndarray:
        return np.array(list(statics(at(change)).values())) / start.leg

    # Gauss-Newton with least-norm steps: the nearest point of the tuned manifold in relative change.
    change = np.zeros(len(free))
    impossible = WalkerError("free", ", ".join(free), "cannot meet the zero-slope conditions; free another key")
    for _ in range(60):
        h = 1e-7
        try:
            r = residual(change)
            jac = np.array([(residual(change + h * e) - residual(change)) / h for e in np.eye(len(free))]).T
        except WalkerError:
            raise impossible from None
        target = np.linalg.pinv(jac, rcond=1e-9) @ (jac @ change - r)
        step = target - change
        change = target
        if np.abs(step).max() < 1e-15:
            break
    if np.abs(residual(change)).max() > MET:
        raise impossible
    return at(change), change.tolist()
