"""Every gait of a walker at one slope, for `gaitsweep solve`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gaitsweep.tasks import status
from gaitsweep.tasks.continuation import atlas as atlases
from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.refine import COARSE
from gaitsweep.tasks.fixed_points.labels import places
from gaitsweep.tasks.fixed_points.polish import settle, unmeasured
from gaitsweep.tasks.fixed_points.search import search, starts
from gaitsweep.tasks.map_step import map_step
from gaitsweep.tasks.measures.gaits import Wanted, describe
from gaitsweep.tasks.measures.losses import contact_mass
from gaitsweep.tasks.registry import GAITS, VARIABLES, VIOLATIONS
from gaitsweep.tasks.solve_points import atlas, points, spans
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.tuning import untuned
from gaitsweep.tasks.walkers.walker import Walker

#: Variables measured for one point: all but proofs.
_WANT = tuple(v for v in VARIABLES if VARIABLES[v].group != "proofs")
#: First columns of a gait, and all columns.
_FIRST = (
    *("gait", "slope", "stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period", "kneestrike_time"),
    *("multipliers", "stable", "speed", "froude_speed", "cost_of_transport", "power", "step_length"),
    *("loss_normal", "loss_tangential", "loss_kneestrike", "violations", "status", "residual", "error_bound"),
    *("branch", "piece", "velocity_ratio", "contact_mass_matrix"),
)
_COLUMNS = (*_FIRST, *(v for v in _WANT if v not in (*_FIRST, "reason", "multiplier_real", "multiplier_imag")))


def solve_one(params: Mapping[str, Any]) -> dict[str, Any]:
    """Solve every gait of a walker at one slope.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `slope` [rad], `set` (keys to change), `all` (also gaits whose legs pass more
        than once), `steps` after which the gaits repeat (1 if omitted), `accuracy`, the largest error bound wanted
        (0 for any), `violation_limits`, those of violations that are not the registry's.

    Returns
    -------
    dict
        `gaits`, a list of one dict per gait, in the walker's units; `columns`, its keys; `units` of its entries;
        `search`, sentences on how the gaits were searched for; and `absent`, why there is no long or no short one.

    Raises
    ------
    WalkerError
        If the walker is invalid.
    """
    line = {"walker": params["walker"], "set": params.get("set") or {}}
    slope, walker = float(params["slope"]), walker_of_line(line)
    asked = {name: params[name] for name in ("steps", "accuracy", "violation_limits") if name in params}
    request = {"line": line, "slope": np.array([slope]), "want": _WANT, **asked}
    if int(params.get("steps", 1)) > 1:
        return _solve_cycles(request, walker)
    problem = Problem(walker)
    branches = atlases.survey(problem, COARSE)
    point = points(request, [atlases.to_arrays(branches)])
    gaits = _converged(point)
    non_anthropomorphic: list[dict[str, Any]] = []
    log = [*filter(None, [untuned(line)]), atlases.searched(problem.walker)]
    nodes = sum(len(branch.q) for branch in branches)
    log.append(f"{len(branches)} branch{'es' * (len(branches) != 1)} continued over {nodes} points")
    if params.get("all") or not gaits:
        others, nearest = _search_slope(problem, request, gaits)
        log.append(f"{starts(walker, [slope])[0].shape[1]} initial guesses at slope {slope:g}")
        gaits += [other for other in others if other["passes"] == 1]
        non_anthropomorphic = [other for other in others if other["passes"] != 1 and params.get("all")]
        if not gaits:
            log += [*point["reasons"][[status.NO_LONG, status.NO_SHORT]].tolist(), nearest]
    angle, ratio = (
        np.array([gait[k] for gait in gaits]).reshape(-1, 1) for k in ("stance_angle", "heelstrike_rate_ratio")
    )
    place = places(angle, ratio)[:, 0]
    records = [_record(_name(place[i]), slope, gaits[i], walker) for i in np.argsort(place)]
    records += [_record(f"passes_{gait['passes']}_times", slope, gait, walker) for gait in non_anthropomorphic]
    return _answer(records, walker.si, log, _absent(branches, point, slope, [record["gait"] for record in records]))


def _absent(branches: list[Branch], point: Mapping[str, Any], slope: float, labels: list[str]) -> list[str]:
    """Why there is no gait of a label; where branches were lost, what they span does not say it."""
    are_whole = not any(branch.lost() for branch in branches)
    pieces = {label: list(spans(branches, label)) if are_whole else [] for label in GAITS[:2]}
    return [
        status.beyond(label, pieces[label], slope) or str(point["reasons"][point["reason"][0, g]])
        for g, label in enumerate(GAITS[:2])
        if label not in labels
    ]


def _converged(point: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Variables of each gait that converged at the only slope."""
    return [{k: point[k][0, g] for k in _WANT} for g in range(len(GAITS)) if point["status"][0, g] in status.SOLVED]


