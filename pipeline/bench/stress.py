"""Random walkers, slopes and starts far beyond the paper's: what becomes of every one of them, counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tasks import solve_points
from tasks.fixed_points.multipliers import multipliers
from tasks.fixed_points.newton import lipschitz, newton
from tasks.fixed_points.polish import UNKNOWN, settle
from tasks.fixed_points.rounding import rounding_std
from tasks.fixed_points.step_check import gait_ratio
from tasks.mechanics.kernel import flow
from tasks.mechanics.lumped import structure_of
from tasks.registry import COSTLY, GAITS, STATUSES, VARIABLES
from tasks.step.problem import Lanes
from tasks.walkers.catalogue import CATALOGUE
from tasks.walkers.resolve import detuned
from tasks.walkers.walker import Walker, WalkerError

#: Lanes solved together.
BLOCK = 4096
#: Slopes drawn from [rad].
MIN_SLOPE, MAX_SLOPE = 1e-12, 0.3
Random = np.random.Generator


@dataclass(frozen=True)
class Accepted:
    """A gait that was accepted, in the walker's units, and by which tale."""

    family: str
    walker: Walker
    slope: float
    label: str
    angle: float
    rates: tuple[float, float, float]
    period: float
    multiplier: float
    bound: float


@dataclass
class Outcomes:
    """What became of random tries: counts by family and outcome, the accepted gaits, and the work it took."""

    counts: dict[str, Counter[str]] = field(default_factory=dict)
    accepted: list[Accepted] = field(default_factory=list)
    strides: int = 0
    #: Tries that ended in no way foreseen: these are bugs.
    wrong: list[str] = field(default_factory=list)

    @property
    def tries(self) -> int:
        return sum(sum(of.values()) for of in self.counts.values())

    def add(self, family: str, outcome: str, times: int = 1) -> None:
        self.counts.setdefault(family, Counter())[outcome] += times

    def rows(self) -> list[dict[str, float | str]]:
        """The table, a row an outcome and a column a family."""
        outcomes = sorted({o for of in self.counts.values() for o in of})
        return [
            {
                "outcome": o,
                **{f: float(of[o]) for f, of in self.counts.items()},
                "all": float(sum(of[o] for of in self.counts.values())),
            }
            for o in outcomes
        ]

    def text(self) -> str:
        """The table as lines of text."""
        rows = self.rows()
        width = max(len(str(row["outcome"])) for row in rows)
        head = " ".join(f"{name:>16}" for name in rows[0] if name != "outcome")
        body = [
            f"{row['outcome']:<{width}} " + " ".join(f"{int(v):>16,}" for k, v in row.items() if k != "outcome")
            for row in rows
        ]
        return "\n".join([" " * width + " " + head, *body])


