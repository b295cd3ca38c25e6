"""The case: states, the walker's gaits, and what the rules have said so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.branches.nearest import Gaits
from gaitsweep.tasks.check.grounds import Grounds
from gaitsweep.tasks.check.rows import Rows, State, magnitudes, relative_distance
from gaitsweep.tasks.check.verdicts import sentences
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.mechanics.arrays import Numbers, Slopes
from gaitsweep.tasks.mechanics.lumped import general_structure_of
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.step.simulate import LOST, MAX_ANGLE
from gaitsweep.tasks.walkers.walker import Walker

#: The last digit given never allows more than this, relative.
COARSEST = 0.01
#: By how much more a state changed by a fault may differ.
CHANGED = 2.0


@dataclass
class Case:
    """States, the walker's gaits, and what is said of the states so far.

    Attributes
    ----------
    walker : Walker
    grounds : Grounds
    rows : Rows
    general : Lanes
        The step map in n lanes, with three section coordinates for every kind of walker.
    verdict, reason : ndarray of str, shape (n,)
        Empty as long as no rule has applied.
    flown : ndarray of bool, shape (n,)
        Whether the state was flown to the section.
    depth, belongs : ndarray, shape (n,)
        How far the swing foot is below the ground [leg], and the slope on which both feet
        stand, or of which the state is a gait [rad].
    outcome, times, missed : ndarray, shape (n,), of times (phases, n)
        How the steps from the state end, when the events of the first come
        [sqrt(leg/g)], and by what the state misses itself after them, relative.
    missed_by_one : ndarray, shape (n,)
        By what the state misses itself after one step, relative.
    candidates : list of Gaits
        Gaits at the slopes of the rows, one of each in every set.
    nearest, distance, label : Gaits, ndarray, shape (n,)
        The gait nearest to the state, or to what this is without its fault, how far it
        is, relative, and what it is called.
    other : ndarray of str, shape (n,)
        Walker of the catalogue of which the state is a gait.
    """

    walker: Walker
    grounds: Grounds
    rows: Rows

    def __post_init__(self) -> None:
        n = len(self.rows.slope)
        self.n = n
        self.problem = self.grounds.problem
        self.general = _general(self.walker, n)

        self.verdict = np.full(n, "", dtype="<U32")
        self.reason = np.full(n, "", dtype=object)

        self.flown = np.zeros(n, bool)
        self.depth = np.full(n, np.nan)
        self.belongs = np.full(n, np.nan)

        self.outcome = np.full(n, LOST)
        self.times = np.full((self.problem.phases, n), np.nan)
        self.missed = np.full(n, np.nan)
        self.missed_by_one = np.full(n, np.nan)

        self.candidates = list[Gaits]()
        self.nearest = Gaits.none(n)
        self.distance = np.full(n, np.inf)
        self.label = np.full(n, "", dtype=object)
        self.other = np.full(n, "", dtype=object)

    @property
    def claimed(self) -> int:
        """Number of steps after which the states are held to repeat."""
        return self.grounds.claimed

    @property
    def open(self) -> np.ndarray:
        """Numbers of the rows without a verdict."""
        return np.flatnonzero(self.verdict == "")

    @property
    def steppable(self) -> np.ndarray:
        """Numbers of the rows without a verdict from which a walker may step."""
        angle = self.rows.state[0]
        with np.errstate(invalid="ignore"):
            may = (angle > 0) & (angle < MAX_ANGLE)
        return self.open[may[self.open]]

    def say(self, verdict: str, lanes: Numbers, **words: Any) -> None:
        """Give some rows their verdict, with what the sentence tells of each."""
        self.verdict[lanes] = verdict
        sentence = sentences()[verdict]
        for place, lane in enumerate(lanes.tolist()):
            told = {name: values[place] for name, values in words.items()}
            self.reason[lane] = sentence.format(**told)

    def say_period(self, lanes: Numbers) -> None:
        """Give some rows the verdict that they repeat after other steps than claimed."""
        self.say("period", lanes, steps=self._steps_in_words(lanes))

    def say_fault(self, verdict: str, lanes: Numbers) -> None:
        """Give some rows the verdict of their fault, and say after how many steps they
        repeat if these are not as many as claimed.
        """
        self.say(verdict, lanes)
        for lane, words in zip(
            lanes.tolist(), self._steps_in_words(lanes), strict=True
        ):
            if self.nearest.steps[lane] != self.claimed:
                self.reason[lane] += f" It repeats after {words}."

    def _steps_in_words(self, lanes: Numbers) -> list[str]:
        """After how many steps the gaits nearest to some rows repeat."""
        counts = self.nearest.steps[lanes].tolist()
        return [f"{count} step{'s' * (count > 1)}" for count in counts]

    def say_slope(self, lanes: Numbers, slopes: Slopes) -> None:
        """Give some rows the verdict that they are gaits of other slopes."""
        self.belongs[lanes] = slopes
        self.say("slope", lanes, belongs=slopes, degrees=np.degrees(slopes))

    def states(self, lanes: Numbers) -> np.ndarray:
        """States (3, k) of some rows."""
        return self.rows.state[:, lanes]

    def slopes(self, lanes: Numbers) -> np.ndarray:
        """Slopes (k,) of some rows [rad]."""
        return self.rows.slope[lanes]

    # Where there is no gait its state is NaN.
    @np.errstate(invalid="ignore")
    def within(
        self,
        state: State,
        gait: State,
        lanes: Numbers,
        factor: float | np.ndarray = 1.0,
    ) -> np.ndarray:
        """Whether states (3, k) of some rows are gaits (3, k), to the tolerance."""
        sizes = magnitudes(gait)
        digits = self.rows.table_digit[:, lanes]
        digits = np.minimum(digits, COARSEST * sizes)
        allowed = factor * (self.rows.tolerance * sizes + digits)
        is_near = np.abs(state - gait) <= allowed
        return np.asarray(is_near.all(axis=0))

    def relative_tolerance(self, lanes: Numbers) -> np.ndarray:
        """Largest relative tolerance of a coordinate."""
        sizes = magnitudes(self.states(lanes))
        share = self.rows.table_digit[:, lanes] / sizes
        digits = np.minimum(share.max(axis=0), COARSEST)
        return np.asarray(self.rows.tolerance + digits)

    def sections(self, lanes: Numbers, state: State) -> np.ndarray:
        """Section coordinates (3, k) of states (3, k) of some rows."""
        problem = self.general.some(lanes)
        return problem.section_of(state, self.slopes(lanes))

    def solve_gaits(self, lanes: Numbers) -> None:
        """Solve the walker's gaits at the slopes of some rows."""
        slope, place = np.unique(self.slopes(lanes), return_inverse=True)
        for number, gaits in enumerate(self.grounds.gaits_at(slope)):
            if number == len(self.candidates):
                self.candidates.append(Gaits.none(self.n))
            self.candidates[number].put(lanes, some_gaits(gaits, place))

    def match(self, lanes: Numbers, state: State, factor: float = 1.0) -> Numbers:
        """Which candidate each state (3, k) is, -1 for none."""
        match = np.full(len(lanes), -1)
        for number, gaits in enumerate(self.candidates):
            gait = gaits.state[:, lanes]
            are = self.within(state, gait, lanes, factor)
            match[are & (match < 0)] = number
        return match

    def take_candidates(self, lanes: Numbers, numbers: Numbers, state: State) -> None:
        """Make candidates, by their numbers, the nearest gaits of some rows, whose states
        (3, k) are without their fault.
        """
        for number, gaits in enumerate(self.candidates):
            is_own = numbers == number
            some = lanes[is_own]
            self.set_nearest(some, some_gaits(gaits, some), state[:, is_own])

    def set_nearest(
        self, lanes: Numbers, gaits: Gaits, state: State | None = None
    ) -> None:
        """Make gaits of k lanes the nearest of some k rows, whose states (3, k) are
        others if they have a fault.
        """
        self.nearest.put(lanes, gaits)
        own = self.states(lanes) if state is None else state
        self.distance[lanes] = relative_distance(own, gaits.state)
        places, passes = gaits.place.tolist(), gaits.passes.tolist()
        for lane, place, times in zip(lanes.tolist(), places, passes, strict=True):
            is_once = times == 1
            self.label[lane] = GAITS[place] if is_once else f"passes_{times:g}_times"

    def find_nearest(self) -> None:
        """Find the gait nearest to each row at its slope."""
        lanes = self.open
        self.solve_gaits(lanes)
        sets = [some_gaits(gaits, lanes) for gaits in self.candidates]
        self.take_nearest(lanes, sets)

    def take_nearest(self, lanes: Numbers, sets: Sequence[Gaits]) -> None:
        """Make the nearest of some sets of gaits, of k lanes, the nearest of some k rows
        where it is nearer than the one they have.
        """
        state = self.states(lanes)
        for gaits in sets:
            distance = relative_distance(state, gaits.state)
            nearer = np.flatnonzero(distance < self.distance[lanes])
            self.set_nearest(lanes[nearer], some_gaits(gaits, nearer))


def _general(walker: Walker, n: int) -> Lanes:
    """The step map with three coordinates in n lanes, of point feet as of other straight
    legs.
    """
    one = Lanes([walker], general_structure_of(walker))
    return one.some(np.zeros(n, int))


def some_gaits(gaits: Gaits, lanes: Numbers) -> Gaits:
    """The gaits of some lanes."""
    taken: Gaits = lanes_of(gaits, lanes)
    return taken
