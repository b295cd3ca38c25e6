"""Whole random lines: every point settles, bounds hold, and special points are those of
the walker in other units.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.atlas import to_arrays
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS, is_located
from gaitsweep.tasks.branches.equations import Equations, solve
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.contract.registry import STATUSES
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.studies.solve_points import atlas, points
from gaitsweep.tasks.walkers.resolve import resolve, resolve_many
from gaitsweep.tasks.walkers.walker import KEYS, Walker, WalkerError
from soak.hunt import Input, hardest
from soak.missed import MAX_SLOPE, MIN_SLOPE, neighbour, survey_walkers

#: Slopes of a line, and the most of them beside folds and ends; the others lie
#: anywhere.
_SLOPES, _BESIDE = 40, 26
#: Powers of ten of the latter's relative distances, and the range in which they are
#: taken [rad].
_DISTANCES, _RANGE = (-12, -2), (1e-6, 0.69)
#: Interval of lines whose special points and some gaits are solved again in other
#: units, and these units.
_IN_OTHER_UNITS, _UNITS = 7, {"length": 0.3048, "mass": 7.3, "acceleration": 1.62}
#: By how much a walker's keys, rounded in other units, may move a slope or a gait,
#: relatively.
_ROUNDED = 1e-9
#: A special point farther than this from where Newton's method began, in ln slope, is
#: another one.
_ANOTHER = 1e-3
_WANT = ("stance_angle", "stance_rate", "period", "error_bound", "status", "reason")
_ANSWERS = [STATUSES["converged"], STATUSES["no_gait"]]


@dataclass
class WholeLines:
    """Outcomes of the points of random lines.

    Attributes
    ----------
    lines, points, beside : int
        Number of lines, of points (a line's slopes), and of those beside folds and
        ends.
    gaits, compared : int
        Gaits that were solved, and those that were solved again in extended precision.
    branches, lost : int
        Branches, and ends at which they could be continued no further or failed a
        check.
    special, confirmed : int
        Special points whose equations were solved in other units, and those to which
        Newton's method converged.
    farthest_error, farthest_special, farthest_gait : float
        Largest error over its bound; largest relative difference of the slope of a
        special point in other units, and of a gait.
    wrong : list of (str, Input)
        What is wrong, with the gait's command.
    """

    lines: int = 0
    points: int = 0
    beside: int = 0
    gaits: int = 0
    compared: int = 0
    branches: int = 0
    lost: int = 0
    special: int = 0
    confirmed: int = 0
    farthest_error: float = 0.0
    farthest_special: float = 0.0
    farthest_gait: float = 0.0
    wrong: list[tuple[str, Input]] = field(default_factory=list)

    def __str__(self) -> str:
        numbers = [
            f"{getattr(self, each.name):.3g} {each.name.replace('_', ' ')}"
            if each.type == "float"
            else f"{getattr(self, each.name):,} {each.name}"
            for each in fields(self)
            if each.name != "wrong"
        ]
        return f"{', '.join(numbers)}, {len(self.wrong)} wrong"


def whole_lines(
    seeds: Sequence[int], say: Callable[[str], None] | None = None
) -> WholeLines:
    """Solve the points of random lines, many of them beside folds and ends, and check
    them.
    """
    outcome = WholeLines()
    drawn: list[tuple[int, str, dict[str, float], Walker]] = []
    for seed in seeds:
        name, changes, _ = neighbour(seed)
        try:
            drawn.append((seed, name, changes, resolve(name, changes)))
        except WalkerError:
            continue
    for numbers, problem, surveyed in survey_walkers([walker for *_, walker in drawn]):
        for lane, (i, branches) in enumerate(zip(numbers, surveyed, strict=True)):
            seed, name, changes, walker = drawn[i]
            alone, random = problem.alone(lane), np.random.default_rng(seed)
            slope = _check_points(outcome, random, name, changes, alone, branches)
            if seed % _IN_OTHER_UNITS == 0:
                _check_in_other_units(
                    outcome,
                    name,
                    changes,
                    walker,
                    alone,
                    branches,
                    slope[: _SLOPES - _BESIDE],
                )
        if say:
            say(str(outcome))
    return outcome


def _check_points(
    outcome: WholeLines,
    random: np.random.Generator,
    name: str,
    changes: dict[str, float],
    problem: Problem,
    branches: list[Branch],
) -> np.ndarray:
    """Solve the points of a line as a study does, and the hardest of its gaits again;
    its slopes, (n,) [rad].
    """
    beside = list(_beside(branches, random))
    slope = np.append(
        np.exp(
            random.uniform(np.log(MIN_SLOPE), np.log(MAX_SLOPE), _SLOPES - len(beside))
        ),
        beside,
    )
    params = {"line": {"walker": name, "set": changes}, "slope": slope, "want": _WANT}
    out = points(params, [to_arrays(branches)])
    outcome.lines += 1
    outcome.points += len(slope)
    outcome.beside += len(beside)
    outcome.gaits += int((out["status"] == STATUSES["converged"]).sum())
    outcome.branches += len(branches)
    outcome.lost += sum(len(branch.lost()) for branch in branches)
    for i, g in np.argwhere(~np.isin(out["status"], _ANSWERS)).tolist():
        why = str(out["reasons"][out["reason"][i, g]])
        outcome.wrong.append(
            (why, Input(name, changes, float(slope[i]), np.nan, np.nan))
        )
    hunted = hardest(name, changes, problem, branches, slope)
    outcome.compared += hunted.compared
    outcome.wrong += hunted.wrong
    worst = hunted.worst["true error over bound"]
    outcome.farthest_error = max(
        outcome.farthest_error, *(one.value for one in worst), 0.0
    )
    return slope


def _beside(branches: list[Branch], random: np.random.Generator) -> Iterator[float]:
    """Slopes beside folds and ends of a line's branches, on either side [rad]."""
    places = [
        branch.q[at] for branch in branches for piece in branch.pieces() for at in piece
    ]
    for at in random.integers(len(places), size=_BESIDE) if places else ():
        slope = float(
            np.exp(places[at])
            * (1 + random.choice([-1, 1]) * 10 ** random.uniform(*_DISTANCES))
        )
        if _RANGE[0] < slope < _RANGE[1]:
            yield slope


def _in_other_units(walker: Walker) -> dict[str, Any]:
    """The table of the same walker, its lengths, masses and times in other units."""
    table = walker.table()
    table |= {
        key: value * _UNITS[KEYS[key]]
        for key, value in table.items()
        if KEYS.get(key) in _UNITS
    }
    return table


def _check_in_other_units(
    outcome: WholeLines,
    name: str,
    changes: dict[str, float],
    walker: Walker,
    problem: Problem,
    branches: list[Branch],
    slope: np.ndarray,
) -> None:
    """Solve gaits and special points of the same walker in other units: slopes and
    angles are the same, times scale.
    """
    table = _in_other_units(walker)
    other = Lanes(resolve_many(table, {"g": np.array([table["g"]])}))
    for branch in branches:
        for special in special_points(problem, branch):
            kind, at = str(special["kind"]), float(special["slope"])
            if not is_located(kind) or kind == "window":
                continue
            outcome.special += 1
            guess = _nearest(branch, np.log([special["stance_angle"], at]))
            equations = Equations(other, [CONDITIONS[kind]])
            solved = solve(equations, guess[:, None])
            off = abs(float(np.expm1(solved.Z[-1, 0] - np.log(at))))
            if not solved.ok[0] or off > _ANOTHER:
                continue
            outcome.confirmed += 1
            outcome.farthest_special = max(outcome.farthest_special, off)
            if off > special["error_bound"] + solved.error[0] + _ROUNDED:
                outcome.wrong.append(
                    (
                        kind,
                        Input(name, changes, at, float(special["stance_angle"]), off),
                    )
                )
    one, two = (
        points(
            {"line": line, "slope": slope, "want": _WANT},
            [atlas({"line": line, "coarse": True}, [])],
        )
        for line in ({"walker": name, "set": changes}, {"walker": table, "set": {}})
    )
    time_unit = np.sqrt(_UNITS["length"] / _UNITS["acceleration"])
    for i, g in np.argwhere((one["status"] == 0) | (two["status"] == 0)).tolist():
        a, b = (
            {key: float(value[i, g]) for key, value in out.items() if key != "reasons"}
            for out in (one, two)
        )
        off = max(
            abs(b["stance_angle"] / a["stance_angle"] - 1),
            abs(b["period"] / time_unit / a["period"] - 1),
            abs(b["stance_rate"] * time_unit / a["stance_rate"] - 1),
        )
        outcome.farthest_gait = max(outcome.farthest_gait, off)
        if not off <= a["error_bound"] + b["error_bound"] + _ROUNDED:
            outcome.wrong.append(
                (
                    "in other units",
                    Input(name, changes, float(slope[i]), a["stance_angle"], off),
                )
            )


def _nearest(branch: Branch, place: np.ndarray) -> np.ndarray:
    """Point of a branch's polynomials, or node of it, (c,), next to a place (ln angle,
    ln slope).
    """
    Z = np.hstack([branch.Z, *(Z for _, Z, _ in branch.guesses(place[1:]))])
    return np.asarray(Z[:, np.abs(Z[[0, -1]].T - place).max(axis=1).argmin()])
