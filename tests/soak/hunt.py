"""The worst inputs: optimisers move a walker's keys and slopes to where its gaits are
hardest to solve.
"""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from joblib import Parallel, delayed
from scipy.optimize import differential_evolution, minimize

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.settling import settle_on_branches
from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.gaits.newton import newton_step
from gaitsweep.tasks.gaits.polish import Guesses, Polished
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.step.lanes import join_lanes, lanes_of
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker, WalkerError
from soak.bounds import compared
from soak.missed import DERIVED, KEYS, SPREAD, WALKERS, survey_walkers

#: Range of the slopes [rad], and of their relative distances from the ends and folds of
#: branches.
MIN_SLOPE, MAX_SLOPE = 1e-7, 0.3
NEAREST, FARTHEST = 1e-12, 1e-1
#: What is maximised, with what it means; `true error over bound` must stay below 1.
MEASURES = {
    "true error over bound": "error in extended precision over the error bound",
    "error bound": "relative",
    "last Newton step": "relative",
    "time": "processor time of a gait of one line alone [s]",
    "grazing": "stance angle over the least rate of a guard at its strike",
    "fold": "1/|1 - multiplier|",
    "flip": "1/|1 + multiplier|",
    "vanishing rate": "largest over smallest rate",
    "label tie": "1/|gait ratio - 1/2|",
    "re-pairing": "1/distance to the nearest gait of another branch at the slope",
}
#: Keys that change the walker's structure where they vanish, and their largest value
#: here.
VANISHING = (
    ("E", "foot_mass_ratio", 0.1),
    ("B", "R", 0.1),
    ("C", "m_h", 1.0),
    ("A", "detuning", 0.1),
    ("C", "detuning", 0.1),
)
SMALLEST = 1e-12
#: Worst gaits kept of each measure, and gaits of a line that are solved again in
#: extended precision.
WORST, REFERENCES = 10, 3
#: Generations of a hunt, and lines of a generation for each coordinate.
GENERATIONS, POPULATION = 2, 3


@dataclass(frozen=True)
class Input:
    """A gait: the walker's name, the keys set, the slope [rad], its stance angle [rad]
    and the value of a measure.
    """

    walker: str
    keys: dict[str, float]
    slope: float
    angle: float
    value: float

    @property
    def command(self) -> str:
        """Command that prints it."""
        keys = "".join(f" --set {key}={value!r}" for key, value in self.keys.items())
        return f"gaitsweep solve --walker {self.walker} --slope {self.slope!r}{keys}"


@dataclass
class Hunted:
    """The worst gaits by measure, and what is wrong: gaits that fail and errors above
    their bounds.
    """

    worst: dict[str, list[Input]] = field(
        default_factory=lambda: {name: [] for name in MEASURES}
    )
    wrong: list[tuple[str, Input]] = field(default_factory=list)
    lines: int = 0
    gaits: int = 0
    compared: int = 0

    def add(self, other: "Hunted") -> None:
        """Merge another hunt; of the gaits of one walker only the worst is kept."""
        for name, known in self.worst.items():
            best: dict[tuple[object, ...], Input] = {}
            for one in sorted([*known, *other.worst[name]], key=lambda one: -one.value):
                best.setdefault((one.walker, *one.keys.items()), one)
            self.worst[name] = list(best.values())[:WORST]
        self.wrong += other.wrong
        self.lines += other.lines
        self.gaits += other.gaits
        self.compared += other.compared

    def rows(self) -> list[str]:
        """The worst of each measure, then what is wrong: value, stance angle [rad] and
        command of each.
        """
        found = [
            (name, one) for name, of in self.worst.items() for one in of
        ] + self.wrong
        return [
            f"{name} {one.value:.4g}, stance angle {one.angle!r}: {one.command}"
            for name, one in found
        ]

    def __str__(self) -> str:
        worst = "; ".join(
            f"{name} {of[0].value:.3g}" for name, of in self.worst.items() if of
        )
        return f"{self.lines} lines, {self.gaits} gaits, {len(self.wrong)} wrong; worst: {worst}"