def _log(random: Random, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _mass(random: Random) -> float:
    return _log(random, 1e-8, 1.0)


def _any(random: Random, knees: bool) -> Walker:
    """A walker with every key drawn from a broad range, some of which cannot be."""
    thigh = float(random.uniform(0.1, 0.9))
    shank = 1.0 - thigh
    return Walker(
        l_t=thigh,
        l_s=shank,
        m_t=_mass(random),
        m_s=_mass(random),
        m_h=_mass(random),
        r_t=float(random.uniform(0, 0.6)),
        r_s=float(random.uniform(0, 0.6)),
        c_t=float(random.uniform(-0.3, 1.0)) * thigh,
        c_s=float(random.uniform(-0.3, 1.2)) * shank,
        w_t=float(random.normal(0, 0.1)),
        w_s=float(random.normal(0, 0.1)),
        R=float(random.uniform(0, 0.95)),
        eps_T=float(random.normal(0, 0.2)),
        knees=knees,
    )


def _tuned(walker: Walker) -> Walker:
    """The same with its masses on the lines that walking at vanishing slope asks for."""
    if walker.m_s > walker.m_t:
        # A light thigh could balance a heavy shank from legs away only.
        walker = replace(walker, m_t=walker.m_s)
    w_s = float(walker.c_s * np.tan(walker.eps_S))
    w_t = float(-np.tan(walker.eps_T) * (walker.c_t + walker.m_s * walker.l_t / walker.m_t))
    return replace(walker, w_t=w_t, w_s=w_s)


def _near(random: Random, name: str) -> Walker:
    """A kneed or straight machine mixed anyhow with its tuned twin, each key off by up to a fifth."""
    found = detuned(name, float(random.choice([0.0, 1.0, random.uniform(-1, 3)])))
    if random.random() < 0.5:
        keys = ("m_t", "m_s", "r_t", "r_s", "c_t", "c_s", "R", "eps_T")
        found = replace(found, **{k: getattr(found, k) * float(random.uniform(0.8, 1.2)) for k in keys})
    return _tuned(found) if random.random() < 0.5 else found


#: Each family's name, its share of the tries and a draw from it.
FAMILIES: dict[str, tuple[float, Callable[[Random], Walker]]] = {
    "massless foot": (0.05, lambda random: CATALOGUE["D"]),
    "point feet": (
        0.25,
        lambda random: replace(
            CATALOGUE["E"], m_s=_mass(random), m_t=_mass(random) if random.random() < 0.5 else 1.0, m_h=_mass(random)
        ),
    ),
    "round feet": (0.25, lambda random: replace(CATALOGUE["B"], m_s=_mass(random), R=float(random.uniform(0, 0.95)))),
    "straight, any": (0.15, lambda random: _any(random, False)),
    "straight, tuned": (
        0.15,
        lambda random: _tuned(_any(random, False)) if random.random() < 0.5 else _near(random, "A"),
    ),
    "kneed, any": (0.05, lambda random: _any(random, True)),
    "kneed, near": (0.10, lambda random: _near(random, "C")),
}


def random_walker(family: str, seed: int) -> Walker:
    """The first walker a family's draws from a seed give that can be."""
    found = Outcomes()
    random = np.random.default_rng(seed)
    while True:
        for walker in _drawn(family, 1, random, found):
            return walker


def _drawn(family: str, count: int, random: Random, found: Outcomes) -> list[Walker]:
    """Walkers of a family; those that cannot be are counted by the key that says so."""
    walkers = []
    for _ in range(count):
        try:
            walkers.append(FAMILIES[family][1](random))
        except WalkerError as refused:
            found.add(family, f"refused: {refused.key}")
    return walkers


def _starts(problem: Lanes, slope: np.ndarray, random: Random) -> np.ndarray:
    """Starts around the search's lattice, one in five of them absurd; shape (m + phases, n)."""
    n = len(slope)
    absurd = random.random(n) < 0.2
    period = np.where(absurd, random.uniform(0.05, 12, n), random.uniform(1.8, 4.2, n))
    top = np.log(np.minimum(2.5 * slope ** (1 / 3), 0.7))
    log_angle = np.where(absurd, random.uniform(-30, 0, n), random.uniform(np.log(slope), top))
    rate = np.where(absurd, random.normal(0, 10, n), -1.0 / np.tanh(period / 2) * random.uniform(0.8, 1.2, n))
    rows = [log_angle, rate]
    if problem.m == 3:
        rows.append(np.where(absurd, random.normal(0, 10, n), random.uniform(-1, 1, n)))
    if problem.phases == 2:
        rows.append(period * random.uniform(0.3, 1.0, n))
    return np.vstack([*rows, period])


def lanes(count: int, seed: int = 1, say: Callable[[str], None] | None = None) -> Outcomes:
    """Random walkers, slopes and starts straight through Newton, verdict and bound, a walker in every lane."""
    found, random = Outcomes(), np.random.default_rng(seed)
    for family, (share, _) in FAMILIES.items():
        todo = round(share * count)
        for k in range(0, todo, BLOCK):
            walkers = _drawn(family, min(BLOCK, todo - k), random, found)
            of = [structure_of(w) for w in walkers]
            for structure in dict.fromkeys(of):
                _lanes(
                    family,
                    Lanes([w for w, s in zip(walkers, of, strict=True) if s == structure], structure),
                    random,
                    found,
                )
        if say:
            say(f"{family}: {todo:,} lanes")
    return found


def _lanes(family: str, problem: Lanes, random: Random, found: Outcomes) -> None:
    n, m = len(problem.walkers), problem.m
    slope = np.exp(random.uniform(np.log(MIN_SLOPE), np.log(MAX_SLOPE), n))
    before = _strides(problem)
    start = _starts(problem, slope, random)
    solved = newton(problem, start, np.log(slope))
    there = np.nonzero(solved.converged)[0]
    found.add(family, "Newton did not converge", n - len(there))
    if len(there):
        some, slope, w = problem.some(there), slope[there], solved.w[:, there]
        X = np.vstack([w[:m], np.log(slope)])
        estimate = lipschitz(some, X, w[m:])
        at = settle(
            some,
            np.vstack([X, w[m:]]),
            slope,
            estimate,
            rounding_std(some, w, np.log(slope), near=4),
            np.full(len(there), UNKNOWN),
        )
        ratio, largest = gait_ratio(at.stride), np.abs(multipliers(at.stride.jacobian, m)).max(axis=1)
        for i in range(len(there)):
            outcome = _outcome(bool(at.converged[i]), bool(at.step[i]), int(at.leg_passes[i]), float(ratio[i]))
            found.add(family, outcome)
            if outcome in ("gait, long", "gait, short"):
                walker = some.walkers[i]
                time_unit = float(np.sqrt(walker.leg / walker.g))
                state = at.state[:, i] * at.scale[i]
                half = len(state) // 2
                rates = state[half:] / time_unit
                found.accepted.append(
                    Accepted(
                        family,
                        walker,
                        float(slope[i]),
                        outcome[6:],
                        float(at.y[0, i] * at.scale[i]),
                        (float(rates[0]), float(rates[1]), float(rates[-1])),
                        float(at.times[-1, i]) * time_unit,
                        float(largest[i]),
                        float(at.bound[i]),
                    )
                )
                _check(found)
    found.strides += _strides(problem) - before


def _strides(problem: Lanes) -> int:
    """Strides flown so far by a structure's exact flow; each ends with locked knees."""
    return flow(problem.structure, False, 3 if problem.phases == 2 else problem.m, False).evaluations


def _outcome(converged: bool, step: bool, leg_passes: int, ratio: float) -> str:
    if not converged:
        return "too ill-conditioned for a bound"
    if not step:
        return "solution that is no step"
    if leg_passes != 1:
        return f"step, legs pass {leg_passes} times" if leg_passes < 4 else "step, legs pass 4 times or more"
    return "gait, long" if ratio < 0.5 else "gait, short"


def _check(found: Outcomes) -> None:
    """An accepted gait has numbers, and numbers a gait may have."""
    gait = found.accepted[-1]
    numbers = (gait.angle, *gait.rates, gait.period, gait.multiplier, gait.bound)
    if not np.isfinite(numbers).all() or gait.angle <= 0 or gait.period <= 0 or not 0 < gait.bound < 1e-3:
        found.wrong.append(f"{gait}")


#: Families of lines, whole atlases being dear: each with its share.
LINES = {
    "massless foot": 0.01,
    "point feet": 0.3,
    "round feet": 0.3,
    "straight, any": 0.1,
    "straight, tuned": 0.2,
    "kneed, any": 0.02,
    "kneed, near": 0.07,
}


def lines(count: int, seed: int = 2, slopes: int = 40, say: Callable[[str], None] | None = None) -> Outcomes:
    """Random walkers' whole lines, as the product runs them: an atlas, and points on slopes over all decades."""
    found, random = Outcomes(), np.random.default_rng(seed)
    want = tuple(v for v in VARIABLES if VARIABLES[v].group not in COSTLY)
    for family, share in LINES.items():
        for walker in _drawn(family, round(share * count), random, found):
            slope = np.sort(np.exp(random.uniform(np.log(MIN_SLOPE), np.log(MAX_SLOPE), slopes)))
            line = {"walker": walker.table(), "set": {}}
            try:
                points = solve_points.points(
                    {"line": line, "slope": slope, "want": want}, [solve_points.atlas({"line": line}, [])]
                )
            except Exception as error:  # any at all is what is sought
                found.add(family, "exception")
                found.wrong.append(f"{type(error).__name__}: {error} ({walker})")
                continue
            _line(family, walker, slope, points, found)
        if say:
            say(f"{family}: {round(share * count):,} lines")
    return found


def _line(family: str, walker: Walker, slope: np.ndarray, points: dict[str, np.ndarray], found: Outcomes) -> None:
    status = points["status"]
    names = {code: name for name, code in STATUSES.items()}
    for i, g in np.argwhere(status[:, :2] != STATUSES["converged"]):
        found.add(family, names[int(status[i, g])])
    for i, g in np.argwhere(status == STATUSES["converged"]):
        found.add(family, f"gait, {GAITS[g]}")
        found.accepted.append(Accepted(family, walker, float(slope[i]), GAITS[g], *(_at(points, i, g))))
        _check(found)
    # A number where there is no gait, or none where there is one, would be a lie.
    known = np.isfinite(points["stance_angle"]) == (status == STATUSES["converged"])
    if not known.all():
        found.wrong.append(f"values and status disagree at slope {slope[np.argwhere(~known)[0][0]]!r} of {walker}")


def _at(points: dict[str, Any], i: int, g: int) -> Iterator[Any]:
    value = {
        name: points[name][i, g].item()
        for name in (
            "stance_angle",
            "stance_rate",
            "thigh_rate",
            "shank_rate",
            "period",
            "spectral_radius",
            "error_bound",
        )
    }
    yield value["stance_angle"]
    yield (value["stance_rate"], value["thigh_rate"], value["shank_rate"])
    yield from (value[k] for k in ("period", "spectral_radius", "error_bound"))
