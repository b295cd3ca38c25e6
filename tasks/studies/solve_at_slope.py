"""Every gait of a walker at one slope, for `gaitsweep solve`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.registry import GAITS, OF_TARGETS, VARIABLES, VIOLATIONS
from gaitsweep.tasks.gaits.labels import places
from gaitsweep.tasks.gaits.polish import (
    Polished,
    are_same,
    settle,
    unmeasured,
)
from gaitsweep.tasks.gaits.search import search, starts
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.measures.gaits import Arrays, to_accuracy
from gaitsweep.tasks.measures.losses import contact_mass
from gaitsweep.tasks.orbits.initial_states import labelled
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.map_step import map_step
from gaitsweep.tasks.studies.request import Request
from gaitsweep.tasks.studies.solve_driven import driven
from gaitsweep.tasks.studies.solve_driven import searched as searched_driven
from gaitsweep.tasks.studies.solve_guesses import solve_guesses
from gaitsweep.tasks.studies.solve_points import atlas, solve_line, spans
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.tuning import untuned
from gaitsweep.tasks.walkers.walker import TRAILING_KNEES, Walker

#: Variables measured for one point: all but proofs.
WANT = tuple(v for v in VARIABLES if VARIABLES[v].group not in ("proofs", OF_TARGETS))
#: First columns of a gait, and all columns.
_FIRST = (
    "gait",
    "slope",
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "shank_rate",
    "period",
    "kneestrike_time",
    "multipliers",
    "stable",
    "speed",
    "froude_speed",
    "cost_of_transport",
    "power",
    "step_length",
    "loss_normal",
    "loss_tangential",
    "loss_kneestrike",
    "violations",
    "status",
    "residual",
    "error_bound",
    "branch",
    "piece",
    "velocity_ratio",
    "contact_mass_matrix",
)
_NOT_SHOWN = ("reason", "multiplier_real", "multiplier_imag")
_COLUMNS = (*_FIRST, *(v for v in WANT if v not in (*_FIRST, *_NOT_SHOWN)))

#: Variables of a gait by name; a gait with its angle and rate ratio, which label it.
_Gait = dict[str, Any]
_Labelled = tuple[float, float, _Gait]


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
    request = Request.of({**params, "slope": [params["slope"]], "want": WANT})
    if request.slope[0] <= 0:
        return _solve_driven(line, walker_of_line(line), request)
    if request.steps > 1:
        return _solve_cycles(line, request, walker_of_line(line))
    return _solve_steps(line, request, bool(params.get("all")))


def _solve_steps(
    line: Mapping[str, Any], request: Request, is_all: bool
) -> dict[str, Any]:
    """Gaits that repeat after one step; those whose legs pass more than once if all are
    wanted.
    """
    problem = Problem(walker_of_line(line))
    walker = problem.walker
    slope = float(request.slope[0])
    branches = atlases.survey(problem, COARSE)
    point = solve_line(line, branches, request)
    log = [*filter(None, [untuned(line)]), *_surveyed(problem, branches)]

    # Where the branches have no gait, and where all are wanted, the slope is searched.
    found = _converged(point)
    others = list[_Gait]()
    if is_all or not found:
        found, others, nearest = _search_slope(problem, request, branches, found)
        guesses = starts(walker, [slope])[0].shape[1]
        log.append(f"{guesses} initial guesses at slope {slope:g}")
        if not found:
            log += [nearest, *_by_the_other_rule(walker, slope)]
    else:
        log += _left_out(point)

    gaits = _labelled(found)
    absent = _absent(branches, point, slope, [label for label, _ in gaits])
    if is_all:
        gaits += [(f"passes_{gait['passes']}_times", gait) for gait in others]
    records = [record(label, slope, gait, walker) for label, gait in gaits]
    return answer(records, walker, log, absent)


def _labelled(found: Mapping[int, _Gait]) -> list[tuple[str, _Gait]]:
    """Gaits by the place of their label, in their order, with these labels."""
    return [(_name(place), found[place]) for place in sorted(found)]


def _solve_driven(
    line: Mapping[str, Any], walker: Walker, request: Request
) -> dict[str, Any]:
    """Gaits on level ground or uphill, where push-off or torque drive."""
    slope = float(request.slope[0])
    point = solve_line(line, [], request)
    found = _converged(point)
    records = [record(label, slope, gait, walker) for label, gait in _labelled(found)]
    absent = [
        str(point["reasons"][point["reason"][0, place]])
        for place in range(2)
        if place not in found
    ]
    problem, drive = driven(walker, slope, request.steps)
    log = [searched_driven(problem)] if drive else []
    return answer(records, walker, log, [*dict.fromkeys(absent)])


def _surveyed(problem: Problem, branches: list[Branch]) -> list[str]:
    """What is said of the survey that found branches."""
    nodes = sum(len(branch.q) for branch in branches)
    plural = "" if len(branches) == 1 else "es"
    return [
        atlases.searched(problem.walker),
        f"{len(branches)} branch{plural} continued over {nodes} points",
    ]


def _absent(
    branches: list[Branch],
    point: Mapping[str, Any],
    slope: float,
    labels: list[str],
) -> list[str]:
    """Why there is no gait of a label; where branches were lost, what they span does
    not say it.
    """
    are_whole = not any(branch.lost() for branch in branches)
    absent = []
    for place, label in enumerate(GAITS[:2]):
        if label not in labels:
            pieces = list(spans(branches, label)) if are_whole else []
            reason = point["reasons"][point["reason"][0, place]]
            absent.append(status.beyond(label, pieces, slope) or str(reason))

    return absent


def _converged(point: Mapping[str, Any]) -> dict[int, _Gait]:
    """Variables of each gait that converged at the only slope, by the place of its
    label.
    """
    solved = np.flatnonzero(np.isin(point["status"][0], status.SOLVED)).tolist()
    return {g: {k: point[k][0, g] for k in WANT} for g in solved}


def _by_the_other_rule(walker: Walker, slope: float) -> list[str]:
    """What is said where a walker with knees has gaits at a slope only if its trailing
    knee follows the other rule.
    """
    if not walker.knees:
        return []

    rule = next(each for each in TRAILING_KNEES if each != walker.trailing_knee)
    other = Problem(replace(walker, trailing_knee=rule))
    *_, check = search(other, slope)
    if check is None or not check.anthropomorphic.any():
        return []

    return [f'The walker has gaits at this slope with `trailing_knee` = "{rule}"']


def _left_out(point: Mapping[str, Any]) -> list[str]:
    """What is said where branches have more gaits than there are labels."""
    has_more = (point["reason"] == status.UNLABELLED).any()
    return [str(point["reasons"][status.UNLABELLED])] if has_more else []


def answer(
    records: list[dict[str, Any]],
    walker: Walker,
    log: list[str],
    absent: Sequence[str] = (),
) -> dict[str, Any]:
    """Return what a solve answers.

    Parameters
    ----------
    records : list of dict
        Of the gaits, as `record` describes them.
    walker : Walker
    log : list of str
        How gaits were searched for, in sentences.
    absent : sequence of str
        Why there are none.
    """
    units = {name: VARIABLES[name].units(walker.si) for name in WANT}
    return {
        "gaits": records,
        "columns": _columns(walker),
        "units": {"slope": "rad", **units},
        "search": log,
        "absent": absent,
    }


def _solve_cycles(
    line: Mapping[str, Any], request: Request, walker: Walker
) -> dict[str, Any]:
    """Gaits that repeat after some steps, of which the branches alone are searched."""
    slope = float(request.slope[0])
    arrays = atlas({"line": line, "steps": request.steps}, [])
    point = solve_line(line, atlases.from_arrays(arrays), request)
    gaits = []
    for place, gait in _converged(point).items():
        gait |= end_of_first_step(line, slope, gait)
        gaits.append((GAITS[place], gait))

    log = _left_out(point) if gaits else []
    absent = [] if gaits else [str(point["reasons"][status.NO_LONG])]
    records = [record(label, slope, gait, walker) for label, gait in gaits]
    return answer(records, walker, log, absent)


def end_of_first_step(
    line: Mapping[str, Any], slope: float, gait: Mapping[str, Any]
) -> dict[str, float]:
    """Return what `record` needs of a gait of several steps: `end`, the stance angle
    after its first step [rad], whose heelstrike is at another than the one before.

    Parameters
    ----------
    line : mapping
    slope : float [rad]
    gait : mapping
        Its variables.
    """
    state = [gait[name] for name in ("stance_angle", "stance_rate", "thigh_rate")]
    after = map_step({**line, "slope": slope, "state": state})["state"]
    return {"end": float(after[0])}


def _name(place: int) -> str:
    """Label of a gait by its place; a search may find more gaits than archives have
    labels.
    """
    return GAITS[place] if place < 2 else f"other{place - 1}"


def _search_slope(
    problem: Problem,
    request: Request,
    branches: list[Branch],
    found: dict[int, _Gait],
) -> tuple[dict[int, _Gait], list[_Gait], str]:
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
    slope = request.slope[0]
    wanted = request.wanted
    w, _, verdict = search(problem, float(slope))
    if verdict is None:
        none = "no initial guess led to a solution of the step's equations"
        return found, [], f"Nearest miss: {none}."

    # What is one gait, and its label, are decided by all digits, whatever the accuracy
    # wanted.
    guesses = unmeasured(problem, w, np.full(w.shape[1], slope))
    solved = solve_guesses(problem, [guesses], settle, wanted)
    at = solved.at
    gaits = _to_accuracy(solved.gaits, wanted.accuracy)

    labels, is_new = _known(problem, branches, request.slope, found, at)
    others = []
    ratio = gait_ratio(at.stride)
    for lane in np.flatnonzero(is_new).tolist():
        gait = {name: values[lane] for name, values in gaits.items()}
        gait["passes"] = verdict.leg_passes[lane]
        if gait["passes"] == 1:
            labels.append((at.w[0, lane], ratio[lane], gait))
        else:
            others.append(gait)

    return _by_label(labels), others, _nearest_miss(at, w)


def _to_accuracy(gaits: Arrays, accuracy: float) -> Arrays:
    """The variables of gaits that are shown, to an accuracy."""
    shown = {name: gaits[name] for name in WANT if name in gaits}
    to_accuracy({name: values[:, None] for name, values in shown.items()}, accuracy)
    return shown


def _known(
    problem: Problem,
    branches: list[Branch],
    slope: np.ndarray,
    found: Mapping[int, _Gait],
    at: Polished,
) -> tuple[list[_Labelled], np.ndarray]:
    """What labels the gaits found on branches, and which of the gaits of a search are
    others, bool (n,).
    """
    is_new = at.step & at.converged
    labels = []
    for _, place, known in labelled(problem, branches, slope):
        has_label = np.isin(place, list(found))
        is_new &= ~are_same(at, known)[:, has_label].any(axis=1)
        angle = known.w[0]
        ratio = gait_ratio(known.stride)
        for lane in np.flatnonzero(has_label).tolist():
            labels.append((angle[lane], ratio[lane], found[int(place[lane])]))

    return labels, is_new


def _by_label(gaits: list[_Labelled]) -> dict[int, _Gait]:
    """Gaits by the places of their labels."""
    angle = np.array([angle for angle, _, _ in gaits]).reshape(-1, 1)
    ratio = np.array([ratio for _, ratio, _ in gaits]).reshape(-1, 1)
    labels = places(angle, ratio)[:, 0].tolist()
    return {label: gait for label, (*_, gait) in zip(labels, gaits, strict=True)}


def _nearest_miss(at: Polished, w: np.ndarray) -> str:
    """What is said of the first solution of a search that is no step; `w` (m + k, n)
    are all.
    """
    misses = np.flatnonzero(~at.step)
    if not len(misses):
        return "Nearest miss: none."

    angle = np.exp(w[0, misses[0]])
    where = f"Nearest miss: a solution at stance angle {angle:.6g} that"
    if at.doubt[misses[0]]:
        return f"{where} may be no step."

    return f"{where} is not a step: an event occurs too early."


def record(label: str, slope: float, gait: _Gait, walker: Walker) -> dict[str, Any]:
    """Return one gait as a plain dict; an absent quantity is None.

    Parameters
    ----------
    label : str
    slope : float [rad]
    gait : dict
        Its variables, as `describe` measures them; the angle at its heelstrike as `end`
        where that is not the one at its start.
    walker : Walker
    """
    plain = {k: _plain(v) for k, v in gait.items() if isinstance(v, np.generic)}
    pairs = np.stack([gait["multiplier_real"], gait["multiplier_imag"]], axis=-1)
    is_coarse = gait["status"] == status.LESS_ACCURATE
    angle = np.array([gait.get("end", gait["stance_angle"])])
    mass = walker.total_mass * contact_mass(walker, angle)[0]
    record = {
        **plain,
        "gait": label,
        "slope": slope,
        "multipliers": pairs.tolist(),
        "stable": bool(plain["spectral_radius"] < 1),
        "violations": _flags(gait.get("violations")),
        "status": "less_accurate" if is_coarse else "converged",
        "contact_mass_matrix": mass.tolist(),
    }
    return {name: record.get(name) for name in _columns(walker)}


def _columns(walker: Walker) -> list[str]:
    """Columns of a walker's gaits, without those of what it has not."""
    return [
        name
        for name in _COLUMNS
        if name not in VARIABLES or not VARIABLES[name].is_left_out(walker.features)
    ]


def _flags(bits: Any) -> list[str] | None:
    """Names of the violations whose bits are set."""
    if bits is None:
        return None
    return [name for i, name in enumerate(VIOLATIONS) if int(bits) >> i & 1]


def _plain(x: Any) -> Any:
    """A Python number, or None where a quantity is absent; a friction demand may be
    infinite.
    """
    x = x.item()
    return None if isinstance(x, float) and np.isnan(x) else x