@dataclass(frozen=True)
class Range:
    """A walker of the catalogue and the ranges of the keys that are moved, evenly or in
    their logarithms.
    """

    walker: str
    low: dict[str, float]
    high: dict[str, float]
    logarithmic: bool = False

    def keys(self, unit: np.ndarray) -> dict[str, float]:
        """Values of the keys."""
        ends = [(key, low, self.high[key]) for key, low in self.low.items()]
        return {
            key: float(
                low * (high / low) ** share
                if self.logarithmic
                else low + share * (high - low)
            )
            for (key, low, high), share in zip(ends, unit, strict=False)
        }


def ranges() -> list[Range]:
    """All that is hunted: derived keys, keys that vanish, and masses, lengths and
    offsets off by up to 30 %.
    """
    hunted = [
        Range(name, {key: low}, {key: high})
        for name, (key, low, high) in DERIVED.items()
    ]
    hunted += [
        Range(name, {key: SMALLEST * high}, {key: high}, logarithmic=True)
        for name, key, high in VANISHING
    ]
    for name in WALKERS:
        table = CATALOGUE[name].table()
        low, high = (
            {key: float(table[key] * (1 + s * SPREAD)) for key in KEYS if table[key]}
            for s in (-1, 1)
        )
        hunted.append(Range(name, low, high))
    return hunted


def hunt(
    seed: int = 1, jobs: int = 2, say: Callable[[str], None] | None = None
) -> Hunted:
    """Maximise every measure over every range, by differential evolution and then by
    the Nelder-Mead method.
    """
    asked = [(name, where) for where in ranges() for name in MEASURES]
    outcome = Hunted()
    work = Parallel(n_jobs=jobs, return_as="generator")
    each = work(
        delayed(maximise)(name, where, GENERATIONS, seed + k)
        for k, (name, where) in enumerate(asked)
    )
    for (name, where), found in zip(asked, each, strict=True):
        outcome.add(found)
        if say:
            say(f"{name}, {where.walker} over {', '.join(where.low)}: {outcome}")
    return outcome


def maximise(name: str, where: Range, generations: int, seed: int) -> Hunted:
    """Maximise one measure over one range."""
    outcome, size = Hunted(), len(where.low) + 2

    def cost(population: np.ndarray) -> np.ndarray:
        values, hunted = _evaluated(where, population.T)
        outcome.add(hunted)
        return -values[name]

    box = [(0.0, 1.0)] * size
    best = differential_evolution(
        cost,
        box,
        vectorized=True,
        updating="deferred",
        polish=False,
        popsize=POPULATION,
        maxiter=generations,
        rng=seed,
    )
    if not generations:
        return outcome
    minimize(
        lambda unit: cost(np.clip(unit, 0, 1)[:, None])[0],
        best.x,
        method="Nelder-Mead",
        options={"maxfev": 2 * size * generations},
    )
    return outcome


def _evaluated(where: Range, unit: np.ndarray) -> tuple[dict[str, np.ndarray], Hunted]:
    """Largest values of the measures on lines (n,), and their worst gaits, for
    coordinates (n, number of keys + 2).
    """
    values, outcome = {name: np.full(len(unit), -np.inf) for name in MEASURES}, Hunted()
    lines: list[tuple[int, dict[str, float], Walker]] = []
    for i, keys in enumerate(map(where.keys, unit)):
        with contextlib.suppress(WalkerError):  # invalid walkers
            lines.append((i, keys, resolve(where.walker, keys)))
    for numbers, problem, surveyed in survey_walkers([walker for *_, walker in lines]):
        for lane, (number, branches) in enumerate(zip(numbers, surveyed, strict=True)):
            i, keys, _ = lines[number]
            hunted = hardest(
                where.walker,
                keys,
                problem.alone(lane),
                branches,
                _slopes_of(branches, unit[i, -2:]),
            )
            for name, worst in hunted.worst.items():
                values[name][i] = worst[0].value if worst else -np.inf
            outcome.add(hunted)
    return values, outcome


def _slopes_of(branches: list[Branch], share: np.ndarray) -> np.ndarray:
    """Slopes of a line: one by itself, and at one relative distance on either side of
    every end and fold.
    """
    slope = MIN_SLOPE * (MAX_SLOPE / MIN_SLOPE) ** share[0]
    ends = np.array(
        [branch.q[k] for branch in branches for piece in branch.pieces() for k in piece]
    )
    distance = NEAREST * (FARTHEST / NEAREST) ** share[1]
    beside = (np.exp(ends)[:, None] * (1 + distance * np.array([-1.0, 1.0]))).ravel()
    return np.unique(
        np.append(beside[(beside > MIN_SLOPE) & (beside < MAX_SLOPE)], slope)
    )


