"""`gaitsweep.gaits`: arrays in, gaits out, as a study finds them."""

import dataclasses
import json

import mpmath as mp
import netCDF4
import numpy as np
import pytest
import xarray as xr

import gaitsweep
from gaitsweep.pipeline.api import in_memory
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.statuses import ALL_STATUSES
from gaitsweep.pipeline.store.memory import Memory
from gaitsweep.tasks.contract.registry import TASKS
from gaitsweep.tasks.studies import solve_points
from gaitsweep.tasks.walkers.catalogue import CATALOGUE

SLOPES = np.geomspace(0.004, 0.05, 4)
RAISED, CONVERGED = ALL_STATUSES["raised"], ALL_STATUSES["converged"]


def same(a, b):
    return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


def near(a, b):
    """Whether numbers differ by rounding alone: few points are solved by other code than
    those of archives.
    """
    if a.dtype.kind != "f":
        return same(a, b)
    return np.allclose(a, b, rtol=1e-11, atol=1e-11, equal_nan=True)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The archive of a study, as any program reads it."""
    path = tmp_path_factory.mktemp("study") / "study.nc"
    axes = {"slope": SLOPES, "R": [0.0, 0.2, 0.3]}
    gaitsweep.run(
        {"name": "study", "walker": "E", "axes": axes}, jobs=1, archive=path, quiet=True
    )
    return xr.load_dataset(path)


def test_it_holds_what_the_archive_of_a_study_holds(study, tmp_path):
    slope, radius = (
        xr.DataArray(study[n].values, dims=n, coords={n: study[n].values})
        for n in ("slope", "R")
    )
    answer = gaitsweep.gaits("E", slope, R=radius)
    assert list(answer.data_vars) == list(study.data_vars) and answer.sizes["gait"] == 4
    (tmp_path / "here").mkdir()
    answer.to_netcdf(tmp_path / "here" / "answer.nc")
    with netCDF4.Dataset(tmp_path / "here" / "answer.nc") as file:
        assert file["gait"].dtype == file["reason_text"].dtype == "S1"
    for dataset in (answer, xr.load_dataset(tmp_path / "here" / "answer.nc")):
        for name, stored in study.variables.items():
            values = (
                dataset[name].isel(gait=slice(study.sizes["gait"]))
                if "gait" in stored.dims
                else dataset[name]
            )
            assert values.dims == stored.dims, name
            # Of strings some are objects.
            assert values.dtype == stored.dtype or {
                values.dtype.kind,
                stored.dtype.kind,
            } <= set("OU"), name
            assert near(values.values, stored.values), name
            assert {k: str(v) for k, v in values.attrs.items()} == {
                k: str(v) for k, v in stored.attrs.items()
            }, name
        assert (
            dataset.attrs["m_s"] == 0.1
            and dataset.attrs["knees"] == "false"
            and "R" not in dataset.attrs
        )


def test_arrays_broadcast_by_the_rules_of_numpy():
    radii = np.array([[0.0], [0.2]])
    answer = gaitsweep.gaits(
        "E", SLOPES, R=radii, m_h=0.1, variables=["period", "multipliers"]
    )
    assert answer.period.dims == ("dim_0", "slope", "gait") and answer.period.shape == (
        2,
        4,
        4,
    )
    assert answer.multiplier_real.dims == (*answer.period.dims, "multiplier")
    assert (
        answer.R.dims == ("dim_0",)
        and answer.slope.dims == ("slope",)
        and answer.attrs["m_h"] == 0.1
    )
    one = gaitsweep.gaits("E", SLOPES[2], R=0.2, m_h=0.1)
    assert one.period.dims == ("gait",) and same(
        one.period.values, answer.period.values[1, 2]
    )
    pairs = gaitsweep.gaits("E", SLOPES[[2, 0]], R=[0.2, 0.0], m_h=0.1)
    assert same(pairs.period.values, answer.period.values[[1, 0], [2, 0]])
    assert gaitsweep.gaits("E", []).period.shape == (0, 4)


def test_an_array_of_slopes_is_an_axis(tmp_path):
    answer = gaitsweep.gaits("E", list(SLOPES), variables=["period"])
    assert answer.period.dims == ("slope", "gait") and answer.slope.units == "rad"
    assert same(answer.period.sel(slope=SLOPES[2]).values, answer.period.values[2])
    answer.to_netcdf(tmp_path / "answer.nc")
    assert same(xr.load_dataset(tmp_path / "answer.nc").slope.values, SLOPES)
    words = np.array(answer.status.flag_meanings.split())[
        answer.status
    ]  # as docs/python.md shows
    assert words[0].tolist() == ["converged", "converged", "no_gait", "no_gait"]
    pairs = gaitsweep.gaits("E", SLOPES[:2], R=[0.1, 0.2], variables=["period"])
    assert pairs.period.dims == ("slope", "gait") and pairs.R.dims == ("slope",)
    # Of one slope among several radii, and of slopes in rows and columns, nothing is an
    # axis.
    assert gaitsweep.gaits(
        "E", [0.01], R=[0.1, 0.2], variables=["period"]
    ).period.dims == ("dim_0", "gait")
    assert gaitsweep.gaits(
        "E", SLOPES.reshape(2, 2), variables=["period"]
    ).period.dims == ("dim_0", "dim_1", "gait")


def test_slopes_may_come_in_any_order_and_twice():
    slopes = [0.05, 0.02, 0.01, 0.05, 0.03]  # below 0.015 this walker has no gait
    answer = gaitsweep.gaits("physical-straight", slopes)
    assert (answer.status.values[:, 0] == CONVERGED).tolist() == [
        True,
        True,
        False,
        True,
        True,
    ]
    for k, slope in enumerate(slopes):
        alone = gaitsweep.gaits("physical-straight", slope)
        for name in ("stance_angle", "multiplier_real", "status", "error_bound"):
            assert same(answer[name].values[k], alone[name].values), name
        assert (
            answer.reason_text.values[answer.reason.values[k]]
            == alone.reason_text.values[alone.reason.values]
        ).all()


def test_keys_that_a_derived_one_moves_are_no_constants():
    attrs = gaitsweep.gaits("E", 0.01, foot_mass_ratio=[0.05, 0.1]).attrs
    assert (
        not {"m_s", "m_t", "m_h", "foot_mass_ratio"} & set(attrs) and attrs["R"] == 0.0
    )
    assert gaitsweep.gaits("E", 0.01, foot_mass_ratio=0.05).attrs["m_s"] == 0.05


@pytest.mark.parametrize(
    ("walker", "key", "values"),
    [("A", "detuning", [0.0, 0.5]), ("E", "foot_mass_ratio", [0.1])],
)
def test_keys_that_a_derived_one_moves_are_variables_along_it_as_in_an_archive(
    tmp_path, walker, key, values
):
    axes, path = {"slope": [0.02], key: values}, tmp_path / "s.nc"
    study = {
        "name": "s",
        "walker": walker,
        "axes": axes,
        "want": {"variables": ["period"]},
    }
    gaitsweep.run(study, jobs=1, archive=path, quiet=True)
    stored = xr.load_dataset(path)

    answer = gaitsweep.gaits(
        walker, [0.02], variables=["period"], **{key: xr.DataArray(values, dims=key)}
    )

    moved = [name for name in stored.data_vars if stored[name].dims == (key,)]
    assert (
        moved
        == {"A": ["w_t", "r_t", "c_t", "w_s", "r_s"], "E": ["m_t", "m_s", "m_h"]}[
            walker
        ]
    )
    assert list(answer.data_vars) == list(stored.data_vars)
    for name in moved:
        assert answer[name].dims == (key,) and answer[name].attrs == stored[name].attrs
        np.testing.assert_array_equal(answer[name], stored[name])


def test_keys_that_are_tuned_anew_are_variables_along_all_that_move_them():
    walker = {"base": "A", "tuned": ["w_t"]}
    radius, centre = (
        xr.DataArray([0.1, 0.2], dims="foot"),
        xr.DataArray([0.1, 0.12, 0.14], dims="thigh"),
    )

    answer = gaitsweep.gaits(
        walker, 0.02, R=radius, c_t=centre, m_h=[1.0, 2.0], variables=["period"]
    )

    assert answer.w_t.dims == ("foot", "thigh")
    one = gaitsweep.gaits(walker, 0.02, R=0.2, c_t=0.12, variables=["period"])
    assert answer.w_t.values[1, 1] == one.attrs["w_t"]


def test_exact_offsets_of_a_tuned_walker_are_stated():
    """With its offsets in doubles it would be another walker, which does not walk at
    vanishing slopes.
    """
    with mp.workdps(60):
        key = {
            name: mp.mpf(value)
            for name, value in CATALOGUE["C"].table().items()
            if isinstance(value, float)
        }
        lean = mp.asin(key["l_t"] * mp.sin(key["eps_T"]) / (key["l_s"] - key["R"]))
        exact = {"w_s": key["c_s"] * mp.tan(lean)}
        arm = key["c_t"] + key["m_s"] / key["m_t"] * key["l_t"]
        exact["w_t"] = -mp.tan(key["eps_T"]) * arm
        wanted = {name: mp.nstr(value, 35) for name, value in exact.items()}

    stated = json.loads(
        gaitsweep.gaits("C", 0.02, m_h=[0.0, 1.0], variables=["period"]).attrs[
            "exact_offsets"
        ]
    )

    assert {
        name: str(value)[: len(wanted[name]) - 1] for name, value in stated.items()
    } == {name: value[:-1] for name, value in wanted.items()}
    for walker, keys in (
        ("C-printed", {}),
        ("B", {}),
        ("A", {"detuning": 0.5}),
        ("A", {"R": 0.1}),
        ("C", {"R": [0.2]}),
    ):
        assert (
            "exact_offsets"
            not in gaitsweep.gaits(walker, 0.02, variables=["period"], **keys).attrs
        )


def test_exact_offsets_are_stated_of_each_walker_of_an_archive(tmp_path):
    study = {
        "name": "s",
        "walker": ["A", "E", "C"],
        "axes": {"slope": [0.02]},
        "want": {"variables": ["period"]},
    }

    gaitsweep.run(study, jobs=1, archive=tmp_path / "s.nc", quiet=True)

    stated = json.loads(xr.load_dataset(tmp_path / "s.nc").attrs["exact_offsets"])
    assert stated.keys() == {"A", "C"} and stated["A"].keys() == {"w_t"}
    assert stated["A"] == json.loads(
        gaitsweep.gaits("A", 0.02, variables=["period"]).attrs["exact_offsets"]
    )
    assert (
        float(stated["A"]["w_t"]) == CATALOGUE["A"].w_t
        and stated["A"]["w_t"] != stated["C"]["w_t"]
    )


def test_data_arrays_keep_their_dimensions():
    slope = xr.DataArray(SLOPES, dims="place", coords={"place": list("abcd")})
    answer = gaitsweep.gaits(
        "E", slope, R=xr.DataArray([0.1, 0.2, 0.3], dims="foot"), variables=["period"]
    )
    assert answer.period.dims == ("place", "foot", "gait") and list(
        answer.place
    ) == list("abcd")
    assert "period" in answer and "speed" not in answer and answer.slope.units == "rad"
    alone = gaitsweep.gaits("E", SLOPES[1], R=0.3)
    assert same(answer.period.sel(place="b").isel(foot=2).values, alone.period.values)


def test_a_point_that_cannot_be_has_a_status_and_a_sentence():
    answer = gaitsweep.gaits("E", [0.01, np.nan, 0.7], R=[[0.1], [-1.0], [np.nan]])
    assert (answer.status.values[0, 0, :2] == CONVERGED).all()
    assert (np.delete(answer.status.values.reshape(9, 4), 0, axis=0) == RAISED).all()
    text = answer.reason_text.values[answer.reason.values[..., 0]]
    assert text[0, 1] == "`slope` must lie in [1e-18, 0.5) rad; got nan." and text[
        0, 2
    ].endswith("got 0.7.")
    assert (
        text[1, 0] == "`R` must be >= 0; got -1.0."
        and text[2, 0] == "`R` must be finite; got nan."
    )
    assert np.isnan(answer.period.values.reshape(9, 4)[1:]).all()


def test_a_wrong_walker_on_level_ground_is_told_by_its_own_key():
    found = gaitsweep.gaits("B", 0.0, push_off=0.1, m_t=np.array([0.4, -1.0]))

    reasons = found["reason_text"].values[found["reason"].values[1]]
    assert all("`m_t` must be >= 0" in str(reason) for reason in reasons)


def test_masses_that_are_all_scaled_at_some_points_of_a_plane_are_solved_there():
    """Of these points keys that change only units are no keys of their lines."""
    m_t = 0.4 * np.array([0.9, 1.0, 1.1])[:, None]
    m_s = 0.1 * np.array([1.0, 0.9, 1.1])

    found = gaitsweep.gaits("B", 0.01, m_t=m_t, m_s=m_s)

    alone = [gaitsweep.gaits("B", 0.01, m_t=m_t[i, 0], m_s=m_s[i]) for i in range(3)]
    for i, single in enumerate(alone):
        own = found.isel(dim_0=i, dim_1=i)
        assert (own["status"].values[:2] == 0).all()
        np.testing.assert_allclose(
            own["stance_angle"].values, single["stance_angle"].values, rtol=1e-12
        )


def test_masked_values_are_missing():
    answer = gaitsweep.gaits("E", np.ma.masked_array([0.01, 0.02], [False, True]))
    assert answer.status.values[:, 0].tolist() == [CONVERGED, RAISED]


def test_knees_may_vary_and_multipliers_are_padded():
    answer = gaitsweep.gaits("C", 0.02, knees=[True, False])
    assert (
        answer.sizes["multiplier"] == 4
        and np.isnan(answer.multiplier_real.values[1, :, 3]).all()
    )
    assert np.isfinite(answer.kneestrike_time.values[0, 0]) and np.isnan(
        answer.kneestrike_time.values[1, 0]
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            {"slope": [0.01, 0.02], "R": [0.1, 0.2, 0.3]},
            r"Shapes do not broadcast: `slope` \(2,\), `R` \(3,\).",
        ),
        ({"slope": np.nan}, r"`slope` must lie in \[1e-18, 0.5\) rad; got nan"),
        ({"slope": [0.7, -1.0]}, r"`slope` must lie in \[1e-18, 0.5\) rad; got 0.7"),
        ({"slope": [[0.01], [0.02, 0.03]]}, "`slope` must be a number or an array"),
        (
            {"slope": xr.Dataset({"a": 1})},
            "`slope` must be a number or an array of numbers; got Dataset",
        ),
        (
            {"slope": xr.DataArray([0.01, 0.02], dims="R"), "R": [0.1, 0.2]},
            "`R` is the name of a dimension, along which it does not vary alone",
        ),
        ({"slope": 0.01 + 0j}, "`slope` must be a number or an array"),
        (
            {"slope": 0.01, "R": "wide"},
            "`R` must be a number or an array of numbers; got 'wide'",
        ),
        ({"slope": 0.01, "R": [-1.0, -2.0]}, "`R` must be >= 0; got -1.0"),
        ({"slope": 0.01, "radius": 0.1}, "`radius` is not a walker key"),
        ({"slope": 0.01, "knees": 1}, "`knees` must be true or false"),
        (
            {"slope": 0.01, "steps": 0},
            "`steps` must be a whole number from 1 to 64; got 0",
        ),
        (
            {"slope": 0.01, "steps": 65},
            "`steps` must be a whole number from 1 to 64; got 65",
        ),
        (
            {"slope": 0.01, "steps": 2, "variables": ["proofs"]},
            "`proved` is of gaits of one step, and `steps` is 2",
        ),
        ({"slope": 0.01, "steps": True}, "`steps` must be a whole number"),
        (
            {"slope": 0.01, "accuracy": 1},
            r"`accuracy` must lie in \[1e-15, 0.01\]; got 1",
        ),
        ({"slope": 0.01, "variables": ["weight"]}, "Unknown name `weight`"),
        (
            {"slope": 0.01, "walker": 3},
            "`walker` must be a name, a file or a table; got int",
        ),
        (
            {"slope": 0.01, "walker": np.zeros(2)},
            "`walker` must be a name, a file or a table; got an array of float64",
        ),
        ({"slope": 0.01, "walker": "G"}, "Unknown name `G`"),
        ({"slope": 0.01, "walker": "no.toml"}, "There is no file no.toml"),
        ({"slope": 0.01, "walker": {"base": "E", "R": [0.1]}}, "`R` must be a number"),
        (
            {"slope": xr.DataArray([0.01], dims="gait")},
            "`slope` has a dimension or coordinate `gait`",
        ),
        (
            {
                "slope": xr.DataArray([0.01, 0.02], dims="a"),
                "R": xr.DataArray([0.1, 0.2, 0.3], dims="a"),
            },
            "The DataArrays do not fit each other: .*'a'",
        ),
        (
            {
                "slope": xr.DataArray([0.01, 0.02], dims="a", coords={"a": [1, 2]}),
                "R": xr.DataArray([0.1, 0.2], dims="a", coords={"a": [1, 3]}),
            },
            "The DataArrays do not fit each other: .*'a'",
        ),
    ],
)
def test_wrong_input_is_one_sentence(arguments, words):
    with pytest.raises(StudyError, match=f"^{words}") as caught:
        gaitsweep.gaits(**{"walker": "E", **arguments})
    assert "\n" not in str(caught.value)


def test_points_whose_walker_or_slope_is_wrong_are_all_refused_if_none_is_left():
    slope, m_h = (
        xr.DataArray([0.01, 0.9], dims="p"),
        xr.DataArray([-1.0, 0.5], dims="p"),
    )
    with pytest.raises(StudyError, match=r"^`m_h` must .*-1"):
        gaitsweep.gaits("C", slope, m_h=m_h, variables=["period"])


def forget(monkeypatch, bound=1 << 30):
    memory = Memory(bound)
    monkeypatch.setattr(in_memory, "_REMEMBERED", dict.fromkeys((True, False), memory))
    return memory


@pytest.fixture
def asked(monkeypatch):
    """Names of the tasks that are called from now on, when nothing is remembered."""
    names = []

    def listen(name):
        function = getattr(solve_points, name)
        monkeypatch.setattr(
            solve_points, name, lambda *given: names.append(name) or function(*given)
        )

    forget(monkeypatch)
    for name in ("atlas", "points", "lines"):
        listen(name)
    return names


def test_points_are_dropped_from_the_memory_in_which_they_were_kept(monkeypatch):
    """Which one answers was asked anew for every chunk."""
    forget(monkeypatch)
    compute = in_memory._compute

    def compute_and_forget(plans):
        compute(plans)
        forget(monkeypatch)

    monkeypatch.setattr(in_memory, "_compute", compute_and_forget)
    slopes = np.linspace(0.01, 0.02, 3000)
    found = gaitsweep.gaits("E", slopes, variables=["period"])

    assert found.period.sel(gait="long").notnull().all()


def test_points_that_were_seen_are_not_solved_again(asked):
    """What makes a slider over keys fast: 3 ms for 200 slopes."""
    radii = [[0.1], [0.2]]
    grid = gaitsweep.gaits("E", SLOPES, R=radii)
    assert asked == ["lines", "points", "points"]
    one = gaitsweep.gaits("E", SLOPES, R=0.2)
    assert len(asked) == 3 and same(one.period.values, grid.period.values[1])
    one.period[:] = 0.0  # a caller's own
    assert (
        same(gaitsweep.gaits("E", SLOPES, R=radii).period.values, grid.period.values)
        and len(asked) == 3
    )
    # Some of the variables are there. Other slopes are not taken for these, but the
    # branches are.
    assert "multiplier_real" in gaitsweep.gaits(
        "E", SLOPES, R=0.2, variables=["period", "multipliers"]
    )
    assert not same(
        gaitsweep.gaits("E", SLOPES * 1.1, R=0.2).period.values, one.period.values
    )
    assert asked[3:] == ["points"]
    # Points of long lines cost less than to keep them.
    for _ in range(2):
        gaitsweep.gaits(
            "E", np.geomspace(0.004, 0.05, 300), R=0.2, variables=["period"]
        )
    assert asked[4:] == ["atlas", "points", "points"]


def test_what_is_remembered_changes_time_only(asked, monkeypatch):
    memory = forget(monkeypatch)
    radii = [0.1, 0.15, 0.2, 0.25, 0.3]
    first = gaitsweep.gaits("E", 0.01, R=radii)
    assert asked.count("points") == len(radii)
    # What was used last are points: of five records two are left.
    *_, fourth, fifth = memory
    memory.bound = sum(len(part) for key in (fourth, fifth) for part in memory.get(key))
    memory.trim()
    assert (
        gaitsweep.gaits("E", 0.01, R=radii[::-1])
        .isel(dim_0=slice(None, None, -1))
        .equals(first)
    )
    assert (
        len(radii) < asked.count("points") < 2 * len(radii)
        and memory.size <= memory.bound
    )
    one = gaitsweep.gaits("E", 0.01, R=radii[0])
    assert same(one.period.values, first.period.values[0])


def test_a_question_ends_a_sentence():
    with pytest.raises(
        StudyError, match=r"^Unknown name `perod`, did you mean `period`\?$"
    ):
        gaitsweep.gaits("E", 0.01, variables=["perod"])


def test_lines_side_by_side_are_those_that_are_surveyed_alone(asked, monkeypatch):
    together = gaitsweep.gaits("E", SLOPES, R=[[0.1], [0.2], [0.3]])
    forget(monkeypatch)
    for radius in (0.1, 0.2, 0.3):
        gaitsweep.gaits("E", SLOPES, R=radius)
    assert asked == ["lines", *["points"] * 3, *["atlas", "points"] * 3]
    assert (
        gaitsweep.gaits("E", SLOPES, R=[[0.1], [0.2], [0.3]]).equals(together)
        and len(asked) == 10
    )


def test_a_long_line_takes_the_atlas_that_a_long_study_takes(tmp_path):
    slopes = np.geomspace(0.004, 0.05, 300)
    study = {
        "name": "long",
        "walker": "D",
        "axes": {"slope": slopes},
        "want": {"variables": ["period"]},
    }
    gaitsweep.run(study, jobs=1, archive=tmp_path / "long.nc", quiet=True)
    stored = xr.load_dataset(tmp_path / "long.nc").period.values
    answer = gaitsweep.gaits("D", slopes, variables=["period"]).period.values
    assert near(answer[:, : stored.shape[1]], stored)


def test_long_lines_are_not_surveyed_side_by_side(asked):
    gaitsweep.gaits(
        "E", np.geomspace(0.004, 0.05, 300), R=[[0.1], [0.2]], variables=["period"]
    )
    assert asked == ["atlas"] * 2 + ["points"] * 2


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (
            ("lines", "atlas"),
            "The atlas of the line: it raised MemoryError: of no use.",
        ),
        (("points",), "It raised MemoryError: of no use."),
    ],
)
def test_a_task_that_raises_is_a_status(monkeypatch, broken, reason):
    def fail(*_):
        raise MemoryError("of\nno use")

    with monkeypatch.context() as patched:
        forget(patched)
        for name in broken:
            patched.setattr(solve_points, name, fail)
        answer = gaitsweep.gaits("E", SLOPES, R=[[0.1], [0.2]])
        assert (
            answer.status == RAISED
        ).all() and answer.reason_text.values.tolist() == [reason]
    # A failure is not remembered.
    assert (
        gaitsweep.gaits("E", SLOPES, R=[[0.1], [0.2]]).status.values[..., :2]
        == CONVERGED
    ).all()


def test_lines_that_fail_side_by_side_are_surveyed_alone(asked, monkeypatch):
    broken = dataclasses.replace(
        TASKS["atlas"],
        side_by_side="gaitsweep.tasks.studies.solve_points:no_such_function",
    )
    monkeypatch.setitem(TASKS, "atlas", broken)
    assert (
        gaitsweep.gaits("E", SLOPES, R=[[0.1], [0.2]]).status.values[..., :2]
        == CONVERGED
    ).all()
    assert asked == ["atlas"] * 2 + ["points"] * 2


def test_who_changes_an_answer_does_not_change_the_next():
    slopes = [0.0081, 0.0082]
    answer = gaitsweep.gaits("D", slopes)
    angles = answer.stance_angle.values.copy()

    answer.stance_angle[:] = 0.0

    np.testing.assert_array_equal(gaitsweep.gaits("D", slopes).stance_angle, angles)
