"""Quantities of gaits that are smooth along a branch, and the variables that follow
from them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.variables import VARIABLES
from gaitsweep.tasks.gaits.multipliers import characteristic_errors
from gaitsweep.tasks.measures.gaits import (
    Arrays,
    measured_multipliers,
    of_travel,
    without_features,
)
from gaitsweep.tasks.measures.kinematics import TRAVEL, step_length
from gaitsweep.tasks.measures.losses import velocity_ratio
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.walker import Walker

#: Rates at the start of a step, work that drives a walker beside gravity, energies of a
#: step, and the cost that follows from the work.
_RATES = ("stance_rate", "thigh_rate", "shank_rate")
_WORK = ("push_off_work", "hip_torque_work")
_ENERGIES = ("loss_normal", "loss_tangential", "loss_kneestrike", *_WORK)
_COST = "cost_of_transport"
_RATIO = "heelstrike_rate_ratio"
#: What is interpolated by its logarithm.
_LOGARITHMS = ("stance_angle", "period")
_MULTIPLIERS = tuple(v.name for v in VARIABLES.values() if v.group == "multipliers")


@dataclass(frozen=True)
class Smooth:
    """The smooth quantities of gaits, from which the variables `want` follow.

    `names` are those that are interpolated: `stance_angle` and `period` by their
    logarithms, rates over the angle, the time of kneestrike over the period, energies
    over what a step is about supplied with, and the entries of the step map's
    derivative by their numbers. The gaits are of the walkers of a `problem`.
    """

    problem: Problem
    want: Sequence[str]
    names: tuple[str, ...]

    @classmethod
    def of(cls, problem: Problem, want: Sequence[str]) -> Smooth:
        """Choose the quantities for some variables.

        Parameters
        ----------
        problem : Problem
            Of one walker, or of one for each gait.
        want : sequence of str
        """
        rates = _RATES if problem.walker.knees else _RATES[:2]
        needed = {*want}
        if _COST in needed:
            needed.update(_WORK)
        optional = [
            name
            for name in (*_ENERGIES, "kneestrike_time")
            if name in needed and VARIABLES[name].only_of in ("", *problem.features)
        ]
        entries = []
        if set(want) & set(_MULTIPLIERS):
            m = problem.step.m
            entries = [f"{i}{j}" for i, j in itertools.product(range(m), repeat=2)]

        smooth = ("stance_angle", *rates, "period", _RATIO, *optional, *entries)
        return cls(problem, want, smooth)

    @property
    def entries(self) -> list[str]:
        """Names of the entries of the step map's derivative, row by row."""
        return [name for name in self.names if name.isdigit()]

    def columns(
        self, drive: np.ndarray, solved: Mapping[str, np.ndarray], jacobian: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Quantities of gaits, and the sizes over which their errors count.

        Parameters
        ----------
        drive : ndarray, shape (n,)
            Slopes [rad], or values of what else drives the problem.
        solved : mapping
            Their variables, shape (n,), as `describe` gives them.
        jacobian : ndarray, shape (m, m, n)
            Derivatives of the step map.

        Returns
        -------
        values, size : ndarray, shape (len(names), n)
        """
        walker, slope = self._walkers(drive)
        values = {name: np.log(solved[name]) for name in _LOGARITHMS}
        for name, (factor, divisor) in _factors(walker, slope, solved).items():
            if name in self.names:
                values[name] = solved[name] * factor / divisor

        values |= {name: jacobian[int(name[0]), int(name[1])] for name in self.entries}
        fastest = (
            np.max([np.abs(solved[name]) for name in _RATES], axis=0)
            * walker.time_unit
            / solved["stance_angle"]
        )
        sizes = dict.fromkeys(_RATES, fastest) | {
            _RATIO: np.maximum(1.0, np.abs(values[_RATIO]))
        }
        sizes |= dict.fromkeys(
            self.entries, np.maximum(1.0, np.abs(jacobian).max(axis=(0, 1)))
        )
        one = np.ones(len(drive))

        return np.stack([values[name] for name in self.names]), np.stack(
            [sizes.get(name, one) for name in self.names]
        )

    @property
    def needed(self) -> list[int]:
        """Columns from which the variables follow."""
        want = self.want
        names = {name for name in self.names if name in want or name.isdigit()} | {
            "stance_angle"
        }
        if "shank_rate" in want and not self._knees:
            names.add("thigh_rate")
        if "velocity_ratio" in want:
            names.add(_RATIO)
        if {"kneestrike_time", *TRAVEL} & set(
            want
        ):  # a kneestrike's time is a share of the period
            names.add("period")

        if _COST in want:
            names.update(name for name in _WORK if name in self.names)
        return [k for k, name in enumerate(self.names) if name in names]

    def multipliers(self, columns: Mapping[str, np.ndarray], error: float) -> Arrays:
        """Variables of the group `multipliers`.

        Parameters
        ----------
        columns : mapping
            The entries of the step map's derivative, shape (n,).
        error : float
            Bound of the errors of quantities, each over its size.

        Returns
        -------
        dict of ndarray, shape (n[, multipliers])
        """
        m = math.isqrt(len(self.entries))
        jacobian = np.stack([columns[name] for name in self.entries]).reshape(m, m, -1)
        size = np.maximum(1.0, np.abs(jacobian).max(axis=(0, 1)))

        return measured_multipliers(
            jacobian,
            0.0,
            characteristic_errors(jacobian, m * error * size),
            self._knees,
        )

    def gaits(
        self,
        drive: np.ndarray,
        columns: Mapping[str, np.ndarray],
        error: float,
        numbers: Any,
    ) -> Arrays:
        """Variables of gaits that were not integrated.

        Parameters
        ----------
        drive : ndarray, shape (n,)
            As for `columns`.
        columns : mapping
            By name the quantities that `needed` names, and `multipliers` where they are
            wanted, shape (n,).
        error : float
            Their error bound.
        numbers : pair of ndarray of int, shape (n,), or of int
            Those of their branches and pieces.

        Returns
        -------
        dict of ndarray, shape (n[, multipliers])
            In the walker's units.
        """
        n = len(drive)
        known = {
            "status": status.CONVERGED,
            "reason": status.SETTLED,
            "error_bound": error,
        }
        known |= dict(zip(("branch", "piece"), numbers, strict=True))
        solved = {name: np.broadcast_to(value, n) for name, value in known.items()}
        solved |= {name: columns[name] for name in self.want if name in _MULTIPLIERS}

        return (
            self._variables(drive, columns)
            | without_features(self.want, self.problem.features, n)
            | solved
        )

    @property
    def _knees(self) -> bool:
        return self.problem.walker.knees

    def _walkers(self, drive: np.ndarray) -> tuple[Walker, np.ndarray]:
        """The walkers that values of the drive (n,) make, and their slopes [rad]."""
        return self.problem.walkers_at(drive), self.problem.slopes(drive)

    def _variables(
        self, drive: np.ndarray, columns: Mapping[str, np.ndarray]
    ) -> Arrays:
        """Variables (n,) that follow from quantities, but for multipliers."""
        walker, slope = self._walkers(drive)
        known: dict[str, np.ndarray] = {
            k: np.exp(columns[k]) for k in _LOGARITHMS if k in columns
        }
        for name, (factor, divisor) in _factors(walker, slope, known).items():
            if name in columns:
                known[name] = columns[name] * divisor / factor

        if "thigh_rate" in known and not walker.knees:
            known["shank_rate"] = known["thigh_rate"]
        known["step_length"] = step_length(walker, known["stance_angle"])
        if _RATIO in known:
            known["velocity_ratio"] = velocity_ratio(
                walker, known["stance_angle"], known[_RATIO]
            )

        if "period" in known:
            known |= of_travel(walker, slope, known, steps=1)
        return known


def _factors(
    walker: Walker, slope: np.ndarray, known: Mapping[str, np.ndarray]
) -> dict[str, tuple[Any, Any]]:
    """Factor and divisor that make quantities of variables, by these, of gaits whose
    angle and period are known.
    """
    angle = known["stance_angle"]
    return {
        **dict.fromkeys(_RATES, (walker.time_unit, angle)),
        **dict.fromkeys(_ENERGIES, (1.0, _supplied(walker, slope, angle))),
        "kneestrike_time": (1.0, known.get("period")),
        _RATIO: (1.0, 1.0),
    }


def _supplied(walker: Walker, slope: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """About what steps (n,) are supplied with: the energy that they draw from gravity,
    or give it, that of the impulse of a push-off if the hip had all the mass, and the
    work of the torque between the thighs.
    """
    mass = walker.total_mass
    drawn = mass * walker.g * step_length(walker, angle) * np.sin(np.abs(slope))
    if walker.is_passive:
        return drawn
    turned = 4 * angle * np.abs(walker.forward_torque)
    return np.asarray(drawn + 0.5 * walker.push_off**2 / mass + turned)
