"""Derivatives of gaits by slope and keys."""

from functools import partial

import mpmath as mp
import numpy as np
import pytest

import extended
import gaitsweep
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.tasks.branches.atlas import from_arrays
from gaitsweep.tasks.charts.sheet import Asked, Sampled, fit_sheets
from gaitsweep.tasks.charts.span import Span
from gaitsweep.tasks.measures.sensitivities import _radius_moved
from gaitsweep.tasks.studies.request import Request
from gaitsweep.tasks.studies.solve_points import atlas, solve_line
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import KEYS

LINK = {
    "l": 0.9,
    "c": 0.4,
    "r": 0.2,
    "m": 5.0,
    "w": 0.01,
    "R": 0.1,
    "m_h": 5.0,
    "g": 9.81,
    "knees": False,
    "units": "SI",
}
#: Kinds of the keys of a leg of one link.
KINDS = {
    **KEYS,
    "l": "length",
    "c": "length",
    "r": "length",
    "w": "length",
    "m": "mass",
}
#: Powers of length, mass and gravity in some measures.
POWERS = {
    "stance_angle": (0, 0, 0),
    "stance_rate": (-0.5, 0, 0.5),
    "period": (0.5, 0, -0.5),
    "speed": (0.5, 0, 0.5),
    "power": (0.5, 1, 1.5),
    "loss_normal": (1, 1, 1),
    "spectral_radius": (0, 0, 0),
    "foot_clearance": (1, 0, 0),
    "least_normal_impulse": (0.5, 1, 0.5),
}


@pytest.mark.parametrize(("walker", "slope"), [("C", 0.02), ("B", 0.01), (LINK, 0.02)])
def test_measures_are_homogeneous_in_lengths_masses_and_gravity(walker, slope):
    """Euler's theorem: sum of p dM/dp over all keys of a dimension = power M."""
    names = list(POWERS)
    found = gaitsweep.sensitivities(walker, slope, variables=names)
    values = gaitsweep.gaits(walker, slope, variables=names)
    table = walker if isinstance(walker, dict) else resolve(walker).table()

    for place, kind in enumerate(("length", "mass", "acceleration")):
        keys = [key for key in found.key.values if KINDS.get(key) == kind]
        own = np.array([table[key] for key in keys])
        if "l" in keys:
            # `R` is changed at a fixed length from the hip to the ground.
            own[keys.index("l")] += table["R"]
        for name, powers in POWERS.items():
            terms = own * found[name].sel(key=keys).values[:2]
            of_gaits = values[name].values[:2]

            off = terms.sum(axis=1) - powers[place] * of_gaits

            size = np.abs(terms).sum(axis=1) + np.abs(of_gaits)
            assert np.abs(off).max() < 1e-8 * size.max(), (kind, name)


@pytest.mark.parametrize(
    ("walker", "slope", "key", "value"),
    [
        ("C", 0.02, "slope", 0.02),
        ("C", 0.02, "w_t", None),
        ("physical", 0.03, "c_s", None),
        ("B", 0.01, "eps_T", None),
        ("A", 0.01, "detuning", 0.25),
        ("E", 0.01, "foot_mass_ratio", 0.05),
        ("E", 0.01, "m_h", 0.0),
    ],
)
def test_derivatives_are_those_of_gaits_that_are_solved_beside(
    walker, slope, key, value
):
    """Differences of single solves; beyond a least value, on one side."""
    names = ["stance_angle", "period", "speed", "loss_normal"]
    changes = {key: value} if value is not None and key != "slope" else {}
    value = getattr(resolve(walker), key) if value is None else value
    found = gaitsweep.sensitivities(
        walker, slope, keys=[] if key == "slope" else [key], variables=names, **changes
    )

    by_difference, values = _differences(walker, slope, names, key, value)

    for name in names:
        exact = found[name].sel(key=key).values[:2]
        gaits = np.isfinite(by_difference[name])
        size = np.abs(exact[gaits]) + np.abs(values[name][gaits])
        off = np.abs(by_difference[name] - exact)[gaits]
        assert gaits.any() and off.max() < 1e-5 * size.max()


