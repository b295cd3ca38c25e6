"""Error bounds of random gaits against their errors in extended precision."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.gaits.polish import Guesses, settle
from gaitsweep.tasks.gaits.rounding import reported, reported_sizes, sensitivity
from gaitsweep.tasks.measures.gaits import describe
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.walker import Walker
from soak.extended_reference import convert
from soak.stress import random_walker

#: Slope below which most gaits need residuals in extended precision, and references are
#: expensive [rad].
SMALL = 1e-7
#: Range of slopes [rad].
MIN_SLOPE, MAX_SLOPE = 1e-12, 0.3
#: Share of slopes below `SMALL`.
SHARE = 0.03
WANT = (
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "shank_rate",
    "period",
    "error_bound",
    "status",
)
#: Families of random walkers in addition to the catalogue, and the number of walkers of
#: each.
RANDOM, EACH_FAMILY = (
    ("point feet", "round feet", "straight, any", "straight, tuned", "kneed, near"),
    6,
)


@dataclass
class Bounds:
    """Slope [rad], bound, error and condition number of gaits, and the precision that
    solved them (0: double).
    """

    walker: list[str]
    slope: np.ndarray
    bound: np.ndarray
    error: np.ndarray
    condition: np.ndarray
    tier: np.ndarray

    @property
    def violations(self) -> int:
        """Number of gaits whose error exceeds its bound."""
        return int((self.error > self.bound).sum())

    def rows(self) -> list[dict[str, float | str]]:
        """One row per walker, and one for all."""
        names = np.array(self.walker)
        rows: list[dict[str, float | str]] = []
        for name in [*dict.fromkeys(self.walker), "all"]:
            of = np.ones(len(names), bool) if name == "all" else names == name
            ratio = self.bound[of] / np.maximum(self.error[of], 1e-18)
            rows.append(
                {
                    "walker": name,
                    "gaits": float(of.sum()),
                    "violations": float((ratio < 1).sum()),
                    "median error": float(np.median(self.error[of])),
                    "greatest error": float(self.error[of].max()),
                    "median bound": float(np.median(self.bound[of])),
                    "greatest bound": float(self.bound[of].max()),
                    "median bound/error": float(np.median(ratio)),
                    "least bound/error": float(ratio.min()),
                    "greatest error/(4e-16 condition)": float(
                        (self.error[of] / (4e-16 * self.condition[of])).max()
                    ),
                }
            )
        return rows

    def histogram(self) -> list[dict[str, float | str]]:
        """One row per walker and decade of the slope: how often the bound lies, and how
        tight it is.
        """
        names, decade = (
            np.array(self.walker),
            np.floor(np.log10(self.slope)).astype(int),
        )
        ratio = self.bound / np.maximum(self.error, 1e-18)
        edges = np.array([0.0, *10.0 ** np.arange(5), np.inf])
        words = [
            "error above bound",
            *(f"{10**k} to {10 ** (k + 1)}" for k in range(4)),
            "above 10000",
        ]
        rows: list[dict[str, float | str]] = []
        for name in dict.fromkeys(self.walker):
            for power in np.unique(decade[names == name])[::-1]:
                counts, _ = np.histogram(
                    ratio[(names == name) & (decade == power)], edges
                )
                columns = dict(zip(words, counts.astype(float).tolist(), strict=True))
                rows.append(
                    {
                        "walker": name,
                        "slopes from": f"1e{power}",
                        "gaits": float(counts.sum()),
                        **columns,
                    }
                )
        return rows


def bounds(
    each: int,
    seed: int = 3,
    walkers: Sequence[tuple[str, Walker]] | None = None,
    say: Callable[[str], None] | None = None,
) -> Bounds:
    """Bounds and errors of gaits at random slopes.

    A gait solved in double precision is solved again in long double, whose rounding is
    2000 times finer. One that needed long double is solved in 128 bits. One that needed
    128 bits is compared with the same solution, which tests the rounding to double
    alone.
    """
    if walkers is None:
        drawn = [
            (f, random_walker(f, 10 * seed + k))
            for f in RANDOM
            for k in range(EACH_FAMILY)
        ]
        walkers = [*CATALOGUE.items(), *drawn]
    random = np.random.default_rng(seed)
    rows: list[tuple[str, float, float, float, float, int]] = []
    for name, walker in walkers:
        problem = Problem(walker)
        small = int(np.ceil(SHARE * each))
        slope = np.exp(
            np.concatenate(
                [
                    random.uniform(np.log(SMALL), np.log(MAX_SLOPE), each - small),
                    random.uniform(np.log(MIN_SLOPE), np.log(SMALL), small),
                ]
            )
        )
        for branch in atlases.survey(problem):
            for index, Z, segment in branch.guesses(np.log(slope)):
                rows += [
                    (name, *row)
                    for row in compared(
                        problem, branch.known_guesses(Z, segment, slope[index])
                    )
                ]
        if say:
            say(f"{name}: {len(rows)} gaits so far")
    columns = [np.array(c) for c in zip(*[row[1:] for row in rows], strict=True)]
    return Bounds([row[0] for row in rows], *columns)


def compared(
    problem: Problem, guesses: Guesses
) -> list[tuple[float, float, float, float, int]]:
    """Bounds of converged gaits with their errors."""
    at, slope = settle(problem, guesses), guesses.slope
    product = describe(problem, at, slope, WANT)
    time_unit, rows = _time_unit(problem.walker), []
    near = at.stride.y + at.stride.newton, at.stride.newton_times
    _, values, by_unknowns = reported(
        problem, *near, problem.parameters(slope, at.scale)
    )
    by_image = sensitivity(at.stride, values, by_unknowns) / reported_sizes(values)
    condition = np.maximum(1.0, by_image.max(axis=0) - 1.0)
    for lane in map(int, np.flatnonzero(product["status"] == 0)):
        doubles = at.doubles[lane]
        tier = (
            0
            if doubles <= extended_precision.ESCALATE
            else 1
            if doubles < extended_precision.ESCALATE_AGAIN
            else 2
        )
        near = at.y[:, lane], at.times[:, lane], slope[lane], at.scale[lane]
        start = extended_precision.Start(problem, lane, at.stride, *near)
        gait = extended_precision.solved(start, min(tier, 1))
        if not np.isfinite(gait.error):
            gait = extended_precision.solved(start, 1)
        state, half = (
            convert(gait.state, np.longdouble) * at.scale[lane],
            len(gait.state) // 2,
        )
        period = convert(gait.times[-1:], np.longdouble) * time_unit
        rates = state[half:] / time_unit
        reference = {
            "stance_angle": state[0],
            "stance_rate": rates[0],
            "thigh_rate": rates[1],
            "shank_rate": rates[-1],
            "period": period[0],
        }
        fastest = max(abs(rate) for rate in rates)
        error = max(
            abs(
                float(
                    (np.longdouble(product[k][lane]) - x)
                    / (fastest if k.endswith("rate") else x)
                )
            )
            for k, x in reference.items()
        )
        # Without a reference no bound is shown to hold.
        error = error if np.isfinite(gait.error) else np.inf
        rows.append(
            (
                float(slope[lane]),
                float(product["error_bound"][lane]),
                error,
                float(condition[lane]),
                tier,
            )
        )
    return rows


def _time_unit(walker: Walker) -> np.longdouble:
    """The unit of time sqrt(leg/g), in long double."""
    wide = {
        k: np.longdouble(v)
        for k, v in walker.table().items()
        if isinstance(v, float | int)
    }
    d, sine = wide["l_s"] - wide["R"], wide["l_t"] * np.sin(wide["eps_T"])
    leg = (
        wide["l_t"] * np.cos(wide["eps_T"])
        + np.sign(d) * np.sqrt(d * d - sine * sine)
        + wide["R"]
    )
    return np.sqrt(leg / wide["g"])
