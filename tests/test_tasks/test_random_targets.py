"""Random values of random measures: the gaits from which they are taken are found, and
gaits found have them.
"""

import numpy as np
import pytest

from gaitsweep.tasks.measures.levels import measures
from gaitsweep.tasks.studies.request import Request
from gaitsweep.tasks.studies.solve_at_value import lines
from gaitsweep.tasks.studies.solve_points import solve_lines
from gaitsweep.tasks.walkers.resolve import resolve

WALKERS = (
    "A",
    "B",
    "C",
    "D",
    "E",
    "F",
    "physical",
)


def drawn_values(rng, walker, count):
    """A measure of a walker, and its values at gaits of drawn slopes, with these."""
    names = measures(resolve(walker))
    usual = [name for name in names if not name.endswith("_time")]
    measure = usual[rng.integers(len(usual))]
    log_slope = rng.uniform(np.log(1e-3), np.log(0.1), count)
    slope = np.sort(np.exp(log_slope))

    there = solved(walker, measure, slope)
    row, gait = np.nonzero(there["status"] == 0)
    values = there[measure][row, gait]
    has_value = np.isfinite(values) & (values != 0)
    return measure, values[has_value], slope[row[has_value]]


def solved(walker, measure, slope):
    """Gaits of a walker at slopes."""
    request = Request.of({"slope": slope, "want": (measure,)})
    ((_, there),) = solve_lines([{"walker": walker, "set": {}}], request)
    return there


def sought(walker, measure, values):
    """Gaits of a walker at values: the number of its value, slope and bound of each."""
    line = {"walker": walker, "set": {}}
    request = {
        "lines": [line],
        "at": {"measure": measure},
        "slope": values,
        "want": ("varied", measure),
    }
    ((_, found),) = lines(request, [])

    value, gait = np.nonzero(found["status"] == 0)
    slope = found["varied"][value, gait]
    bound = found["error_bound"][value, gait]
    order = np.argsort(slope)
    return value[order], slope[order], bound[order]


def distance_of_singles(walker, measure, slope, values):
    """How far the nearest gaits of single solves at slopes are from values, without
    their own bounds, over the largest value there.
    """
    single = solved(walker, measure, slope)
    there = single[measure]
    size = np.abs(there[np.isfinite(there)]).max()
    off = np.abs(there - values[:, None]) / size
    return np.nanmin(off - 20 * single["error_bound"], axis=1)


@pytest.mark.thorough
def test_a_measure_that_passes_a_value_through_infinity_does_not_have_it():
    """The short gait's foot leaves along the ground at slope 0.02238, where the ratio of
    its velocities changes its sign through infinity.
    """
    wanted = 0.557168803338194
    value, slope, bound = sought("physical", "velocity_ratio", np.array([wanted]))

    assert len(value) and (bound < 1e-8).all()
    assert (
        distance_of_singles(
            "physical", "velocity_ratio", slope, wanted * np.ones(len(value))
        )
        < 1e-8
    ).all()
    assert not (np.abs(slope / 0.0223799388454 - 1) < 1e-6).any()


@pytest.mark.parametrize(
    "count",
    [
        40,
        pytest.param(1000, marks=[pytest.mark.soak, pytest.mark.timeout(3600)]),
    ],
    ids=["some", "many"],
)
def test_random_targets_are_met_within_their_bounds_by_single_solves(count):
    rng = np.random.default_rng(31)
    targets = 0
    while targets < count:
        walker = WALKERS[rng.integers(len(WALKERS))]
        measure, values, slopes = drawn_values(rng, walker, 5)
        if not len(values):
            continue

        value, slope, bound = sought(walker, measure, values)

        # The gaits of which these are the values are found.
        for number, there in enumerate(slopes):
            nearest = np.abs(slope[value == number] / there - 1).min(initial=1.0)
            # Of five gaits or more of a value, archives hold `long`, `short` and two others.
            is_full = (value == number).sum() >= 3
            assert nearest < 1e-6 or is_full, (walker, measure, values[number], there)

        # All that are found have the values, by a solve of each slope.
        off = distance_of_singles(walker, measure, slope, values[value])
        assert (off <= 20 * bound).all(), (walker, measure)
        assert (bound < 1e-8).all(), (walker, measure)
        targets += len(values)
