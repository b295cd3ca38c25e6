"""`solve`, which surveys for one slope, and `gaits`, which surveys for many, give one
answer at every slope.
"""

import numpy as np
import pytest

import gaitsweep
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.tasks.branches import atlas
from gaitsweep.tasks.contract.registry import GAITS, SLOPES, STATUSES, VARIABLES
from gaitsweep.tasks.studies import solve_at_slope
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.walkers.catalogue import CATALOGUE

#: Rates at the start of a step, whose errors count over the largest of them.
RATES = ("stance_rate", "thigh_rate", "shank_rate")
#: Exponents of the stance angle in the slope at vanishing slopes, long and short; D's
#: short gaits have feet of no mass.
LAWS = {
    "A": (1 / 3, 1),
    "B": (1 / 3, 1),
    "C": (1, 1),
    "D": (1 / 3, 1 / 3),
    "E": (1 / 3, 1),
    "F": (1 / 3, 1),
}
#: Cases of the long test by walker, and slopes of each: so many that their branches are
#: finer than those of `solve`.
CASES, AT_ONCE = 4, 300


def drawn(seed, n):
    """Slopes over all that can be asked for, half of them in ln slope, half among the
    largest.
    """
    random = np.random.default_rng(seed)
    low = np.exp(random.uniform(*np.log(SLOPES), n - n // 2))
    return np.sort(np.append(low, random.uniform(1e-3, SLOPES[1], n // 2)))


def differences(walker, slopes):
    """What `solve` and `gaits` answer differently, and the number of gaits with the
    farthest distance over bounds.
    """
    found = gaitsweep.gaits(walker, slopes)
    names = {code: name for name, code in STATUSES.items()}
    different, count, farthest = [], 0, 0.0
    for k, slope in enumerate(slopes.tolist()):
        one, at = (
            {
                gait["gait"]: gait
                for gait in solve_one({"walker": walker, "slope": slope})["gaits"]
            },
            found.isel(slope=k),
        )
        status = {
            g: names[int(s)] for g, s in zip(GAITS, at.status.values, strict=True)
        }
        expected = {g: s for g, s in status.items() if s != "no_gait"}
        if {g: gait["status"] for g, gait in one.items()} != expected:
            different.append((walker, slope, list(one), expected))
            continue
        for label, gait in one.items():
            other = at.isel(gait=GAITS.index(label))
            size = np.abs([gait[name] for name in RATES]).max()
            off = [
                abs(gait[name] - float(other[name])) / gait[name]
                for name in ("stance_angle", "period")
            ]
            off += [abs(gait[name] - float(other[name])) / size for name in RATES]
            ratio = max(off) / (gait["error_bound"] + float(other.error_bound))
            count, farthest = count + 1, max(farthest, ratio)
            if not ratio <= 1:
                different.append((walker, slope, label, ratio))
    return different, count, farthest


@pytest.fixture
def one_survey(monkeypatch):
    """Surveys by `solve`, which depend on the walker alone, once for each."""
    survey, kept = atlas.survey, {}

    def found(problem, tolerance):
        if problem.walker not in kept:
            kept[problem.walker] = survey(problem, tolerance)
        return kept[problem.walker]

    monkeypatch.setattr(atlas, "survey", found)


@pytest.mark.parametrize("walker", ["D", "E", "physical-straight"])
def test_solve_and_gaits_answer_alike_down_to_the_least_slope(walker, one_survey):
    different, count, _ = differences(walker, np.append(SLOPES[0], drawn(1, 9)))
    assert not different and count > 3


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_solve_and_gaits_answer_alike_at_ten_thousand_slopes(
    one_survey, tell, resumed, monkeypatch
):
    # Half of the time of one `solve` goes into violations, which are not compared.
    wanted = tuple(
        name for name in solve_at_slope.WANT if VARIABLES[name].group != "violations"
    )
    monkeypatch.setattr(solve_at_slope, "WANT", wanted)
    walkers = sorted(CATALOGUE)
    for case in resumed(CASES * len(walkers)):
        walker = walkers[case // CASES]
        different, count, farthest = differences(walker, drawn(case, AT_ONCE))
        resumed.found["gaits"] += count
        resumed.found["slopes"] += AT_ONCE
        resumed.found["thousandths"] = max(
            resumed.found["thousandths"], round(1000 * farthest)
        )
        tell(f"{resumed.state}: {dict(resumed.found)}")
        assert not different, different


@pytest.mark.parametrize("walker", LAWS)
def test_gaits_down_to_the_least_slope_follow_the_laws(walker):
    slopes = np.array([SLOPES[0], 1e-17, 1e-15, 2e-14, 1e-13])
    found = gaitsweep.gaits(walker, slopes)
    for label, law in zip(GAITS, LAWS[walker], strict=False):
        gait = found.sel(gait=label)
        assert (
            gait.status == STATUSES["converged"]
        ).all() and gait.error_bound.max() < 1e-11
        exponent = np.diff(np.log(gait.stance_angle.values)) / np.diff(np.log(slopes))
        # The next term of the laws is smaller by slope^(2/3).
        np.testing.assert_allclose(exponent, law, rtol=1e-8)


def test_steps_as_short_as_the_least_slope_makes_them_are_followed():
    """Steps were taken to vanish where their angle was below e^-40."""
    found = gaitsweep.gaits("B", SLOPES[0], R=0.3533, m_s=1.0).sel(gait="short")
    assert found.status == STATUSES["converged"] and found.stance_angle < 2 * SLOPES[0]


def test_a_slope_below_the_least_is_refused_by_every_entry_in_one_sentence():
    below = 9e-19
    state = (0.1, -0.1, 0.1)
    asked = [
        lambda: gaitsweep.solve("D", below),
        lambda: gaitsweep.gaits("D", below),
        lambda: gaitsweep.step_map("D", below, state),
        lambda: gaitsweep.simulate("D", below, state, 1),
        lambda: gaitsweep.run(
            {"name": "s", "walker": "D", "axes": {"slope": [0.1, below]}}
        ),
    ]
    for each in asked:
        with pytest.raises(
            StudyError, match=r"`slope` must lie in \[1e-18, 0.5\) rad; got 9e-19"
        ):
            each()
