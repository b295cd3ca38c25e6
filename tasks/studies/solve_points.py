"""The tasks `atlas`, every branch of a line, `points`, the gaits at its slopes, and
`lines`, both for several lines.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.refine import COARSE, FINE
from gaitsweep.tasks.branches.settling import settle_on_branches
from gaitsweep.tasks.branches.tracking import MAX_MULTIPLIER
from gaitsweep.tasks.charts.pieces import Piece, pieces_of
from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.kinds import kind_of
from gaitsweep.tasks.contract.registry import GAITS, PROVED, VARIABLES
from gaitsweep.tasks.gaits.polish import Guesses
from gaitsweep.tasks.gaits.step_check import LONG_BELOW
from gaitsweep.tasks.measures.gaits import (
    Arrays,
    Part,
    Wanted,
    nothing_solved,
    store,
    to_accuracy,
)
from gaitsweep.tasks.measures.sensitivities import differentiated
from gaitsweep.tasks.mechanics.kernel import is_compact
from gaitsweep.tasks.mechanics.lumped import Structure, alike
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.studies.chart_derivatives import ChartedDerivatives
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.studies.followed import followed_over
from gaitsweep.tasks.studies.interpolate import Interpolation
from gaitsweep.tasks.studies.request import Request
from gaitsweep.tasks.studies.solve_driven import (
    branches_of,
    driven,
    in_units,
)
from gaitsweep.tasks.studies.solve_driven import searched as searched_driven
from gaitsweep.tasks.studies.solve_guesses import Differentiate, blocks, solve_guesses
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.scaling import plain_line, scales, units
from gaitsweep.tasks.walkers.walker import Walker

#: Variables that a gait's proof is compared with, and the largest relative radius of
#: its box.
PROVED_FROM = (
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "shank_rate",
    "period",
    "kneestrike_time",
    "error_bound",
)
PROOF_ACCURACY = 1e-12
#: Branches of the latest lines by walker, tolerance and the code that computed them:
#: studies of one command often have lines in common. Nothing else decides them, so what
#: a process has computed before changes no bit.
_surveyed: OrderedDict[tuple[str, float, bool], list[Branch]] = OrderedDict()
_MAX_SURVEYED = 128
#: So are the latest points of lines that others differ from only in their units, which
#: chunks of one study have in common, up to a number of lines and of bytes.
_solved: OrderedDict[tuple[Any, ...], tuple[list[Branch], Arrays]] = OrderedDict()
_MAX_SOLVED, _MAX_BYTES = 16, 64 << 20


def atlas(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Compute every branch of one line's gaits.

    Parameters
    ----------
    params : mapping
        `line`: `{"walker": name or table, "set": {key: value}}`; `coarse`: whether for
        few points; `steps` after which the gaits repeat (1 if omitted); `along`, the
        key over which gaits are followed at the line's `slope`, if not over slopes;
        `level`, whether no slope leads down, so that none of its branches is asked for.
    inputs : list
        Empty.

    Returns
    -------
    dict
        The branches as arrays, which `tasks.branches.atlas.from_arrays` reads.
    """
    if params.get("level"):
        return atlases.to_arrays([])

    problem, _ = followed_over(params)
    steps = int(params.get("steps", 1))
    # Of gaits of one step, those of several take the flips and where they are searched
    # for, which are solved anew.
    tolerance = COARSE if params.get("coarse") or steps > 1 else FINE
    if "along" in params:
        single = atlases.survey(problem, tolerance)
    else:
        (single,) = survey([problem.walker], problem.structure, tolerance)

    branches = cycle_branches(problem, single, steps) if steps > 1 else single
    return atlases.to_arrays(branches)


