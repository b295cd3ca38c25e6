"""Gaits that a survey misses: random lines, each also searched at one slope from
thousands of other guesses.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.gaits.search import distinct
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.lumped import structures_of
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Walkers whose neighbours are drawn, the key of half of them and its range, and the
#: keys of the others.
WALKERS = ("A", "C", "E", "physical", "physical-straight")
DERIVED = {
    "A": ("detuning", -0.5, 2.0),
    "C": ("detuning", -0.5, 2.0),
    "E": ("foot_mass_ratio", 0.01, 0.45),
}
KEYS, SPREAD = (
    ("m_t", "m_s", "r_t", "r_s", "c_t", "c_s", "R", "eps_T", "l_t", "l_s"),
    0.3,
)
#: Range of the slopes [rad].
MIN_SLOPE, MAX_SLOPE = 1e-3, 0.5
#: Guesses of the dense search at a slope, by the number of phases of a step.
GUESSES = {1: 3000, 2: 3000}
#: Lines searched side by side.
SEARCHED = 10
#: Lines surveyed side by side.
BLOCK = 32


@dataclass
class Missed:
    """Counts by walker of the lines, of the gaits of the dense search and of those the
    survey lacks, with these.
    """

    lines: Counter[str] = field(default_factory=Counter)
    gaits: Counter[str] = field(default_factory=Counter)
    lacking: Counter[str] = field(default_factory=Counter)
    each: list[tuple[str, dict[str, Any], float, float, float]] = field(
        default_factory=list
    )

    def rows(self) -> list[dict[str, float | str]]:
        """Rows of the table: by walker, and all."""
        counts = self.lines, self.gaits, self.lacking
        numbers: list[tuple[float | str, ...]] = [
            (name, *(float(of[name]) for of in counts)) for name in self.lines
        ]
        numbers.append(("all", *(float(of.total()) for of in counts)))
        return [
            dict(zip(("walker", "lines", "gaits", "missed"), row, strict=True))
            for row in numbers
        ]


def neighbour(seed: int) -> tuple[str, dict[str, float], float]:
    """Draw a walker near one of the catalogue: its name, the keys to set, and a slope
    [rad].
    """
    random, name = np.random.default_rng(seed), WALKERS[seed % len(WALKERS)]
    if name == "E" or (name in DERIVED and random.random() < 0.5):
        key, low, high = DERIVED[name]
        changes = {key: float(random.uniform(low, high))}
    else:
        table = CATALOGUE[name].table()
        changes = {
            key: float(table[key] * (1 + random.uniform(-SPREAD, SPREAD)))
            for key in KEYS
        }
    return (
        name,
        changes,
        float(np.exp(random.uniform(np.log(MIN_SLOPE), np.log(MAX_SLOPE)))),
    )


def built(seed: int) -> tuple[str, dict[str, Any], float]:
    """Draw a walker as people build them: the name of its kind, its table, and a slope
    [rad].

    Legs of one link (half of them) and of two, these with knees in every second case;
    centres of mass from just below the hip to the foot. Legs of two links are tuned by
    offsets of their masses, or not.
    """
    random = np.random.default_rng(seed)
    draw = random.uniform

    def over_decades(low: float, high: float) -> float:
        return float(np.exp(draw(np.log(low), np.log(high))))

    radius = 0.0 if random.random() < 0.2 else float(draw(0.0, 0.8))
    slope = over_decades(MIN_SLOPE, 0.3)
    if seed % 2 == 0:
        length = 1.0 - radius
        leg = {
            "l": length,
            "c": length * draw(0.03, 1.0),
            "r": length * over_decades(0.02, 1.0),
            "m": 1.0,
            "R": radius,
        }
        hip = 0.0 if random.random() < 0.15 else over_decades(0.01, 100.0)
        return "one link", {"knees": False, **leg, "m_h": hip}, slope

    knees = seed % 4 == 1
    thigh = float(draw(0.3, 0.7))
    shank = 1.0 - thigh
    table: dict[str, Any] = {
        **{
            "knees": knees,
            "l_t": thigh,
            "l_s": shank,
            "R": min(radius, 0.8 * shank),
            "w_t": 0.0,
            "w_s": 0.0,
        },
        **{"m_t": 1.0, "m_s": over_decades(0.03, 5.0)},
        **{"c_t": thigh * draw(0.02, 0.9), "c_s": shank * draw(0.05, 0.9)},
        **{"r_t": thigh * draw(0.02, 0.5), "r_s": shank * draw(0.02, 0.5)},
        "eps_T": 0.0 if random.random() < 0.3 else float(draw(0.0, 0.4)),
        "m_h": 0.0 if random.random() < 0.15 else over_decades(0.05, 50.0),
    }
    if random.random() < 0.6:
        table["tuned"] = ["w_t", "w_s"] if knees else ["w_t"]
    return "knees" if knees else "two links", table, slope


def missed(
    numbers: Sequence[int],
    draw: Callable[[int], tuple[str, dict[str, Any], float]] = neighbour,
    say: Callable[[str], None] | None = None,
) -> Missed:
    """Compare surveys of random lines with a dense search at a slope of each.

    Parameters
    ----------
    numbers : sequence of int
        Of the walkers drawn.
    draw : callable
        `neighbour` or `built`.
    say : callable, optional
        Told of the counts after each block of lines.
    """
    outcome = Missed()
    drawn: list[tuple[str, dict[str, Any], float, Walker]] = []
    for number in numbers:
        name, keys, slope = draw(number)
        try:
            walker = resolve(name, keys) if draw is neighbour else resolve(keys)
        except WalkerError:
            continue
        drawn.append((name, keys, slope, walker))

    for some, problem, surveyed in survey_walkers([walker for *_, walker in drawn]):
        w, line = _dense(problem, np.array([drawn[i][2] for i in some]))
        for lane, (i, branches) in enumerate(zip(some, surveyed, strict=True)):
            name, keys, slope, _ = drawn[i]
            outcome.lines[name] += 1
            for gait in w[:, line == lane].T:
                outcome.gaits[name] += 1
                if not atlases.is_known(branches, np.append(gait, np.log(slope))):
                    outcome.lacking[name] += 1
                    outcome.each.append(
                        (name, keys, slope, float(np.exp(gait[0])), float(gait[-1]))
                    )
        if say:
            say(
                f"{outcome.lines.total()} lines, {outcome.gaits.total()} gaits, {outcome.lacking.total()} missed"
            )
    return outcome


def survey_walkers(
    walkers: Sequence[Walker],
) -> Iterator[tuple[list[int], Lanes, list[list[Branch]]]]:
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
    parts = []
    for first in range(0, len(slopes), SEARCHED):
        lines = np.arange(first, min(first + SEARCHED, len(slopes)))
        w, line = _searched(problem, slopes, lines)
        parts.append((w, line))
    return np.hstack([w for w, _ in parts]), np.concatenate([line for _, line in parts])


def _searched(
    problem: Lanes, slopes: np.ndarray, lines: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distinct gaits of some lines, and the line of each."""
    count = GUESSES[problem.phases]
    w = np.hstack(
        [_guesses(problem.walker_of(i), slopes[i], problem.m, count, i) for i in lines]
    )
    line = np.repeat(lines, count)
    for coarse, apart in ((True, 1e-3), (False, 1e-5)):
        w, converged = newton(
            problem.some(line),
            w,
            np.log(slopes[line]),
            coarse=coarse,
            max_iterations=20,
        )
        w, line = w[:, converged], line[converged]
        kept, _ = distinct(w, line, apart)
        w, line = w[:, kept], line[kept]
    if not len(line):
        return w, line

    _, check = verify_steps(problem.some(line), w, np.log(slopes[line]))
    return w[:, check.anthropomorphic], line[check.anthropomorphic]