def _answer(records: list[dict[str, Any]], is_si: bool, log: list[str], absent: Sequence[str] = ()) -> dict[str, Any]:
    units = {"slope": "rad", **{k: VARIABLES[k].units(is_si) for k in _WANT}}
    return {"gaits": records, "columns": list(_COLUMNS), "units": units, "search": log, "absent": absent}


def _solve_cycles(request: Mapping[str, Any], walker: Walker) -> dict[str, Any]:
    """Gaits that repeat after some steps, of which the branches alone are searched."""
    point, slope = points(request, [atlas(request, [])]), float(request["slope"][0])
    labels = [GAITS[g] for g in range(len(GAITS)) if point["status"][0, g] in status.SOLVED]
    records = []
    for label, gait in zip(labels, _converged(point), strict=True):
        state = [gait[name] for name in ("stance_angle", "stance_rate", "thigh_rate")]
        # The heelstrike is at another angle than the one before.
        end = map_step({**request["line"], "slope": slope, "state": state})["state"][0]
        records.append(_record(label, slope, gait, walker, float(end)))
    log = [] if records else [str(point["reasons"][status.NO_LONG])]
    return _answer(records, walker.si, log)


def _name(place: int) -> str:
    """Label of a gait by its place; a search may find more gaits than archives have labels."""
    return GAITS[place] if place < 2 else f"other{place - 1}"


def _search_slope(
    problem: Problem, request: Mapping[str, Any], gaits: list[dict[str, Any]]
) -> tuple[list[dict[str, Any]], str]:
    """Gaits that a search at the only slope finds besides the known ones, and its nearest miss in words."""
    (slope,), wanted = request["slope"].tolist(), Wanted.of(request)
    w, _, verdict = search(problem, slope)
    if verdict is None:
        return [], "Nearest miss: no initial guess led to a solution of the step's equations."
    slopes = np.full(w.shape[1], slope)
    at = settle(problem, unmeasured(problem, w, slopes), accuracy=wanted.accuracy)
    solved = describe(problem, at, slopes, _WANT, wanted.limits)
    others = []
    for lane in np.nonzero(verdict.step)[0]:
        angle = solved["stance_angle"][lane]
        if any(abs(angle - g["stance_angle"]) < 1e-8 * abs(angle) for g in gaits) or not np.isfinite(angle):
            continue
        others.append({**{k: solved[k][lane] for k in _WANT if k in solved}, "passes": verdict.leg_passes[lane]})
    misses = np.nonzero(~verdict.step)[0]
    nearest = (
        "Nearest miss: none."
        if not len(misses)
        else (
            f"Nearest miss: a solution at stance angle {np.exp(w[0, misses[0]]):.6g} that is not a step: an event "
            "occurs too early."
        )
    )
    return others, nearest


def _record(
    label: str, slope: float, value: dict[str, Any], walker: Walker, end: float | None = None
) -> dict[str, Any]:
    """One gait as a plain dict, its heelstrike at the angle `end` or that of its start; an absent quantity is None."""
    plain = {k: _plain(v) for k, v in value.items() if np.ndim(v) == 0}
    pairs = np.stack([value["multiplier_real"], value["multiplier_imag"]], axis=-1)
    angle = np.atleast_1d(value["stance_angle"] if end is None else end)
    record = {
        **plain,
        "gait": label,
        "slope": slope,
        "multipliers": pairs.tolist(),
        "stable": bool(plain["spectral_radius"] < 1),
        "violations": _flags(value.get("violations")),
        "status": "less_accurate" if value["status"] == status.LESS_ACCURATE else "converged",
        "contact_mass_matrix": (walker.total_mass * contact_mass(walker, angle)[0]).tolist(),
    }
    return {name: record.get(name) for name in _COLUMNS}


def _flags(bits: Any) -> list[str] | None:
    """Names of the violations whose bits are set."""
    return None if bits is None else [name for i, name in enumerate(VIOLATIONS) if int(bits) >> i & 1]


def _plain(x: Any) -> Any:
    """A Python number, or None where a quantity is absent; a friction demand may be infinite."""
    x = x.item()
    return None if isinstance(x, float) and np.isnan(x) else x