def points(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Solve the gaits at the slopes of one line, each from the line's atlas alone.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad], or values of a key, `along`, that
        drives at the line's `slope`; `want`, names of variables; `gaits`, labels wanted;
        `violation_limits`, those of violations that are not the registry's; `steps`
        after which the gaits repeat; `accuracy`, the largest error bound wanted, 0 for
        as good a one as doubles give; `interpolated`, whether polynomials give the
        points where they reach it.
    inputs : list
        The line's atlas, of the same `steps`.

    Returns
    -------
    dict
        Each wanted variable in the walker's units, shape (n, len(GAITS)[,
        multipliers]), and `reasons`, the sentences that `reason` indexes.
    """
    branches = atlases.from_arrays(inputs[0])
    return solve_line(params["line"], branches, Request.of(params))


def solve_line(
    line: Mapping[str, Any],
    branches: list[Branch],
    request: Request,
) -> Arrays:
    """Solve the gaits of one line, whose branches are known.

    Parameters
    ----------
    line : mapping
    branches : list of Branch
        Its atlas.
    request : Request

    Returns
    -------
    dict
        As `points` has it.
    """
    walker = walker_of_line(line)
    if request.along:
        return _solve_along(line, branches, request)

    is_level = request.slope <= 0
    if is_level.any():
        return _on_any_ground(line, walker, branches, request, is_level)

    keys = scales(walker, line) if request.is_converted else ()
    if keys:
        plain = plain_line(line, keys)
        own = _solve_on(plain, branches, request)
        return _converted(own, walker, plain)

    return _solve_alone(Problem(walker, request.steps), line, branches, request)


def _solve_alone(
    problem: Problem,
    line: Mapping[str, Any],
    branches: list[Branch],
    request: Request,
) -> Arrays:
    """Gaits of one line at values of the drive of its problem, by polynomials where
    these are wanted.
    """
    polynomials = None
    if request.interpolated:
        polynomials = Interpolation(problem, branches, request.wanted, request.slope)
    charted = None
    if request.charted:
        names = request.wanted.names
        charted = ChartedDerivatives(problem, branches, names, request.slope)

    (solved,) = _solve_branches(
        problem, [line], [branches], request, polynomials, charted
    )
    return solved


def _solve_along(
    line: Mapping[str, Any], branches: list[Branch], request: Request
) -> Arrays:
    """Gaits of a line at values of a key that drives at its slope, on its branches over
    that; where the key does not drive, whatever else does.
    """
    along, values = {"along": request.along}, request.slope
    problem, unit = followed_over({"line": line, **along}, request.steps)
    drives = values > 0
    parts = []
    if drives.any():
        own = replace(request, slope=values[drives] / unit)
        solved = _solve_alone(problem, line, branches, own)
        parts.append((np.flatnonzero(drives), solved))

    slope = float(line["slope"])
    for place in np.flatnonzero(~drives):
        keys = {**(line.get("set") or {}), request.along: float(values[place])}
        other = {**line, "set": keys}
        solved = _solve_driven(other, walker_of_line(other), slope, request)
        parts.append((np.array([place]), solved))

    return _side_by_side(len(values), parts)


def _on_any_ground(
    line: Mapping[str, Any],
    walker: Walker,
    branches: list[Branch],
    request: Request,
    is_level: np.ndarray,
) -> Arrays:
    """Gaits of a line at slopes of which some are level, or lead uphill."""
    parts = []
    if not is_level.all():
        down = replace(request, slope=request.slope[~is_level])
        parts.append((np.flatnonzero(~is_level), solve_line(line, branches, down)))

    for place in np.flatnonzero(is_level):
        slope = float(request.slope[place])
        parts.append((np.array([place]), _solve_driven(line, walker, slope, request)))

    return _side_by_side(len(is_level), parts)


def _side_by_side(n: int, parts: Sequence[tuple[np.ndarray, Arrays]]) -> Arrays:
    """Points of a line, each part at some places, with the sentences of all."""
    _, first = parts[0]
    solved: Arrays = {}
    for name in first.keys() - {"reasons"}:
        own = first[name]
        solved[name] = np.empty((n, *own.shape[1:]), own.dtype)
        for places, part in parts:
            solved[name][places] = part[name]

    sentences: list[str] = []
    for places, part in parts:
        solved["reason"][places] += len(sentences)
        sentences += [str(each) for each in part["reasons"]]

    return {**solved, "reasons": np.array(sentences)}


def _solve_driven(
    line: Mapping[str, Any], walker: Walker, slope: float, request: Request
) -> Arrays:
    """Gaits of a line at one slope at which something else drives."""
    problem, drive = driven(walker, slope, request.steps)
    if not drive:
        return _undriven(walker, slope, request)

    here = replace(
        request,
        slope=np.array([drive]),
        interpolated=False,
        charted=False,
        along="",
    )
    (solved,) = _solve_branches(problem, [line], [branches_of(problem)], here)
    return solved


def _undriven(walker: Walker, slope: float, request: Request) -> Arrays:
    """No gait, of a walker that nothing drives."""
    solved = nothing_solved(request.wanted.names, 1, walker.knees)
    why = (
        f"No gait at slope {slope:g}: nothing drives the walker there, neither "
        "`push_off` nor a forward torque between the thighs of legs with mass."
    )
    return {**solved, "reasons": np.array(status.reasons(why, why))}


def lines(
    params: Mapping[str, Any], inputs: list[Arrays]
) -> list[tuple[Arrays, Arrays]]:
    """Compute the atlases of several lines side by side, for few points, and solve the
    gaits at their slopes.

    Parameters
    ----------
    params : mapping
        `lines`, the line of each; `level`, as `atlas` has it, of all, where no points
        are asked for; the others as `points` has them.
    inputs : list
        Empty.

    Returns
    -------
    list of (dict, dict)
        For each line what `atlas`, coarse, and `points` return; it does not depend on
        the other lines.
    """
    if params.get("level"):
        return [(atlases.to_arrays([]), {}) for _ in params["lines"]]
    solved = solve_lines(params["lines"], Request.of(params))
    return [(atlases.to_arrays(branches), one) for branches, one in solved]


def solve_lines(
    lines: Sequence[Mapping[str, Any]], request: Request
) -> list[tuple[list[Branch], Arrays]]:
    """Survey lines side by side, for few points, and solve their gaits.

    Parameters
    ----------
    lines : sequence of mapping
    request : Request

    Returns
    -------
    list of (list of Branch, dict)
        For each line its branches, and what `points` returns.
    """
    walkers = [walker_of_line(line) for line in lines]
    if request.along:
        return _lines_along(lines, request)
    if (request.slope <= 0).any():
        return _lines_on_any_ground(lines, request)
    if request.is_converted:
        keys = [scales(*each) for each in zip(walkers, lines, strict=True)]
        if any(keys):
            return _solve_scaled(walkers, lines, keys, request)

    results: list[tuple[list[Branch], Arrays]] = [([], {})] * len(walkers)
    for structure, numbers in alike(walkers).items():
        some = [walkers[i] for i in numbers]
        surveyed = survey(some, structure, COARSE)
        solved = _solve_branches(
            Lanes(some, structure), [lines[i] for i in numbers], surveyed, request
        )
        for i, branches, one in zip(numbers, surveyed, solved, strict=True):
            results[i] = branches, one

    return results


def _lines_along(
    lines: Sequence[Mapping[str, Any]], request: Request
) -> list[tuple[list[Branch], Arrays]]:
    """Survey lines over a key that drives at their slopes, and solve their gaits."""
    alike: dict[Any, list[int]] = {}
    walkers = []
    for i, line in enumerate(lines):
        problem, _ = followed_over({"line": line, "along": request.along})
        # Where gaits are searched for must not depend on the other lines.
        anchors = atlases.driven_anchors(problem.drive, problem.walker)
        kind = problem.structure, problem.drive, anchors
        alike.setdefault(kind, []).append(i)
        walkers.append(problem.walker)

    atlas: list[list[Branch]] = [[] for _ in lines]
    # Of no values their atlas alone is asked for.
    if len(request.slope) and not (request.slope > 0).any():
        alike.clear()
    for (structure, drive, _), numbers in alike.items():
        some = Lanes([walkers[i] for i in numbers], structure, drive)
        surveyed = atlases.survey_lines(some, COARSE)
        for i, branches in zip(numbers, surveyed, strict=True):
            atlas[i] = branches

    return [
        (branches, solve_line(line, branches, request))
        for line, branches in zip(lines, atlas, strict=True)
    ]


def _lines_on_any_ground(
    lines: Sequence[Mapping[str, Any]], request: Request
) -> list[tuple[list[Branch], Arrays]]:
    """Survey and solve lines at slopes of which some are level, or lead uphill."""
    down = replace(request, slope=request.slope[request.slope > 0])
    atlas: list[list[Branch]] = [[] for _ in lines]
    if len(down.slope):
        atlas = [branches for branches, _ in solve_lines(lines, down)]

    return [
        (branches, solve_line(line, branches, request))
        for line, branches in zip(lines, atlas, strict=True)
    ]


def _solve_scaled(
    walkers: Sequence[Walker],
    lines: Sequence[Mapping[str, Any]],
    keys: Sequence[tuple[str, ...]],
    request: Request,
) -> list[tuple[list[Branch], Arrays]]:
    """Solve lines of which some set keys that change only units: those without these
    keys, each once, whose gaits are converted.
    """
    plain: dict[str, Mapping[str, Any]] = {}
    names = []
    for line, own in zip(lines, keys, strict=True):
        without = plain_line(line, own) if own else line
        names.append(repr(without))
        plain.setdefault(names[-1], without)

    by_name = _solve_plain(plain, request)
    solved = []
    for walker, name, own in zip(walkers, names, keys, strict=True):
        branches, points = by_name[name]
        if own:
            points = _converted(points, walker, plain[name])
        solved.append((branches, points))

    return solved


def _solve_plain(
    lines: Mapping[str, Mapping[str, Any]], request: Request
) -> dict[str, tuple[list[Branch], Arrays]]:
    """Solve lines by name, reusing those solved before."""
    keys = {name: (name, is_compact(), *request.key) for name in lines}
    new = [name for name, key in keys.items() if key not in _solved]
    found = {}
    if new:
        solved = solve_lines([lines[name] for name in new], request)
        found = dict(zip(new, solved, strict=True))

    for name, key in keys.items():
        if name not in found:
            found[name] = _solved[key]
        _solved[key] = found[name]

    _forget()
    return found


def _solve_on(
    line: Mapping[str, Any], branches: list[Branch], request: Request
) -> Arrays:
    """Solve a line whose branches are known, reusing it if it was solved on them before."""
    atlas = tuple(branch.Z.tobytes() for branch in branches)
    key = (repr(line), atlas, is_compact(), *request.key)
    if key not in _solved:
        _solved[key] = branches, solve_line(line, branches, request)
    _, points = _solved[key]
    _forget()
    return points


def _forget() -> None:
    """Forget the points that were solved first, where there are many."""
    sizes = [
        sum(values.nbytes for values in points.values())
        for _, points in _solved.values()
    ]
    total = sum(sizes)
    for size in sizes:
        if len(_solved) <= _MAX_SOLVED and total <= _MAX_BYTES:
            break
        _solved.popitem(last=False)
        total -= size


def _converted(points: Arrays, walker: Walker, line: Mapping[str, Any]) -> Arrays:
    """Points of a line in the units of a walker that differs from its own in these."""
    own = walker_of_line(line)
    words, in_own_time = atlases.searched_in(own, [own.time_unit, walker.time_unit])
    sentences = [str(each).replace(words, in_own_time) for each in points["reasons"]]
    return {**in_units_of(walker, points, own), "reasons": np.array(sentences)}


def in_units_of(walker: Walker, points: Arrays, own: Walker) -> Arrays:
    """Return points in the units of a walker that differs from their own in these.

    Parameters
    ----------
    walker : Walker or WalkerArray
    points : dict of ndarray
        In the units of `own`; of several walkers, along the first dimension.
    own : Walker or WalkerArray
    """
    ratios = [a / b for a, b in zip(units(walker), units(own), strict=True)]
    converted = dict(points)
    for name, values in points.items():
        if name in VARIABLES and values.dtype == float:
            unit = np.asarray(VARIABLES[name].unit(*ratios))
            after = (1,) * (values.ndim - 1) if unit.ndim else ()
            converted[name] = values * unit.reshape(unit.shape + after)

    return converted


def search_words(params: Mapping[str, Any]) -> list[str]:
    """Say what a status says of the survey of a line, for walkers that differ from the
    line's by their units of time.

    Parameters
    ----------
    params : mapping
        `line`, and `time_units`, those of the walkers.

    Returns
    -------
    list of str
        For the line's own walker, then for each of the others.
    """
    walker = walker_of_line(params["line"])
    return atlases.searched_in(walker, [walker.time_unit, *params["time_units"]])


def survey(
    walkers: Sequence[Walker],
    structure: Structure,
    tolerance: float,
) -> list[list[Branch]]:
    """Return the branches of lines of one structure, reused for lines surveyed before.

    Parameters
    ----------
    walkers : sequence of Walker
    structure : Structure
        Theirs.
    tolerance : float
        `COARSE` or `FINE`.
    """
    keys = [(repr(walker), tolerance, is_compact()) for walker in walkers]
    new = [i for i, key in enumerate(keys) if key not in _surveyed]
    if new:
        problem = Lanes([walkers[i] for i in new], structure)
        for i, branches in zip(
            new, atlases.survey_lines(problem, tolerance), strict=True
        ):
            _surveyed[keys[i]] = branches

    results = [_surveyed[key] for key in keys]
    while len(_surveyed) > _MAX_SURVEYED:
        _surveyed.popitem(last=False)
    return results


def _solve_branches(
    problem: Problem,
    lines: Sequence[Mapping[str, Any]],
    atlas: Sequence[list[Branch]],
    request: Request,
    polynomials: Interpolation | None = None,
    charted: ChartedDerivatives | None = None,
) -> list[Arrays]:
    """Solve the gaits of several lines of one structure; `problem` has a lane for each.

    With `polynomials`, of a single line, only gaits that these do not give are
    integrated; with `charted`, of a single line too, so are derivatives.
    """
    n = len(request.slope)
    wanted = request.wanted
    names = _without_proofs(wanted.names)
    void = dict.fromkeys((*names, *wanted.names))
    results = [nothing_solved([*void], n, problem.walker.knees) for _ in lines]

    asked = replace(request, wanted=replace(wanted, names=names))
    for some in blocks(n, polynomials is not None):
        block = replace(asked, slope=request.slope[some])
        parts = _solve_block(problem, atlas, block, polynomials, charted)
        for out, of_line in zip(results, parts, strict=True):
            store({name: out[name][some] for name in names}, of_line, wanted.labels)

    if len(names) < len(void):
        for line, out in zip(lines, results, strict=True):
            _prove(out, line, problem, request)

    return [
        _answer(problem.alone(i), branches, wanted, out)
        for i, (branches, out) in enumerate(zip(atlas, results, strict=True))
    ]


def _answer(
    problem: Problem,
    branches: list[Branch],
    wanted: Wanted,
    out: Arrays,
) -> Arrays:
    """What is wanted of a line's gaits, to the accuracy wanted, and the sentences that
    `reason` indexes.
    """
    answer = {name: out[name] for name in wanted.names}
    for some in blocks(len(out["status"]), is_interpolated=False):
        block = {name: values[some] for name, values in answer.items()}
        to_accuracy(block, wanted.accuracy)
    return answer | {"reasons": np.array(_reasons(problem, branches))}


def _without_proofs(names: Sequence[str]) -> Sequence[str]:
    """Those of some variables that are solved, and those that proofs need, in the
    archive's order.
    """
    solved = {name for name in names if VARIABLES[name].group != "proofs"}
    if len(solved) < len(names):
        solved.update(PROVED_FROM)
    return [name for name in VARIABLES if name in solved]


def _solve_block(
    problem: Problem,
    atlas: Sequence[list[Branch]],
    request: Request,
    polynomials: Interpolation | None,
    charted: ChartedDerivatives | None,
) -> list[list[Part]]:
    """Gaits of several lines, of each its parts: those of the polynomials, and those
    that are integrated.
    """
    given: list[Part] = []
    integrated = None
    if polynomials:
        given, integrated = polynomials.parts(request.slope)
    parts = [[*given] for _ in atlas]

    guessed: list[_Guessed] = []
    for i, branches in enumerate(atlas):
        guessed += _guessed(i, branches, request, integrated)
    if not guessed:
        return parts

    lines = np.concatenate([guess.lines for guess in guessed])
    alone = {guess.line: problem.alone(guess.line) for guess in guessed}
    places = [(alone[guess.line], *guess.place) for guess in guessed]
    settle = partial(
        settle_on_branches, places=places, accuracy=request.wanted.accuracy
    )
    solved = solve_guesses(
        problem.some(lines),
        [guess.guesses for guess in guessed],
        settle,
        request.wanted,
        [(walker, int((lines == i).sum())) for i, walker in alone.items()],
        _differentiating(charted, guessed),
    )
    for k, guess in enumerate(guessed):
        part = solved.part(k, guess.index, guess.numbers, guess.ratio)
        parts[guess.line].append(part)

    return parts


def _differentiating(
    charted: ChartedDerivatives | None, guessed: Sequence[_Guessed]
) -> Differentiate:
    """What differentiates gaits by guesses."""
    if charted is None:
        return differentiated
    return charted.of([(guess.piece, len(guess.index)) for guess in guessed])


def _reasons(problem: Problem, branches: list[Branch]) -> list[str]:
    """Sentences that `reason` indexes, of one line."""
    if problem.steps > 1:
        outside = _outside(problem, branches)
        return status.reasons(outside, outside)

    lost = sorted(slope for branch in branches for slope in branch.lost())
    lost = [at * problem.drive.unit(problem.walker) for at in lost]
    if problem.drive.base is None:
        searched = f"searched from {atlases.searched(problem.walker)}"
        pieces = [list(spans(branches, label)) for label in GAITS[:2]]
    else:
        searched = searched_driven(problem)
        pieces = [in_units(problem, [*spans(branches, label)]) for label in GAITS[:2]]

    long, short = (
        status.outside(label, of_label, searched, lost, problem.drive.key)
        for label, of_label in zip(GAITS[:2], pieces, strict=True)
    )
    return status.reasons(long, short)


def _outside(problem: Problem, branches: list[Branch]) -> str:
    """Why no branch has a gait of so many steps at some value of the drive."""
    n, drive = problem.steps, problem.drive.key
    if not branches:
        return f"No gait of period {n} found: no flip of fewer steps begins one."
    reached = [(np.exp(b.q.min()), np.exp(b.q.max())) for b in branches]
    spans = status.ranges(in_units(problem, reached))
    limit = f"followed up to multipliers of {MAX_MULTIPLIER:g}"
    return f"No gait of period {n} at this {drive}: the branches found span {spans} ({limit})."


def _prove(
    out: Arrays,
    line: Mapping[str, Any],
    problem: Problem,
    request: Request,
) -> None:
    """Prove every converged gait of `out`, rows (n, len(GAITS)); each takes a second or
    so.
    """
    from gaitsweep.tasks.proofs.records import prove_stored  # needs the extra `proof`

    slope = problem.slopes(request.slope)
    for i, g in np.argwhere(np.isin(out["status"], status.SOLVED)).tolist():
        keys = {**(line.get("set") or {})}
        if request.along:
            walker, _ = problem.drive.at(problem.walker, float(request.slope[i]))
            keys[request.along] = getattr(walker, request.along)

        asked = {
            "walker": line["walker"],
            "set": keys,
            "slope": float(slope[i]),
            "gait": GAITS[g],
        }
        values = {name: float(out[name][i, g]) for name in PROVED_FROM}
        proof = prove_stored({**asked, "accuracy": PROOF_ACCURACY, "values": values})
        if "proved" in out:
            out["proved"][i, g] = PROVED["proved" if proof["proved"] else "not_proved"]
        if "proved_radius" in out and proof["proved"]:
            out["proved_radius"][i, g] = proof["radius"]


@dataclass(frozen=True)
class _Guessed:
    """Guesses on one piece of a branch of a line: indices of their slopes, and their
    segments.
    """

    line: int
    piece: Piece
    index: np.ndarray
    segment: np.ndarray
    guesses: Guesses

    @property
    def numbers(self) -> tuple[int, int]:
        """Those of the branch and of the piece."""
        return self.piece.number, self.piece.place

    @property
    def lines(self) -> np.ndarray:
        """The number of the line of each."""
        return np.full(len(self.index), self.line)

    @property
    def place(self) -> tuple[Branch, np.ndarray]:
        """Their branch, and their segments."""
        return self.piece.branch, self.segment

    @property
    def ratio(self) -> np.ndarray:
        """Rate ratios that the branch has there."""
        return self.piece.branch.ratio_on(self.segment)


def _guessed(
    line: int,
    branches: list[Branch],
    request: Request,
    integrated: Mapping[tuple[int, int], np.ndarray] | None,
) -> Iterator[_Guessed]:
    """Guesses of a line's gaits that may have a wanted label, or of those that are to
    be integrated.
    """
    q = np.log(request.slope)
    for piece in pieces_of(branches):
        index = piece.covered(q)
        if integrated is not None:
            index = integrated[piece.number, piece.first]
        if not len(index):
            continue

        Z, segment = piece.branch.on_piece(piece.first, piece.last, q[index])
        keep = _may_hold(piece.branch, segment, request.wanted.labels)
        if keep.any():
            index = index[keep]
            segment = segment[keep]
            slope = request.slope[index]
            guesses = piece.branch.known_guesses(Z[:, keep], segment, slope)
            yield _Guessed(line, piece, index, segment, guesses)


def spans(branches: list[Branch], label: str) -> Iterator[tuple[float, float]]:
    """Least and largest slope of each run of the gaits of branches with one label
    [rad].
    """
    for piece in pieces_of(branches):
        branch = piece.branch
        nodes = np.arange(piece.first, piece.last + 1)
        is_long = _ratios(branch) < LONG_BELOW
        has_label = (is_long == (label == "long")) & (branch.leg_passes == 1)
        for run in np.split(nodes, np.nonzero(np.diff(has_label[nodes]))[0] + 1):
            if has_label[run[0]]:
                slopes = np.exp(branch.q[run])
                yield float(slopes.min()), float(slopes.max())


def _ratios(branch: Branch) -> np.ndarray:
    """Ratios of the nodes of a branch, (n,): at an end where labels have no meaning, that
    of the node beside it.
    """
    ratio = branch.ratio.copy()
    for end, beside, why in zip((0, -1), (1, -2), branch.why, strict=True):
        if not kind_of(why).defines("label") and len(ratio) > 1:
            ratio[end] = ratio[beside]
    return ratio


def _may_hold(
    branch: Branch,
    segment: np.ndarray,
    wanted: set[str],
) -> np.ndarray:
    """Whether segments may hold a wanted gait, shape (n,).

    The label `long` does not depend on short gaits, nor `short` on long ones; all other
    labels may depend on either. Where heelstrike is tangential a node has no ratio, and
    its segments may hold any gait.
    """
    if wanted & set(GAITS[2:]):
        return np.ones(len(segment), bool)
    low = np.minimum(branch.ratio[segment], branch.ratio[segment + 1])
    high = np.maximum(branch.ratio[segment], branch.ratio[segment + 1])
    return (~(low > 0.6) & ("long" in wanted)) | (~(high < 0.4) & ("short" in wanted))