def _guesses(walker: Walker, slope: float, m: int, count: int, seed: int) -> np.ndarray:
    """Random guesses (m + phases, count): an inverted pendulum, and a leg that swings
    by itself, both far off.
    """
    random = np.random.default_rng(seed)
    draw = random.uniform
    log_angle = draw(np.log(0.3 * slope), np.log(1.3), count)

    moment = -(
        walker.m_t * walker.thigh_centre
        + walker.m_s * (walker.knee + walker.shank_centre)
    ).imag
    swing = np.pi * np.sqrt(walker.leg_inertia / max(moment * walker.leg, 1e-9))
    period = np.exp(draw(np.log(0.03), np.log(12.0), count))
    near = random.random(count) < 0.7
    period[near] = (swing * draw(0.4, 2.0, count))[near]

    stance = -1 / np.tanh(period / 2) * np.exp(draw(-0.7, 1.3, count))
    if walker.knees:
        swing_rate = draw(-1.2, 0.5, count) * np.abs(stance)
        return np.vstack(
            [log_angle, stance, swing_rate, draw(0.25, 0.98, count) * period, period]
        )
    if m == 2:
        return np.vstack([log_angle, stance, period])
    frequency = np.pi / swing
    swing_rate = frequency / np.tan(frequency * period / 2)
    swing_rate = np.clip(swing_rate, -8 * frequency, 8 * frequency) * draw(
        0.5, 1.5, count
    ) + draw(-1, 1, count)
    wild = random.random(count) < 0.3
    swing_rate[wild] = (draw(-4, 4, count) * max(frequency, 1.0))[wild]
    return np.vstack([log_angle, stance, swing_rate, period])
