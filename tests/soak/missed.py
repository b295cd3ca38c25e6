"""Gaits that a survey misses: random lines, each also searched at one slope from many times as many guesses."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from gaitsweep.tasks.continuation import atlas as atlases
from gaitsweep.tasks.continuation.branch import Branch
from gaitsweep.tasks.continuation.refine import COARSE
from gaitsweep.tasks.fixed_points.newton import newton
from gaitsweep.tasks.fixed_points.search import starts
from gaitsweep.tasks.fixed_points.step_check import verify_steps
from gaitsweep.tasks.mechanics.lumped import structures_of
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Walkers whose neighbours are drawn, the key of half of them and its range, and the keys of the others.
WALKERS = ("A", "C", "E", "physical", "physical-straight")
DERIVED = {"A": ("detuning", -0.5, 2.0), "C": ("detuning", -0.5, 2.0), "E": ("foot_mass_ratio", 0.01, 0.45)}
KEYS, SPREAD = ("m_t", "m_s", "r_t", "r_s", "c_t", "c_s", "R", "eps_T", "l_t", "l_s"), 0.3
#: Range of the slopes [rad].
MIN_SLOPE, MAX_SLOPE = 1e-3, 0.5
#: Copies of the lattice of guesses at the slope, and how far they are shaken: ln angle, and relatively rates and times.
COPIES, SHAKE = 12, 0.25
#: Lines surveyed side by side.
BLOCK = 32


@dataclass
class Missed:
    """Counts by walker of the lines, of the gaits of the dense search and of those the survey lacks, with these."""

    lines: Counter[str] = field(default_factory=Counter)
    gaits: Counter[str] = field(default_factory=Counter)
    lacking: Counter[str] = field(default_factory=Counter)
    each: list[tuple[str, dict[str, float], float, float, float]] = field(default_factory=list)

    def rows(self) -> list[dict[str, float | str]]:
        """Rows of the table: by walker, and all."""
        counts = self.lines, self.gaits, self.lacking
        numbers: list[tuple[float | str, ...]] = [(name, *(float(of[name]) for of in counts)) for name in self.lines]
        numbers.append(("all", *(float(of.total()) for of in counts)))
        return [dict(zip(("walker", "lines", "gaits", "missed"), row, strict=True)) for row in numbers]


def neighbour(seed: int) -> tuple[str, dict[str, float], float]:
    """Draw a walker near one of the catalogue: its name, the keys to set, and a slope [rad]."""
    random, name = np.random.default_rng(seed), WALKERS[seed % len(WALKERS)]
    if name == "E" or (name in DERIVED and random.random() < 0.5):
        key, low, high = DERIVED[name]
        changes = {key: float(random.uniform(low, high))}
    else:
        table = CATALOGUE[name].table()
        changes = {key: float(table[key] * (1 + random.uniform(-SPREAD, SPREAD))) for key in KEYS}
    return name, changes, float(np.exp(random.uniform(np.log(MIN_SLOPE), np.log(MAX_SLOPE))))


def missed(count: int, seed: int = 1, say: Callable[[str], None] | None = None) -> Missed:
    """Compare surveys of random lines with a dense search at a slope of each."""
    outcome = Missed()
    drawn: list[tuple[str, dict[str, float], float, Walker]] = []
    for k in range(count):
        name, changes, slope = neighbour(count * seed + k)
        try:
            drawn.append((name, changes, slope, resolve(name, changes)))
        except WalkerError:
            continue
    for numbers, problem, surveyed in survey_walkers([walker for *_, walker in drawn]):
        w, line = _dense(problem, np.array([drawn[i][2] for i in numbers]))
        for lane, (i, branches) in enumerate(zip(numbers, surveyed, strict=True)):
            name, changes, slope, _ = drawn[i]
            outcome.lines[name] += 1
            for gait in w[:, line == lane].T:
                outcome.gaits[name] += 1
                if not atlases.is_known(branches, np.append(gait, np.log(slope))):
                    outcome.lacking[name] += 1
                    outcome.each.append((name, changes, slope, float(np.exp(gait[0])), float(gait[-1])))
        if say:
            say(f"{outcome.lines.total()} lines, {outcome.gaits.total()} gaits, {outcome.lacking.total()} missed")
    return outcome


def survey_walkers(walkers: Sequence[Walker]) -> Iterator[tuple[list[int], Lanes, list[list[Branch]]]]:
    """Survey the lines of walkers, those of one structure side by side."""
    structures = structures_of(walkers)
    for structure in dict.fromkeys(structures):
        alike = [i for i, other in enumerate(structures) if other == structure]
        for k in range(0, len(alike), BLOCK):
            numbers = alike[k : k + BLOCK]
            problem = Lanes([walkers[i] for i in numbers], structure)
            yield numbers, problem, atlases.survey_lines(problem, COARSE)


def _dense(problem: Lanes, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct gaits (m + phases, n) of lines at a slope of each, and the line of each."""
    lattices = [starts(problem.walker_of(i), [float(slope)])[0] for i, slope in enumerate(slopes)]
    w = np.repeat(np.hstack(lattices), COPIES, axis=1)
    line = np.repeat(np.arange(len(slopes)), [COPIES * each.shape[1] for each in lattices])
    random = np.random.default_rng(0)
    shaken = w * (1 + SHAKE * random.uniform(-1, 1, w.shape))
    shaken[0] = w[0] + SHAKE * random.uniform(-1, 1, w.shape[1])
    w = np.where(np.arange(w.shape[1]) % COPIES == 0, w, shaken)
    for coarse in (True, False):
        w, converged = newton(problem.some(line), w, np.log(slopes[line]), coarse=coarse)
        w, line = w[:, converged], line[converged]
        cells = np.vstack([line, np.round(w, 3 if coarse else 5)])
        kept = np.unique(cells, axis=1, return_index=True)[1]
        w, line = w[:, kept], line[kept]
    # Rounding may leave neighbours in two cells.
    order = np.lexsort([*w[::-1], line])
    w, line = w[:, order], line[order]
    first = np.ones(len(line), bool)
    first[1:] = (np.abs(np.diff(w, axis=1)).max(axis=0) > 1e-4) | (np.diff(line) > 0)
    w, line = w[:, first], line[first]
    if not len(line):
        return w, line
    _, check = verify_steps(problem.some(line), w, np.log(slopes[line]))
    return w[:, check.anthropomorphic], line[check.anthropomorphic]