def hardest(
    walker: str,
    keys: dict[str, float],
    problem: Problem,
    branches: list[Branch],
    slope: np.ndarray,
) -> Hunted:
    """Solve the gaits of a line at some slopes, and find the worst by every measure."""
    outcome = Hunted(lines=1)
    pieces = [
        (number, *each)
        for number, branch in enumerate(branches)
        for each in branch.guesses(np.log(slope))
    ]
    if not pieces:
        return outcome
    guesses = join_lanes(
        [
            branches[k].known_guesses(Z, segment, slope[index])
            for k, index, Z, segment in pieces
        ]
    )
    start = time.process_time()
    at = settle_on_branches(
        problem,
        guesses,
        [(problem, branches[k], segment) for k, _, _, segment in pieces],
    )
    seconds = (time.process_time() - start) / len(guesses.slope)
    angle, settled = at.y[0] * at.scale, at.converged & at.step
    outcome.gaits = len(angle)

    def gait(k: int, value: float) -> Input:
        return Input(walker, keys, float(guesses.slope[k]), float(angle[k]), value)

    outcome.wrong = [
        ("not converged", gait(k, float(at.bound[k])))
        for k in np.flatnonzero(~settled).tolist()
    ]
    values = {
        name: np.where(settled, value, -np.inf)
        for name, value in _measured(problem, at, guesses).items()
    }
    values["time"] = np.where(settled, seconds, -np.inf)
    number = np.repeat([k for k, *_ in pieces], [len(index) for _, index, *_ in pieces])
    place = np.vstack([np.log(angle), at.y[1:] / at.y[0]])
    values["re-pairing"] = np.where(
        settled, _nearness(guesses.slope, number, place), -np.inf
    )
    # In extended precision the gaits whose bounds are largest, and those nearest a
    # fold.
    hard = np.unique(
        [np.argsort(-values[name])[:REFERENCES] for name in ("error bound", "fold")]
    )
    hard = hard[settled[hard]]
    ratio = values["true error over bound"] = np.full(len(angle), -np.inf)
    compared_gaits = [
        (k, *row)
        for k in hard
        for row in compared(problem, lanes_of(guesses, np.array([k])))
    ]
    outcome.compared = len(compared_gaits)
    for k, _, bound, error, _, _ in compared_gaits:
        ratio[k] = error / bound
    outcome.wrong += [
        ("true error over bound", gait(k, float(ratio[k])))
        for k in np.flatnonzero(ratio > 1).tolist()
    ]
    for name, value in values.items():
        k = int(np.argmax(value))
        if value[k] > -np.inf:
            outcome.worst[name] = [gait(k, float(value[k]))]
    return outcome


def _measured(
    problem: Problem, at: Polished, guesses: Guesses
) -> dict[str, np.ndarray]:
    """Measures of gaits that one evaluation gives, each of shape (n,)."""
    each = multipliers(at.stride.jacobian, 3)[:, : problem.m]
    rates = np.abs(at.y[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        measures = {
            "error bound": at.bound,
            "last Newton step": np.abs(newton_step(at.stride, guesses.w)).max(axis=0),
            "grazing": at.stride.y[0] / np.abs(at.stride.closing).min(axis=0),
            "fold": 1 / np.abs(each - 1).min(axis=1),
            "flip": 1 / np.abs(each + 1).min(axis=1),
            "vanishing rate": rates.max(axis=0) / rates.min(axis=0),
            "label tie": 1 / np.abs(gait_ratio(at.stride) - 0.5),
        }
    # Exact hits count as the largest number.
    return {name: np.nan_to_num(value, nan=-np.inf) for name, value in measures.items()}


def _nearness(slope: np.ndarray, branch: np.ndarray, place: np.ndarray) -> np.ndarray:
    """1/distance of each gait, by angle and rates (m, n), to the nearest of another
    branch at its slope; else -inf.
    """
    distance = np.abs(place[:, :, None] - place[:, None]).max(axis=0)
    distance[
        (slope[:, None] != slope) | (branch[:, None] == branch) | ~np.isfinite(distance)
    ] = np.inf
    with np.errstate(divide="ignore"):
        return np.where(distance < np.inf, 1 / distance, -np.inf).max(axis=1)
