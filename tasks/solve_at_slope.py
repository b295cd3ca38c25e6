"""Every gait of a walker at one slope, for `gaitsweep solve`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gaitsweep.tasks import status
from gaitsweep.tasks.continuation import atlas as atlases
from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.refine import COARSE
from gaitsweep.tasks.dynamics.initial_states import labelled
from gaitsweep.tasks.fixed_points.labels import places
from gaitsweep.tasks.fixed_points.polish import are_same, settle, unmeasured
from gaitsweep.tasks.fixed_points.search import search, starts
from gaitsweep.tasks.fixed_points.step_check import gait_ratio
from gaitsweep.tasks.map_step import map_step
from gaitsweep.tasks.measures.gaits import Wanted, describe, to_accuracy
from gaitsweep.tasks.measures.losses import contact_mass
from gaitsweep.tasks.registry import GAITS, VARIABLES, VIOLATIONS
from gaitsweep.tasks.solve_points import atlas, points, spans
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.tuning import untuned
from gaitsweep.tasks.walkers.walker import Walker

#: Variables measured for one point: all but proofs.
WANT = tuple(v for v in VARIABLES if VARIABLES[v].group != "proofs")
#: First columns of a gait, and all columns.
_FIRST = (
    *(
        "gait",
        "slope",
        "stance_angle",
        "stance_rate",
        "thigh_rate",
        "shank_rate",
        "period",
        "kneestrike_time",
    ),
    *(
        "multipliers",
        "stable",
        "speed",
        "froude_speed",
        "cost_of_transport",
        "power",
        "step_length",
    ),
    *(
        "loss_normal",
        "loss_tangential",
        "loss_kneestrike",
        "violations",
        "status",
        "residual",
        "error_bound",
    ),
    *("branch", "piece", "velocity_ratio", "contact_mass_matrix"),
)
_COLUMNS = (
    *_FIRST,
    *(
        v
        for v in WANT
        if v not in (*_FIRST, "reason", "multiplier_real", "multiplier_imag")
    ),
)


def solve_one(params: Mapping[str, Any]) -> dict[str, Any]:
    """Solve every gait of a walker at one slope.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `slope` [rad], `set` (keys to change), `all` (also
        gaits whose legs pass more than once), `steps` after which the gaits repeat (1
        if omitted), `accuracy`, the largest error bound wanted (0 for any),
        `violation_limits`, those of violations that are not the registry's.

    Returns
    -------
    dict
        `gaits`, a list of one dict per gait, in the walker's units; `columns`, its
        keys; `units` of its entries; `search`, sentences on how the gaits were searched
        for; and `absent`, why there is no long or no short one.

    Raises
    ------
    WalkerError
        If the walker is invalid.
    """
    line = {"walker": params["walker"], "set": params.get("set") or {}}
    slope, walker = float(params["slope"]), walker_of_line(line)
    asked = {
        name: params[name]
        for name in ("steps", "accuracy", "violation_limits")
        if name in params
    }
    request = {"line": line, "slope": np.array([slope]), "want": WANT, **asked}
    if int(params.get("steps", 1)) > 1:
        return _solve_cycles(request, walker)
    problem = Problem(walker)
    branches = atlases.survey(problem, COARSE)
    point = points(request, [atlases.to_arrays(branches)])
    found = _converged(point)
    log = [*filter(None, [untuned(line)]), atlases.searched(problem.walker)]
    nodes = sum(len(branch.q) for branch in branches)
    log.append(
        f"{len(branches)} branch{'es' * (len(branches) != 1)} continued over {nodes} points"
    )
    if params.get("all") or not found:
        found, others, nearest = _search_slope(problem, request, branches, found)
        log.append(
            f"{starts(walker, [slope])[0].shape[1]} initial guesses at slope {slope:g}"
        )
        if not found:
            log += [
                *point["reasons"][[status.NO_LONG, status.NO_SHORT]].tolist(),
                nearest,
            ]
    else:
        others = []
        log += _left_out(point)
    records = [
        record(_name(place), slope, found[place], walker) for place in sorted(found)
    ]
    if params.get("all"):
        records += [
            record(f"passes_{gait['passes']}_times", slope, gait, walker)
            for gait in others
        ]
    return answer(
        records,
        walker.si,
        log,
        _absent(branches, point, slope, [record["gait"] for record in records]),
    )


def _absent(
    branches: list[Branch], point: Mapping[str, Any], slope: float, labels: list[str]
) -> list[str]:
    """Why there is no gait of a label; where branches were lost, what they span does
    not say it.
    """
    are_whole = not any(branch.lost() for branch in branches)
    pieces = {
        label: list(spans(branches, label)) if are_whole else [] for label in GAITS[:2]
    }
    return [
        status.beyond(label, pieces[label], slope)
        or str(point["reasons"][point["reason"][0, g]])
        for g, label in enumerate(GAITS[:2])
        if label not in labels
    ]


def _converged(point: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
    """Variables of each gait that converged at the only slope, by the place of its
    label.
    """
    solved = np.flatnonzero(np.isin(point["status"][0], status.SOLVED)).tolist()
    return {g: {k: point[k][0, g] for k in WANT} for g in solved}


def _left_out(point: Mapping[str, Any]) -> list[str]:
    """What is said where branches have more gaits than there are labels."""
    has_more = (point["reason"] == status.UNLABELLED).any()
    return [str(point["reasons"][status.UNLABELLED])] if has_more else []


def answer(
    records: list[dict[str, Any]],
    is_si: bool,
    log: list[str],
    absent: Sequence[str] = (),
) -> dict[str, Any]:
    """Return what a solve answers.

    Parameters
    ----------
    records : list of dict
        Of the gaits, as `record` describes them.
    is_si : bool
        Whether the walker is in SI units.
    log : list of str
        How gaits were searched for, in sentences.
    absent : sequence of str
        Why there are none.
    """
    units = {"slope": "rad", **{k: VARIABLES[k].units(is_si) for k in WANT}}
    return {
        "gaits": records,
        "columns": list(_COLUMNS),
        "units": units,
        "search": log,
        "absent": absent,
    }


def _solve_cycles(request: Mapping[str, Any], walker: Walker) -> dict[str, Any]:
    """Gaits that repeat after some steps, of which the branches alone are searched."""
    point, slope = points(request, [atlas(request, [])]), float(request["slope"][0])
    records = []
    for place, gait in _converged(point).items():
        state = [gait[name] for name in ("stance_angle", "stance_rate", "thigh_rate")]
        # The heelstrike is at another angle than the one before.
        end = map_step({**request["line"], "slope": slope, "state": state})["state"][0]
        records.append(record(GAITS[place], slope, gait, walker, float(end)))
    log = _left_out(point) if records else [str(point["reasons"][status.NO_LONG])]
    return answer(records, walker.si, log)


def _name(place: int) -> str:
    """Label of a gait by its place; a search may find more gaits than archives have
    labels.
    """
    return GAITS[place] if place < 2 else f"other{place - 1}"


def _search_slope(
    problem: Problem,
    request: Mapping[str, Any],
    branches: list[Branch],
    found: dict[int, dict[str, Any]],
) -> tuple[dict[int, dict[str, Any]], list[dict[str, Any]], str]:
    """What a search at the only slope adds to the gaits that branches have there.

    Returns
    -------
    anthropomorphic : dict of dict
        Variables of all gaits by the places of their labels, anew: those `found` on
        branches, and others.
    others : list of dict
        Variables of gaits whose legs pass more than once.
    nearest : str
        The nearest miss in words.
    """
    (slope,), wanted = request["slope"].tolist(), Wanted.of(request)
    w, _, verdict = search(problem, slope)
    if verdict is None:
        return (
            found,
            [],
            "Nearest miss: no initial guess led to a solution of the step's equations.",
        )
    slopes = np.full(w.shape[1], slope)
    # What is one gait, and its label, are decided by all digits, whatever the accuracy
    # wanted.
    at = settle(problem, unmeasured(problem, w, slopes))
    is_new, gaits = at.step & at.converged, []
    for _, place, known in labelled(problem, branches, np.array([slope])):
        has_label = np.isin(place, list(found))
        is_new &= ~are_same(at, known)[:, has_label].any(axis=1)
        angle, ratio = known.w[0], gait_ratio(known.stride)
        gaits += [
            (angle[lane], ratio[lane], found[int(place[lane])])
            for lane in np.flatnonzero(has_label)
        ]

    measured = describe(problem, at, slopes, WANT, wanted.limits)
    measured = {name: measured[name] for name in WANT if name in measured}
    to_accuracy(
        {name: values[:, None] for name, values in measured.items()}, wanted.accuracy
    )
    others, ratio = [], gait_ratio(at.stride)
    for lane in np.flatnonzero(is_new).tolist():
        gait = {name: values[lane] for name, values in measured.items()} | {
            "passes": verdict.leg_passes[lane]
        }
        if gait["passes"] == 1:
            gaits.append((at.w[0, lane], ratio[lane], gait))
        else:
            others.append(gait)

    angle, ratio = (
        np.array([gait[k] for gait in gaits]).reshape(-1, 1) for k in (0, 1)
    )
    labels = places(angle, ratio)[:, 0].tolist()
    misses = np.flatnonzero(~at.step)
    nearest = "Nearest miss: none."
    if len(misses):
        where = f"Nearest miss: a solution at stance angle {np.exp(w[0, misses[0]]):.6g} that"
        is_known = not at.doubt[misses[0]]
        nearest = (
            f"{where} is not a step: an event occurs too early."
            if is_known
            else f"{where} may be no step."
        )
    return (
        {label: gait for label, (*_, gait) in zip(labels, gaits, strict=True)},
        others,
        nearest,
    )


def record(
    label: str,
    slope: float,
    value: dict[str, Any],
    walker: Walker,
    end: float | None = None,
) -> dict[str, Any]:
    """Return one gait as a plain dict; an absent quantity is None.

    Parameters
    ----------
    label : str
    slope : float [rad]
    value : dict
        Its variables, as `describe` measures them.
    walker : Walker
    end : float, optional [rad]
        The angle at its heelstrike, by default that of its start.
    """
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
        "status": "less_accurate"
        if value["status"] == status.LESS_ACCURATE
        else "converged",
        "contact_mass_matrix": (
            walker.total_mass * contact_mass(walker, angle)[0]
        ).tolist(),
    }
    return {name: record.get(name) for name in _COLUMNS}


def _flags(bits: Any) -> list[str] | None:
    """Names of the violations whose bits are set."""
    return (
        None
        if bits is None
        else [name for i, name in enumerate(VIOLATIONS) if int(bits) >> i & 1]
    )


def _plain(x: Any) -> Any:
    """A Python number, or None where a quantity is absent; a friction demand may be
    infinite.
    """
    x = x.item()
    return None if isinstance(x, float) and np.isnan(x) else x