def _differences(walker, slope, names, key, value):
    """Derivatives of the first gaits by differences, and values beside; by the hip's
    mass, which is 0, on one side.
    """
    step = 1e-4 * (abs(value) or 0.1)
    places, weights = np.array([-1.0, 1.0]), np.array([-0.5, 0.5])
    if key == "m_h":
        places, weights = np.arange(3.0), np.array([-1.5, 2.0, -0.5])

    varied = value + step * places
    at = {"slope": varied} if key == "slope" else {"slope": slope, key: varied}
    beside = gaitsweep.gaits(walker, variables=names, **at)
    values = {name: beside[name].values[:, :2] for name in names}
    derivatives = {name: weights @ values[name] / step for name in names}
    return derivatives, {name: values[name][0] for name in names}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("walker", "slope", "key"),
    [
        ("B", 0.01, "R"),
        ("B", 0.01, "slope"),
        ("C", 0.02, "slope"),
        ("C", 0.02, "w_s"),
    ],
)
def test_derivatives_are_differences_in_113_bits(walker, slope, key):
    """Of gaits of another derivation: by energies, and momenta of a floating walker."""
    names = ["stance_angle", "stance_rate", "period"]
    keys = [] if key == "slope" else [key]
    found = gaitsweep.sensitivities(walker, slope, keys=keys, variables=names)

    table = {**resolve(walker).table(), "slope": slope}
    gait = next(gaitsweep.solve(walker, slope).itertuples())
    differences = _differences_in_113_bits(table, key, gait)
    exact = found.sel(key=key, gait=gait.gait)
    for name, difference in zip(names, differences, strict=True):
        size = abs(difference) + abs(getattr(gait, name) / table[key])
        assert abs(float(exact[name]) - difference) < 1e-10 * size


def _differences_in_113_bits(table, key, gait):
    """Derivatives of the stance angle, of its rate and of the period of a gait."""
    of_knees = [gait.shank_rate, gait.kneestrike_time] if table["knees"] else []
    state = [
        gait.stance_angle,
        gait.stance_rate,
        gait.thigh_rate,
        *of_knees,
        gait.period,
    ]
    guess = [repr(float(value)) for value in state]

    step = mp.mpf("1e-7")
    beside = []
    for sign in (-1, 1):
        moved = {**table, key: mp.mpf(repr(table[key])) + sign * step}
        _, unknowns, _ = extended.solve(moved, mp.mpf(moved.pop("slope")), guess)
        beside.append(unknowns)

    low, high = ([unknowns[0], unknowns[1], unknowns[-1]] for unknowns in beside)
    return [float((b - a) / (2 * step)) for a, b in zip(low, high, strict=True)]


def test_a_line_of_slopes_is_differentiated_at_once_and_gaits_that_are_none_are_nan():
    slopes = np.array([0.005, 0.02])

    found = gaitsweep.sensitivities("C", slopes, keys=["R"], variables=["period"])

    alone = gaitsweep.sensitivities("C", 0.02, keys=["R"], variables=["period"])
    assert found.period.dims == ("dim_0", "gait", "key")
    assert np.allclose(found.period[1], alone.period, rtol=1e-9, equal_nan=True)
    assert np.isnan(found.period.sel(gait="other1")).all()
    assert found.period.attrs["units"] == "s"
    assert found.key_units.values.tolist() == ["rad", "m"]


def test_keys_that_change_the_unknowns_of_a_gait_are_told():
    found = gaitsweep.sensitivities("D", 0.009, keys=["m_h", "R"], variables=["speed"])

    assert np.isfinite(found.speed.sel(gait="long", key="m_h"))
    assert np.isnan(found.speed.sel(key="R")).all()
    reasons = dict(zip(found.key.values, found.key_reason.values, strict=True))
    assert reasons["m_h"] == "" and reasons["R"].startswith("`R` is special")


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"keys": ["m_q"]}, "`keys` must be of l_t, "),
        ({"variables": ["violations"]}, "`variables` must be a measure of its gaits"),
        ({"slope": [[0.01]]}, "`slope` must have one dimension at most"),
        ({"slope": 2.0}, "`slope` must lie in [1e-18, 0.5) rad"),
        ({"m_q": 1.0}, "`m_q` is not a walker key"),
    ],
)
def test_wrong_questions_are_refused_in_a_line(asked, said):
    with pytest.raises(StudyError) as refused:
        gaitsweep.sensitivities("C", **{"slope": 0.01, **asked})

    assert str(refused.value).startswith(said)


