"""Counted outcomes of random walkers, slopes and initial guesses, far beyond those of
the paper.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gaitsweep.tasks.contract.registry import COSTLY, GAITS, STATUSES, VARIABLES
from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.gaits.polish import settle, unmeasured
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.mechanics.kernel import flow
from gaitsweep.tasks.mechanics.lumped import structures_of
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.studies import solve_points
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Lanes solved together.
BLOCK = 4096
#: Range of the random slopes [rad].
MIN_SLOPE, MAX_SLOPE = 1e-12, 0.3
Random = np.random.Generator


@dataclass(frozen=True)
class Accepted:
    """An accepted gait, in the walker's units, with the family of its walker."""

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
    """Outcomes of random tries: counts by family and outcome, accepted gaits, and the
    number of steps integrated.
    """

    counts: dict[str, Counter[str]] = field(default_factory=dict)
    accepted: list[Accepted] = field(default_factory=list)
    strides: int = 0
    #: Tries that ended unexpectedly, which are bugs.
    wrong: list[str] = field(default_factory=list)

    @property
    def tries(self) -> int:
        """Number of tries."""
        return sum(sum(of.values()) for of in self.counts.values())

    def add(self, family: str, outcome: str, times: int = 1) -> None:
        """Count an outcome."""
        self.counts.setdefault(family, Counter())[outcome] += times

    def rows(self) -> list[dict[str, float | str]]:
        """The table, with one row per outcome and one column per family."""
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
            f"{row['outcome']:<{width}} "
            + " ".join(f"{int(v):>16,}" for k, v in row.items() if k != "outcome")
            for row in rows
        ]
        return "\n".join([" " * width + " " + head, *body])


