"""The static conditions of section 5.1 of the paper, and the nearest walker that meets them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tasks.walkers.catalogue import CATALOGUE
from tasks.walkers.resolve import resolve
from tasks.walkers.walker import KEYS, NUMBERS, Walker, WalkerError

#: Largest residual, over the leg's length, at which the conditions count as met.
_MAX_RESIDUAL = 1e-12


def statics(walker: Walker) -> dict[str, float]:
    """Residuals of the two static conditions; both vanish for a tuned walker.

    Returns
    -------
    dict of float [the walker's unit of length]
        `leg_offset`, how far the extended leg's centre of mass lies behind the line from hip to foot centre, and, with
        knees, `shank_offset`, how far the shank's lies behind the parallel line through the knee.

    Notes
    -----
    Paper, section 5.1.
    """
    mass = walker.m_t + walker.m_s
    leg_offset = {"leg_offset": -leg_moment(walker).real / mass if mass else 0.0}
    return leg_offset | ({"shank_offset": -walker.shank_centre.real} if walker.knees else {})


def leg_moment(walker: Walker) -> Any:
    """Return the first moment of the extended leg's mass about the hip, x forward + i y up, of one walker or many."""
    return walker.m_t * walker.thigh_centre + walker.m_s * (walker.knee + walker.shank_centre)


def is_tuned(walker: Walker) -> bool:
    """Whether both static conditions hold to rounding."""
    return all(abs(x) < 1e-14 * walker.leg for x in statics(walker).values())


def untuned(params: Mapping[str, Any]) -> str:
    """Say that keys move a tuned walker of the catalogue off the static conditions.

    Parameters
    ----------
    params : mapping
        `walker` (name or table) and `set` (values of keys, in the walker's units).

    Returns
    -------
    str
        A sentence; empty where the walker is tuned, was not before, or is detuned on purpose by `detuning`.

    Raises
    ------
    WalkerError
        If the walker, a key or a value is invalid.
    """
    given, changes = params["walker"], dict(params.get("set") or {})
    table = {"base": given} if isinstance(given, str) else dict(given)
    if table.get("base") not in CATALOGUE or "detuning" in (*table, *changes):
        return ""
    base, walker = CATALOGUE[table["base"]], resolve(given, changes)
    if not is_tuned(base) or is_tuned(walker):
        return ""
    keys = ", ".join(key for key in dict.fromkeys((*table, *changes)) if key in (*KEYS, "foot_mass_ratio"))
    off = ", ".join(f"{name} {value:.3g}" for name, value in statics(walker).items())
    return (
        f"With this {keys}, {table['base']} is no longer tuned ({off}): it has no gaits at vanishing slopes. "
        "`gaitsweep tune` shows the nearest walker that is."
    )


def tune(params: Mapping[str, Any]) -> dict[str, Any]:
    """Find the nearest zero-slope-capable walker: the smallest relative change of the freed keys.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `free` (keys that may change; default `w_t`, `w_s`).

    Returns
    -------
    dict
        `walker` (a table ready to paste), `moved` (old and new value by key, in the walker's units; empty where the
        walker meets the conditions as it is), `change` (relative change by key), and `statics` `before` and `after`.

    Raises
    ------
    WalkerError
        If a key cannot be freed or no change of the freed keys meets the conditions.
    """
    start = resolve(params["walker"])
    free = list(dict.fromkeys(params.get("free") or ("w_t", "w_s")))
    for key in free:
        if key not in NUMBERS:
            raise WalkerError("free", key, f"must name walker keys ({', '.join(NUMBERS)})")
    is_met = np.abs(_residual(start)).max() <= _MAX_RESIDUAL
    tuned, change = (start, [0.0] * len(free)) if is_met else _nearest(start, free)
    moved = {k: [getattr(start, k), getattr(tuned, k)] for k in free if getattr(tuned, k) != getattr(start, k)}
    return {
        "walker": tuned.table(),
        "moved": moved,
        "change": dict(zip(free, change, strict=True)),
        "before": statics(start),
        "after": statics(tuned),
    }


def _residual(walker: Walker) -> np.ndarray:
    """Residuals of the conditions over the leg's length, shape (conditions,)."""
    return np.array(list(statics(walker).values())) / walker.leg


def _nearest(start: Walker, free: list[str]) -> tuple[Walker, list[float]]:
    """The nearest walker that meets the conditions, and the relative change of the freed keys."""
    # Offsets near zero have no relative size of their own: the leg is their scale.
    scale = np.array([abs(getattr(start, k)) or start.leg for k in free])

    def at(change: np.ndarray) -> Walker:
        values: dict[str, Any] = {
            k: float(getattr(start, k) + s * c) for k, s, c in zip(free, scale, change, strict=True)
        }
        return replace(start, **values)

    def residual(change: np.ndarray) -> np.ndarray:
        # Over the initial leg, whatever keys move: a fixed scale.
        return np.array(list(statics(at(change)).values())) / start.leg

    # Gauss-Newton with least-norm steps: the nearest point of the tuned manifold in relative change.
    change = np.zeros(len(free))
    impossible = WalkerError("free", ", ".join(free), "cannot meet the zero-slope conditions; free another key")
    for _ in range(60):
        h = 1e-7
        try:
            r = residual(change)
            jacobian = np.array([(residual(change + h * e) - r) / h for e in np.eye(len(free))]).T
        except WalkerError:
            raise impossible from None
        target = np.linalg.pinv(jacobian, rcond=1e-9) @ (jacobian @ change - r)
        step = target - change
        change = target
        if np.abs(step).max() < 1e-15:
            break
    if np.abs(residual(change)).max() > _MAX_RESIDUAL:
        raise impossible
    return at(change), change.tolist()