SLOW = pytest.mark.thorough


@pytest.mark.parametrize(
    ("walker", "slope", "keys", "by"),
    [
        ("D", 0.0, {"push_off": 0.1}, ["push_off"]),
        pytest.param("B", -0.005, {"push_off": 0.1}, ["push_off"], marks=SLOW),
        pytest.param(
            "B",
            0.0,
            {"push_off": 0.1, "hip_stiffness": 0.02, "hip_rest": 0.1},
            ["push_off", "hip_stiffness", "hip_rest", "hip_torque", "R"],
            marks=SLOW,
        ),
        pytest.param("C", 0.0, {"hip_torque": 0.02}, ["hip_torque", "R"], marks=SLOW),
    ],
)
def test_gaits_of_driven_walkers_are_differentiated_on_level_ground(
    walker, slope, keys, by
):
    """By differences of single solves, of the slope and of all keys."""
    names = ["stance_angle", "period", "cost_of_transport"]
    found = gaitsweep.sensitivities(walker, slope, keys=by, variables=names, **keys)
    own, h = resolve(walker, keys), 1e-5

    for key in found.key.values.tolist():
        value = slope if key == "slope" else getattr(own, key)
        lower, upper = value - h, value + h
        less, more = (
            gaitsweep.gaits(
                walker,
                other if key == "slope" else slope,
                variables=names,
                **(keys if key == "slope" else {**keys, key: other}),
            )
            for other in (lower, upper)
        )
        for name in names:
            difference = (more[name] - less[name]).sel(gait="long") / (upper - lower)
            exact = found[name].sel(key=key, gait="long")
            np.testing.assert_allclose(exact, difference, rtol=2e-4)


@SLOW
def test_archived_derivatives_on_level_ground_are_those_of_single_calls(tmp_path):
    text = """
name = "s"
walker = "B"
[axes]
slope = [-0.001, 0.0, 0.01]
push_off = [0.1]
[want]
variables = ["stance_angle", "period", "speed", "sensitivities"]
"""
    path = tmp_path / "s.toml"
    path.write_text(text)
    archive = gaitsweep.run(path, jobs=1, archive=tmp_path / "s.nc", quiet=True)

    for slope in archive.slope.values.tolist():
        one = gaitsweep.sensitivities("B", slope, push_off=0.1)
        stored = archive.sel(slope=slope).squeeze()
        for key in ("slope", "R", "m_t"):
            for name in ("period", "speed"):
                np.testing.assert_allclose(
                    stored[f"{name}_by_key"].sel(gait="long", key=key),
                    one[name].sel(gait="long", key=key),
                    rtol=1e-7,
                )


@pytest.mark.parametrize(
    ("walker", "window"),
    [
        ("D", (0.001, 0.015)),
        ("E", (0.005, 0.02)),
        pytest.param("physical-straight", (0.0154, 0.05), marks=SLOW),
        pytest.param("C", (0.01, 0.06), marks=SLOW),
    ],
)
def test_polynomials_of_long_lines_give_the_derivatives_of_single_gaits(walker, window):
    """The physical walker's window begins at a fold. Errors count over the larger of derivative
    and measure; beside meetings of multipliers the radius has larger ones.
    """
    names = ["stance_angle", "period", "loss_normal", "spectral_radius"]
    want = [*names, "sensitivities"]
    slopes = np.linspace(*window, 600)
    long = gaitsweep.gaits(walker, slopes, variables=want)
    few = np.arange(0, 600, 46)

    single = gaitsweep.gaits(walker, slopes[few], variables=want)

    for name in names:
        ours = long[f"{name}_by_key"].values[few, :2]
        theirs = single[f"{name}_by_key"].values[:, :2]
        for by_slope in (ours[..., 0], theirs[..., 0]):
            by_slope *= slopes[few, None]
        np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
        size = np.abs(theirs) + np.abs(single[name].values[:, :2, None])
        assert np.nanmax(np.abs(ours - theirs) / size) < 2e-8
        assert (ours != theirs)[np.isfinite(ours)].any()


