"""What a study of kind `optimum` asks of a line, as a nonlinear programme; and gaits at
which its iterations may begin.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray
from scipy.stats import qmc

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.equations import Equations, Keys
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.contract.registry import VARIABLES, VIOLATIONS
from gaitsweep.tasks.gaits.step_check import LONG_BELOW
from gaitsweep.tasks.measures.levels import Measures, level
from gaitsweep.tasks.measures.names import measures
from gaitsweep.tasks.measures.onsets import limited_amounts, over_size
from gaitsweep.tasks.measures.programme import (
    STABLE,
    Constraint,
    Objective,
    Programme,
    walking,
)
from gaitsweep.tasks.mechanics.arrays import Coordinates
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.studies.gaits_over_key import gaits_at
from gaitsweep.tasks.walkers.resolve import resolve_many, value_of_key, walkers_over
from gaitsweep.tasks.walkers.walker import ORDINARY, Walker
from gaitsweep.tasks.walkers.walker_array import WalkerArray

SLOPE = "slope"
_RADIUS, _RATIO = "spectral_radius", "heelstrike_rate_ratio"
#: What is told of every optimum beside its objective and what limits it.
_TOLD = (
    *("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period"),
    *("speed", "froude_speed", "cost_of_transport", _RADIUS),
)


@dataclass(frozen=True)
class Box:
    """Keys that are free, with their ranges, of a line's walker.

    Attributes
    ----------
    line : mapping
    free : dict of (float, float)
    """

    line: Mapping[str, Any]
    free: Mapping[str, tuple[float, float]]

    def walker_at(self, *values: float) -> Walker:
        """The walker at values of the keys."""
        return walkers_over(self.line, *self.free)(*values)

    def walkers_at(self, values: ndarray) -> WalkerArray:
        """The walkers at values of the keys (k, n)."""
        own = self.line.get("set") or {}
        of_keys = dict(zip(self.free, values, strict=True))
        return resolve_many(self.line["walker"], {**own, **of_keys})

    @property
    def keys(self) -> Keys:
        """The keys as unknowns."""
        low, high = self._ends
        ordinary = low + ORDINARY * (high - low)
        return Keys(
            tuple(self.free),
            self.walker_at,
            tuple(low.tolist()),
            tuple(high.tolist()),
            tuple(ordinary.tolist()),
            walkers_at=self.walkers_at,
        )

    @property
    def _ends(self) -> ndarray:
        """Least and largest values of the keys, shape (2, k)."""
        return np.array(list(self.free.values())).T

    def designs(self, count: int) -> ndarray:
        """Values of keys (k, n) that sample the box evenly; those of the walker first
        where they lie in it.
        """
        low, high = self._ends
        shares = qmc.Halton(len(low), seed=0).random(count)
        values = low + shares * (high - low)
        own = np.array([value_of_key(self.line, key) for key in self.free])
        if ((low < own) & (own < high)).all():
            values[0] = own
        return values.T


@dataclass(frozen=True)
class Question:
    """What is asked of one line.

    Attributes
    ----------
    box : Box
    slopes : ndarray, shape (n,) [rad]
        The ends of their window, or one slope.
    options : mapping
    labels : sequence of str
        Gaits that are wanted.
    """

    box: Box
    slopes: ndarray
    options: Mapping[str, Any]
    labels: Sequence[str]

    @property
    def name(self) -> str:
        """What is least or largest."""
        return str(self.options["minimise"] or self.options["maximise"])

    @property
    def fixed(self) -> float | None:
        """The slope, where there is one."""
        return float(self.slopes[0]) if self.window is None else None

    @property
    def window(self) -> tuple[float, float] | None:
        """Ends of the slopes, where there are several."""
        low, high = float(self.slopes.min()), float(self.slopes.max())
        return None if low == high else (low, high)

    @property
    def nothing_found(self) -> str:
        """The beginning of a sentence that there is no optimum."""
        kind = "stable gait" if self.options["stable"] else "gait"
        return f"No {kind} within the ranges and limits was found"

    @property
    def cases(self) -> list[dict[str, float]]:
        """Values that a measure has, of each point of a trade-off."""
        if not self.options["tradeoff"]:
            return [{}]
        ((measure, values),) = self.options["tradeoff"].items()
        return [{measure: float(value)} for value in values]

    @property
    def told(self) -> list[str]:
        """Measures that are told of an optimum."""
        walker = self.box.walker_at(*self.box.keys.ordinary)
        known = {*measures(walker)}
        named = (self.name, *self.options["within"], *self.options["tradeoff"])
        every = dict.fromkeys((*_TOLD, *named, *self._amounts))
        return [name for name in every if name in known]

    @property
    def _amounts(self) -> list[str]:
        """Amounts of the violations that are ruled out."""
        names = self.options["without"]
        ruled_out = VIOLATIONS if "all" in names else names
        return [amount for name in ruled_out for amount in VIOLATIONS[name].amounts]

    def asked_by(self, constraint: Constraint) -> Constraint | None:
        """Return what a constraint of a programme asks of a measure; None where it is an
        end of walking.
        """
        if constraint in STABLE:
            return Constraint(_RADIUS, level(_RADIUS, 1.0).value, 1.0, -1)
        if constraint.name == "label":
            ratio = level(_RATIO, LONG_BELOW)
            return Constraint(_RATIO, ratio.value, LONG_BELOW, constraint.side)
        return constraint if constraint.name in VARIABLES else None

    def unit_of(self, name: str) -> str:
        """Return in what a constraint's values are counted, in words; empty for those in
        the walker's units.
        """
        has_units = VARIABLES[name].unit(2.0, 3.0, 5.0) != 1
        of_size = " in units of leg, mass and g"
        return of_size if name in self._amounts and has_units else ""

    def programme(self, case: Mapping[str, float]) -> Programme:
        """The nonlinear programme, with values that measures have."""
        keys = self.box.keys
        walker = keys.walker_at(*keys.ordinary)
        taken = Measures(self._taken(walker))
        constraints = [*walking(walker.knees), *self._of_labels()]
        constraints += STABLE if self.options["stable"] else ()
        constraints += self._of_measures(taken, case)
        constraints += self._of_violations(taken, walker)
        objective = self._objective(taken)
        equations = Equations(keys, [], self.fixed)
        # The largest magnitude has a kink where two multipliers share it.
        is_smooth = all(
            VARIABLES[name].is_smooth and name != _RADIUS for name in taken.names
        )
        return Programme(equations, objective, constraints, self.window, is_smooth)

    def _taken(self, walker: Walker) -> list[str]:
        """Measures on which objective and constraints depend."""
        named = (self.name, *self.options["within"], *self.options["tradeoff"])
        known = measures(walker)
        return [name for name in (*named, *self._amounts) if name in known]

    def _objective(self, taken: Measures) -> Objective:
        sign = -1 if self.options["maximise"] else 1
        unknowns = [SLOPE, *self.box.free]
        if self.name in unknowns:
            place = unknowns.index(self.name) - len(unknowns)
            return Objective(self.name, None, place, sign)
        return Objective(self.name, taken.scalar(self.name), sign=sign)

    def _of_labels(self) -> Iterator[Constraint]:
        """What makes gaits long, or short, where only those are wanted."""
        label = CONDITIONS["label"]
        is_long = "long" in self.labels
        is_short = "short" in self.labels
        if is_long != is_short:
            side = -1 if is_long else 1
            yield Constraint("label", label.value, float(label.target), side)

    def _of_measures(
        self, taken: Measures, case: Mapping[str, float]
    ) -> Iterator[Constraint]:
        ranges = {name: (value, value) for name, value in case.items()}
        for name, (low, high) in {**self.options["within"], **ranges}.items():
            scalar = taken.scalar(name)
            size = max(abs(low), abs(high)) or 1.0
            if low == high:
                yield Constraint(name, scalar, low, 0, size)
            else:
                yield Constraint(name, scalar, low, 1, size)
                yield Constraint(name, scalar, high, -1, size)

    def _of_violations(self, taken: Measures, walker: Walker) -> Iterator[Constraint]:
        """What keeps the amounts of violations within their limits."""
        limits = self.options["violation_limits"]
        for amount, limit, side in limited_amounts(VIOLATIONS, walker, limits):
            if amount in self._amounts:
                scalar = over_size(taken.scalar(amount), amount)
                yield Constraint(amount, scalar, limit, side)


def candidates(question: Question) -> list[Coordinates]:
    """Gaits X (u, n) of each start's walker in the window, in which there are some."""
    keys = question.box.keys
    designs = question.box.designs(int(question.options["starts"]))
    walkers = [question.box.walker_at(*values) for values in designs.T.tolist()]
    found = []
    for values, gaits in zip(designs.T, _gaits_of(question, walkers), strict=True):
        count = sum(Z.shape[1] for Z in gaits)
        if count:
            own = np.repeat((values / keys.scale)[:, None], count, axis=1)
            found.append(np.vstack([np.hstack(gaits), own]))

    return found


def _gaits_of(
    question: Question, walkers: Sequence[Walker]
) -> Iterator[list[Coordinates]]:
    """Gaits of each walker, as `_in_window` has them; on level ground and uphill those
    of what drives there.
    """
    if question.fixed is not None and question.fixed <= 0:
        for walker in walkers:
            yield [w[:, None] for w in gaits_at(walker, question.fixed)]
        return

    lanes = Lanes(walkers, question.box.keys.structure)
    for branches in atlases.survey_lines(lanes, COARSE):
        yield [_in_window(question, branch) for branch in branches]


def _in_window(question: Question, branch: Branch) -> Coordinates:
    """Gaits of a branch in the window of slopes: Z (c, n), or w at the only slope."""
    if question.window is not None:
        low, high = np.log(question.window)
        return branch.Z[:, (low <= branch.q) & (branch.q <= high)]
    w = [np.empty((len(branch.Z) - 1, 0))]
    for _, Z, _ in branch.guesses(np.log(question.slopes[:1])):
        w.append(Z[:-1])
    return np.hstack(w)