def _log(random: Random, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _mass(random: Random) -> float:
    return _log(random, 1e-8, 1.0)


def _any(random: Random, knees: bool) -> Walker:
    """A walker with every key drawn from a broad range; some draws are refused."""
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
    """The walker with its centres of mass moved to meet the static conditions of the
    paper's section 5.1.
    """
    if walker.m_s > walker.m_t:
        # A light thigh could balance a heavy shank only from several leg lengths away.
        walker = replace(walker, m_t=walker.m_s)
    w_s = float(walker.c_s * np.tan(walker.eps_S))
    w_t = float(
        -np.tan(walker.eps_T) * (walker.c_t + walker.m_s * walker.l_t / walker.m_t)
    )
    return replace(walker, w_t=w_t, w_s=w_s)


def _near(random: Random, name: str) -> Walker:
    """A walker at a random detuning, half of the time with keys changed by up to a
    fifth.
    """
    walker = resolve(
        name, {"detuning": float(random.choice([0.0, 1.0, random.uniform(-1, 3)]))}
    )
    if random.random() < 0.5:
        keys = ("m_t", "m_s", "r_t", "r_s", "c_t", "c_s", "R", "eps_T")
        walker = replace(
            walker,
            **{k: getattr(walker, k) * float(random.uniform(0.8, 1.2)) for k in keys},
        )
    return _tuned(walker) if random.random() < 0.5 else walker


#: Each family's name, its share of the tries and a draw from it.
FAMILIES: dict[str, tuple[float, Callable[[Random], Walker]]] = {
    "massless foot": (0.05, lambda random: CATALOGUE["D"]),
    "point feet": (
        0.25,
        lambda random: replace(
            CATALOGUE["E"],
            m_s=_mass(random),
            m_t=_mass(random) if random.random() < 0.5 else 1.0,
            m_h=_mass(random),
        ),
    ),
    "round feet": (
        0.25,
        lambda random: replace(
            CATALOGUE["B"], m_s=_mass(random), R=float(random.uniform(0, 0.95))
        ),
    ),
    "straight, any": (0.15, lambda random: _any(random, False)),
    "straight, tuned": (
        0.15,
        lambda random: (
            _tuned(_any(random, False)) if random.random() < 0.5 else _near(random, "A")
        ),
    ),
    "kneed, any": (0.05, lambda random: _any(random, True)),
    "kneed, near": (0.10, lambda random: _near(random, "C")),
}


def random_walker(family: str, seed: int) -> Walker:
    """Draw from a family, with a seed, until a walker is accepted."""
    outcomes = Outcomes()
    random = np.random.default_rng(seed)
    while True:
        for walker in _draw(family, 1, random, outcomes):
            return walker


def _draw(family: str, count: int, random: Random, outcomes: Outcomes) -> list[Walker]:
    """Draw walkers of a family; refused draws are counted by the refused key."""
    walkers = []
    for _ in range(count):
        try:
            walkers.append(FAMILIES[family][1](random))
        except WalkerError as error:
            outcomes.add(family, f"refused: {error.key}")
    return walkers


def _starts(problem: Lanes, slope: np.ndarray, random: Random) -> np.ndarray:
    """Initial guesses around the lattice of the search, one in five far from any gait;
    shape (m + phases, n).
    """
    n = len(slope)
    far = random.random(n) < 0.2
    period = np.where(far, random.uniform(0.05, 12, n), random.uniform(1.8, 4.2, n))
    top = np.log(np.minimum(2.5 * slope ** (1 / 3), 0.7))
    log_angle = np.where(
        far, random.uniform(-30, 0, n), random.uniform(np.log(slope), top)
    )
    rate = np.where(
        far,
        random.normal(0, 10, n),
        -1.0 / np.tanh(period / 2) * random.uniform(0.8, 1.2, n),
    )
    rows = [log_angle, rate]
    if problem.m == 3:
        rows.append(np.where(far, random.normal(0, 10, n), random.uniform(-1, 1, n)))
    if problem.phases == 2:
        rows.append(period * random.uniform(0.3, 1.0, n))
    return np.vstack([*rows, period])


def lanes(
    count: int, seed: int = 1, say: Callable[[str], None] | None = None
) -> Outcomes:
    """Outcomes of Newton's method, step check and error bound for random walkers and
    guesses, one walker per lane.
    """
    outcomes, random = Outcomes(), np.random.default_rng(seed)
    for family, (share, _) in FAMILIES.items():
        todo = round(share * count)
        for k in range(0, todo, BLOCK):
            walkers = _draw(family, min(BLOCK, todo - k), random, outcomes)
            structures = structures_of(walkers)
            for structure in dict.fromkeys(structures):
                alike = [
                    walker
                    for walker, other in zip(walkers, structures, strict=True)
                    if other == structure
                ]
                _lanes(family, Lanes(alike, structure), random, outcomes)
        if say:
            say(f"{family}: {todo:,} lanes")
    return outcomes


def _lanes(family: str, problem: Lanes, random: Random, outcomes: Outcomes) -> None:
    n, m = len(problem.walkers), problem.m
    slope = np.exp(random.uniform(np.log(MIN_SLOPE), np.log(MAX_SLOPE), n))
    before = _strides(problem)
    start = _starts(problem, slope, random)
    w, found = newton(problem, start, np.log(slope))
    converged = np.nonzero(found)[0]
    outcomes.add(family, "Newton did not converge", n - len(converged))
    if len(converged):
        lanes, slope, w = problem.some(converged), slope[converged], w[:, converged]
        at = settle(lanes, unmeasured(lanes, w, slope))
        ratio, largest = (
            gait_ratio(at.stride),
            np.abs(multipliers(at.stride.jacobian, m)).max(axis=1),
        )
        for i in range(len(converged)):
            outcome = _outcome(
                bool(at.converged[i]),
                bool(at.step[i]),
                int(at.leg_passes[i]),
                float(ratio[i]),
            )
            outcomes.add(family, outcome)
            if outcome in ("gait, long", "gait, short"):
                walker = lanes.walker_of(i)
                time_unit = float(np.sqrt(walker.leg / walker.g))
                state = at.state[:, i] * at.scale[i]
                half = len(state) // 2
                rates = state[half:] / time_unit
                outcomes.accepted.append(
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
                _check(outcomes)
    outcomes.strides += _strides(problem) - before


def _strides(problem: Lanes) -> int:
    """Steps integrated so far with a structure's exact flow; with knees, each begins
    with a free one.
    """
    return flow(problem.structure, problem.m, False).evaluations


def _outcome(converged: bool, step: bool, leg_passes: int, ratio: float) -> str:
    if not converged:
        return "too ill-conditioned for a bound"
    if not step:
        return "solution that is no step"
    if leg_passes != 1:
        return (
            f"step, legs pass {leg_passes} times"
            if leg_passes < 4
            else "step, legs pass 4 times or more"
        )
    return "gait, long" if ratio < 0.5 else "gait, short"


def _check(outcomes: Outcomes) -> None:
    """Check that the numbers of the last accepted gait are finite and possible."""
    gait = outcomes.accepted[-1]
    numbers = (gait.angle, *gait.rates, gait.period, gait.multiplier, gait.bound)
    if (
        not np.isfinite(numbers).all()
        or gait.angle <= 0
        or gait.period <= 0
        or not 0 < gait.bound < 1e-3
    ):
        outcomes.wrong.append(f"{gait}")


#: Families for whole lines, whose atlases are expensive, with their shares.
LINES = {
    "massless foot": 0.01,
    "point feet": 0.3,
    "round feet": 0.3,
    "straight, any": 0.1,
    "straight, tuned": 0.2,
    "kneed, any": 0.02,
    "kneed, near": 0.07,
}


def lines(
    count: int,
    seed: int = 2,
    slopes: int = 40,
    say: Callable[[str], None] | None = None,
) -> Outcomes:
    """Outcomes of random walkers' whole lines as in a study: an atlas, and points at
    slopes over all decades.
    """
    outcomes, random = Outcomes(), np.random.default_rng(seed)
    want = tuple(v for v in VARIABLES if VARIABLES[v].group not in COSTLY)
    for family, share in LINES.items():
        for walker in _draw(family, round(share * count), random, outcomes):
            slope = np.sort(
                np.exp(random.uniform(np.log(MIN_SLOPE), np.log(MAX_SLOPE), slopes))
            )
            line = {"walker": walker.table(), "set": {}}
            try:
                points = solve_points.points(
                    {"line": line, "slope": slope, "want": want},
                    [solve_points.atlas({"line": line}, [])],
                )
            except Exception as error:  # any exception is a bug
                outcomes.add(family, "exception")
                outcomes.wrong.append(f"{type(error).__name__}: {error} ({walker})")
                continue
            _line(family, walker, slope, points, outcomes)
        if say:
            say(f"{family}: {round(share * count):,} lines")
    return outcomes


def _line(
    family: str,
    walker: Walker,
    slope: np.ndarray,
    points: dict[str, np.ndarray],
    outcomes: Outcomes,
) -> None:
    status = points["status"]
    names = {code: name for name, code in STATUSES.items()}
    for i, g in np.argwhere(status[:, :2] != STATUSES["converged"]):
        outcomes.add(family, names[int(status[i, g])])
    for i, g in np.argwhere(status == STATUSES["converged"]):
        outcomes.add(family, f"gait, {GAITS[g]}")
        outcomes.accepted.append(
            Accepted(family, walker, float(slope[i]), GAITS[g], *(_at(points, i, g)))
        )
        _check(outcomes)
    # There must be a number exactly where there is a gait.
    consistent = np.isfinite(points["stance_angle"]) == (
        status == STATUSES["converged"]
    )
    if not consistent.all():
        at = slope[np.argwhere(~consistent)[0][0]]
        outcomes.wrong.append(f"values and status disagree at slope {at!r} of {walker}")


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