def test_derivatives_of_long_lines_do_not_depend_on_how_they_are_cut():
    line = {"walker": "D", "set": {}}
    branches = from_arrays(atlas({"line": line}, []))
    slopes = np.linspace(0.002, 0.012, 40)

    def derivatives(some):
        want = ("period", "period_by_key")
        asked = {"slope": some, "want": want, "charted": True}
        return solve_line(line, branches, Request.of(asked))["period_by_key"]

    parts = [derivatives(some) for some in np.split(slopes, [3, 21])]
    np.testing.assert_array_equal(derivatives(slopes), np.concatenate(parts))


def test_derivatives_of_spectral_radii_do_not_depend_on_gaits_beside():
    """Of complex multipliers some gaits have pairs, others none."""
    random = np.random.default_rng(0)
    jacobian = random.normal(size=(2, 2, 12))
    values = np.linalg.eigvals(jacobian.transpose(2, 0, 1))
    are_real = np.isreal(values).all(axis=1)
    assert are_real.any() and not are_real.all()

    moved = random.normal(size=(2, 2, 3, 12))
    every = _radius_moved(jacobian, moved)

    for lane in range(12):
        alone = _radius_moved(jacobian[..., [lane]], moved[..., [lane]])
        np.testing.assert_array_equal(every[:, [lane]], alone)


def test_violations_of_many_gaits_are_differentiated():
    """More walkers beside than are measured at a time."""
    slopes = np.linspace(0.01, 0.02, 12)
    wanted = ["least_normal_force", "sensitivities"]

    found = gaitsweep.gaits("D", slopes, variables=wanted).least_normal_force_by_key

    alone = gaitsweep.sensitivities("D", slopes[7], variables=["least_normal_force"])
    ours = found.isel(slope=7).sel(gait="long", key=["slope", "l_t", "m_s"])
    theirs = alone.least_normal_force.sel(gait="long", key=["slope", "l_t", "m_s"])
    np.testing.assert_allclose(ours.values, theirs.values, rtol=1e-6)


def test_measures_that_are_not_smooth_have_no_derivative():
    """Massless legs ask as much friction at the end of a step as at its beginning; with
    a foot's mass either grows otherwise.
    """
    names = ["friction_demand", "least_normal_force"]

    found = gaitsweep.sensitivities("D", 0.01, keys=["m_s", "g"], variables=names)

    of_long = found.sel(gait="long")
    assert np.isnan(of_long.friction_demand.sel(key="m_s"))
    assert np.isfinite(of_long.least_normal_force.sel(key="m_s"))
    assert abs(of_long.friction_demand.sel(key="g")) < 1e-9


def test_a_value_that_polynomials_do_not_give_is_refused_alone():
    def solve(asked, points):
        for x in points:
            position = x[:, 0]
            values = np.array(
                [np.exp(position), np.abs(position - 0.1), position * np.nan]
            )
            yield Sampled(values, np.ones(values.shape), 0.0, 1)

    asked = Asked(0, Span.between(np.array([0.0, 1.0]), 0), (16,), (16,))
    at_once = partial(fit_sheets, [asked], solve, 1e-8, lambda half: False)

    (_, sheet), *others = at_once(by_value=True)

    assert not others and sheet.chart is not None
    # No gait has the last one: that is known.
    assert sheet.served.tolist() == [True, False, True]
    assert at_once() == []


@SLOW
@pytest.mark.parametrize("want", [("period", "friction_demand", "spectral_radius")])
def test_measures_that_are_not_smooth_leave_polynomials_to_the_others(want):
    """Of the largest friction two extremes are equal for point feet without mass."""
    line = {"walker": "D", "set": {}}
    branches = from_arrays(atlas({"line": line}, []))
    slopes = np.linspace(0.004, 0.011, 12)
    names = [f"{name}_by_key" for name in want]

    def solved(charted):
        asked = {"slope": slopes, "want": (*want, *names), "charted": charted}
        return solve_line(line, branches, Request.of(asked))

    ours, theirs = solved(True), solved(False)

    for name in names:
        size = (
            np.abs(theirs[name])
            + np.abs(theirs[name.removesuffix("_by_key")])[..., None]
        )
        np.testing.assert_array_equal(np.isnan(ours[name]), np.isnan(theirs[name]))
        assert np.nanmax(np.abs(ours[name] - theirs[name]) / size) < 1e-6
    assert (ours["period_by_key"] != theirs["period_by_key"])[:, 0].any()
