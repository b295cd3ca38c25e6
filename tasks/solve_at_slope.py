"""Every gait of a walker at one slope: what `gaitsweep solve` prints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks import status
from tasks.continuation import atlas as atlases
from tasks.fixed_points.labels import places
from tasks.fixed_points.newton import lipschitz
from tasks.fixed_points.polish import UNKNOWN
from tasks.fixed_points.rounding import rounding_std
from tasks.fixed_points.search import search, starts
from tasks.registry import COSTLY, GAITS, VARIABLES
from tasks.solve_points import points, solve
from tasks.step.problem import Problem
from tasks.walkers.resolve import resolve

#: Variables measured for one point; the amounts of violations stay in archives.
WANT = tuple(v for v in VARIABLES if VARIABLES[v].group not in COSTLY or v == "violations")


def solve_one(params: Mapping[str, Any]) -> dict[str, Any]:
    """Every gait of a walker at one slope, in the contract's words.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `slope` [rad], `set` (keys to change), `all` (also gaits whose legs pass more
        than once).

    Returns
    -------
    dict
        `gaits`, a list with one dict a gait; `units` of what they hold; and `search`, sentences on how they were
        sought.

    Raises
    ------
    WalkerError
        If the walker cannot be.
    """
    line = {"walker": params["walker"], "set": params.get("set") or {}}
    slope = float(params["slope"])
    problem = Problem(resolve(line["walker"], line["set"]))
    branches = atlases.survey(problem)
    found = points({"line": line, "slope": np.array([slope]), "want": WANT}, [atlases.to_arrays(branches)])
    gaits = [{k: found[k][0, g] for k in WANT} for g in range(len(GAITS)) if found["status"][0, g] == status.CONVERGED]
    strange: list[dict[str, Any]] = []
    said = [f"{starts(problem, s).shape[1]} starts at slope {s:g}" for s in atlases.ANCHORS]
    said.append(f"{len(branches)} branches followed over {sum(len(b.Z) for b in branches)} points")
    if params.get("all") or not gaits:
        others, tried, nearest = _elsewhere(problem, slope, gaits)
        said.append(tried)
        gaits += [other for other in others if other["passes"] == 1]
        strange = [other for other in others if other["passes"] != 1 and params.get("all")]
        if not gaits:
            said += [str(found["reasons"][1]), str(found["reasons"][5]), nearest]
    angle, ratio = (
        np.array([gait[k] for gait in gaits]).reshape(-1, 1) for k in ("stance_angle", "heelstrike_rate_ratio")
    )
    place = places(angle, ratio)[:, 0]
    records = [_record(_name(place[i]), slope, gaits[i]) for i in np.argsort(place)]
    records += [_record(f"passes_{gait['passes']}_times", slope, gait) for gait in strange]
    units = {"slope": "rad", **{k: VARIABLES[k].units(problem.walker.si) for k in WANT}}
    return {"gaits": records, "units": units, "search": said}


def _name(place: int) -> str:
    """A label by its place; a search may find more than archives have room for."""
    return GAITS[place] if place < 2 else f"other{place - 1}"


def _elsewhere(problem: Problem, slope: float, gaits: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], str, str]:
    """Gaits a search at this very slope finds besides the known ones, what was tried, and the nearest miss."""
    w, _, verdict = search(problem, slope)
    tried = f"{starts(problem, slope).shape[1]} starts at slope {slope:g}"
    if verdict is None:
        return [], tried, "Nearest miss: none of the starts led to a solution of the stride's equations."
    m = problem.m
    q = np.full((1, w.shape[1]), np.log(slope))
    X = np.vstack([w[:m], q])
    unknown = np.full(w.shape[1], UNKNOWN)
    solved = solve(
        problem,
        np.vstack([X, w[m:]]),
        np.exp(q[0]),
        lipschitz(problem, X, w[m:]),
        rounding_std(problem, w, q[0], near=8),
        WANT,
        unknown,
    )
    others = []
    for lane in np.nonzero(verdict.step)[0]:
        angle = solved["stance_angle"][lane]
        if any(abs(angle - g["stance_angle"]) < 1e-8 * abs(angle) for g in gaits) or not np.isfinite(angle):
            continue
        others.append({**{k: solved[k][lane] for k in WANT if k in solved}, "passes": verdict.leg_passes[lane]})
    misses = np.nonzero(~verdict.step)[0]
    nearest = (
        "Nearest miss: none."
        if not len(misses)
        else (
            f"Nearest miss: a solution at stance angle {np.exp(w[0, misses[0]]):.6g} whose guards are crossed "
            "too early."
        )
    )
    return others, tried, nearest


def _record(label: str, slope: float, value: dict[str, Any]) -> dict[str, Any]:
    """One gait in the words of the contract; what is absent is None."""
    plain = {k: _plain(v) for k, v in value.items() if np.ndim(v) == 0}
    pairs = np.stack([value["multiplier_real"], value["multiplier_imag"]], axis=-1)
    names = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period", "kneestrike_time")
    losses = ("loss_normal", "loss_tangential", "loss_kneestrike")
    return {
        "gait": label,
        "slope": slope,
        **{k: plain[k] for k in names},
        "multipliers": pairs.tolist(),
        "stable": bool(plain["spectral_radius"] < 1),
        "speed": plain["speed"],
        **{k: plain[k] for k in losses},
        "violations": _flags(value.get("violations")),
        "status": "converged",
        "residual": plain["residual"],
        "error_bound": plain["error_bound"],
        "branch": plain.get("branch"),
        "piece": plain.get("piece"),
    }


def _flags(bits: Any) -> list[str] | None:
    """Names of the violations whose bits are set."""
    from tasks.registry import VIOLATIONS

    return None if bits is None else [name for i, name in enumerate(VIOLATIONS) if int(bits) >> i & 1]


def _plain(x: Any) -> Any:
    """A Python number, or None where a quantity is absent."""
    x = x.item()
    return None if isinstance(x, float) and not np.isfinite(x) else x
