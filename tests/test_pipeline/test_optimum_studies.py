"""Studies of kind optimum: what is refused, what is archived, and the page."""

import json
import re
from pathlib import Path

import pytest
import xarray as xr

import gaitsweep
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study.parse import parse
from gaitsweep.tasks.contract.registry import VIOLATIONS

FREE = {"R": [0.1, 0.3]}
FASTEST = {"maximise": "froude_speed", "free": FREE, "starts": 2}


def study(options, walker="A", axes=None, **more):
    axes = axes or {"slope": [0.01, 0.04]}
    about = {"name": "best", "kind": "optimum", "walker": walker}
    return {**about, "axes": axes, "options": options, **more}


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        (
            study({"free": FREE}),
            "An optimum needs either `minimise` or `maximise` (options).",
        ),
        (
            study({**FASTEST, "minimise": "slope"}),
            "An optimum needs either `minimise` or `maximise`, not both (options).",
        ),
        (
            study({"maximise": "speed"}),
            "An optimum needs 1 to 8 keys that are `free`, with their ranges (options).",
        ),
        (
            study({"maximise": "sped", "free": FREE}),
            "Unknown name `sped`, did you mean `speed`? (options.maximise).",
        ),
        (
            study({"maximise": "kneestrike_time", "free": FREE}),
            "`maximise` must be a measure of its gaits: ",
        ),
        (
            study(FASTEST, axes={"slope": [0.01], "R": [0.1, 0.2]}),
            "`R` is free, and an axis sets it too (options.free.R).",
        ),
        (
            study({"minimise": "slope", "free": FREE}, axes={"slope": [0.01]}),
            "`slope` is what is best, and its axis fixes it (options).",
        ),
        (
            study({**FASTEST, "free": {"R": [0.3, 0.1]}}),
            "`R` must be two increasing numbers; got [0.3, 0.1] (options.free.R).",
        ),
        (
            study({**FASTEST, "free": {"R": [-0.1, 0.3]}}),
            "`R` must be >= 0; got -0.1 (options.free).",
        ),
        (
            study({**FASTEST, "free": {"R": [0.1, 0.3], "eps_T": [0.0, 2.5]}}, "C"),
            "`eps_T` must lie in (-pi/2, pi/2) rad; got 2.5 (options.free).",
        ),
        (
            study({**FASTEST, "free": {"detuning": [0, 1], "w_t": [-0.1, 0.1]}}),
            "`w_t` is set by `detuning`, which owns ",
        ),
        (
            study({**FASTEST, "free": {"g": [5.0, 10.0]}}),
            "`free` must hold keys that change more than units; got g (options.free).",
        ),
        (
            study({**FASTEST, "within": {"speed": [0.4, 0.3]}}),
            "`speed` must be two numbers that do not fall; got [0.4, 0.3]"
            " (options.within.speed).",
        ),
        (
            study({**FASTEST, "within": {"froude_speed": [0.2, 0.2]}}),
            "`froude_speed` is what is best, and this fixes it"
            " (options.within.froude_speed).",
        ),
        (
            study({**FASTEST, "within": {"spectral_radius": [1.5, 2]}}),
            "Stable gaits have less than 1; `stable = false` allows more"
            " (options.within.spectral_radius).",
        ),
        (
            study({**FASTEST, "without": ["scuffs"]}),
            "Unknown name `scuffs`, did you mean `scuff`? (options.without).",
        ),
        (
            study({**FASTEST, "tradeoff": {"speed": [0.3, 0.3]}}),
            "`speed` must be a list of different numbers; got [0.3, 0.3]"
            " (options.tradeoff.speed).",
        ),
        (
            study({**FASTEST, "tradeoff": {"speed": [0.3], "period": [0.7]}}),
            "The objective is traded for one measure (options.tradeoff).",
        ),
        (
            study({**FASTEST, "stable": 1}),
            "`stable` must be true or false; got 1 (options.stable).",
        ),
        (
            study({"minimise": "R", "free": {"m_h": [0.0, 1.0]}}),
            "`minimise` must be a measure of its gaits: ",
        ),
        (
            study(FASTEST, gaits=["other1"]),
            "The gaits of an optimum are `long` or `short` (gaits).",
        ),
    ],
)
def test_what_no_optimum_can_be_asked_is_refused_in_one_line(asked, sentence):
    with pytest.raises(StudyError) as error:
        parse(asked, "", Path("s.toml"))

    told = str(error.value).replace("s.toml, ", "")
    assert "\n" not in told
    assert told.startswith(sentence), told


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    path = tmp_path_factory.mktemp("optimum") / "best.nc"
    asked = study(FASTEST, axes={"slope": [0.01, 0.04], "m_h": [0, 1]})
    asked["want"] = {"figures": ["optimum"]}
    gaitsweep.run(asked, archive=path, jobs=1, quiet=True)
    return path


def test_a_mapping_runs_and_each_line_has_its_optimum(archive):
    best = xr.load_dataset(archive, group="optimum")
    walkers = xr.load_dataset(archive, group="optimal_walkers")

    assert best["m_h"].values.tolist() == [0, 1]
    assert (best["spectral_radius"] <= 1 + 1e-6).all()
    assert ((best["R"] >= 0.1) & (best["R"] <= 0.3)).all()
    assert best["error_bound"].attrs["units"] == "1"
    assert best["speed"].attrs["units"] == "m s-1"
    assert set(walkers) >= {"l_t", "R", "m_h", "c_s"}


def test_the_page_walks_the_optimum_and_shows_the_ways(archive, tmp_path):
    page = gaitsweep.report(archive, tmp_path).read_text(encoding="utf-8")

    lines = json.loads(re.search(r'id="lines">(.*?)</script>', page)[1])
    optima = [line for line in lines if "R" in line["at"]]
    assert len(optima) == 2 and all(line["branches"][0] for line in optima)
    assert {line["keys"]["R"] for line in optima} == {
        line["at"]["R"] for line in optima
    }
    assert "Optimum: largest v/√(gl)" in page
    assert "What limits the optimum" in page


def test_where_nothing_is_stable_the_line_says_so(tmp_path):
    asked = study(FASTEST, axes={"slope": [0.3, 0.4]})

    found = gaitsweep.run(asked, archive=tmp_path / "none.nc", jobs=1, quiet=True)

    assert found["status"].item() == "no_gait"
    reason = str(found["reason"].item())
    assert reason.startswith("No stable gait within the ranges and limits was found")


@pytest.mark.thorough
def test_a_point_of_a_trade_off_without_an_optimum_says_why(tmp_path):
    tradeoff = {"froude_speed": [0.15, 7.0]}
    options = {"minimise": "cost_of_transport", "free": FREE, "tradeoff": tradeoff}
    asked = study({**options, "starts": 1}, axes={"slope": [0.01, 0.02]})
    archive = tmp_path / "some.nc"

    found = gaitsweep.run(asked, archive=archive, jobs=1, quiet=True)
    page = gaitsweep.report(archive, tmp_path).read_text(encoding="utf-8")

    assert found["status"].item() == "converged"
    reason = str(found["reason"].item())
    assert "with `froude_speed` = 7: where iterations from 1 starts" in reason
    assert "`froude_speed` must be equal to 7: it is 0.1" in reason
    assert xr.load_dataset(archive, group="optimum")["case"].values.tolist() == [0]
    assert "with `froude_speed` = 7" in page


def test_a_key_that_changes_nothing_is_named_with_its_range(tmp_path):
    """The only mass of D is that at its hip."""
    free = {"m_h": [0.5, 2.0]}
    asked = study({"maximise": "froude_speed", "free": free, "starts": 1}, "D")

    found = gaitsweep.run(asked, archive=tmp_path / "none.nc", jobs=1, quiet=True)

    assert found["status"].item() == "raised"
    assert str(found["reason"].item()).endswith(
        "`m_h` is free and changes neither gaits nor what is asked of them; "
        "got [0.5, 2.0]."
    )


LEVEL = {
    "minimise": "cost_of_transport",
    "free": {"push_off": [0.02, 0.2], "hip_stiffness": [0.0, 0.05]},
    "within": {"froude_speed": [0.2, 0.2]},
    "starts": 1,
}


@pytest.fixture(scope="module")
def level(tmp_path_factory):
    path = tmp_path_factory.mktemp("level") / "best.nc"
    asked = study(LEVEL, "B", {"slope": [0.0]})
    asked["want"] = {"figures": ["optimum"]}
    gaitsweep.run(asked, archive=path, jobs=1, quiet=True)
    return path


def _cheapest(stiffness):
    """The least cost of transport at the speed, with one stiffness of the hip."""
    found = gaitsweep.solve(
        "B",
        0.0,
        at={"froude_speed": 0.2},
        vary="push_off",
        between=[0.02, 0.2],
        hip_stiffness=stiffness,
    )
    return found.sort_values("cost_of_transport").iloc[0]


@pytest.mark.thorough
def test_the_cheapest_walking_on_level_ground_is_the_cheapest_at_its_speed(level):
    """By gaits at the speed, and the multiplier of the stiffness by their difference."""
    best = xr.load_dataset(level, group="optimum").isel(row=0)
    limits = xr.load_dataset(level, group="optimum_limits")

    softer, same, stiffer = map(_cheapest, (0.049, 0.05, 0.051))

    assert float(best["slope"]) == 0.0
    assert float(best["hip_stiffness"]) == 0.05
    assert float(best["push_off"]) == pytest.approx(same["push_off"], rel=1e-6)
    cost = float(best["cost_of_transport"])
    assert cost == pytest.approx(same["cost_of_transport"], rel=1e-6)
    by_stiffness = (stiffer["cost_of_transport"] - softer["cost_of_transport"]) / 0.002
    names = [str(name) for name in limits["limited_by"].values]
    multiplier = float(limits["multiplier"][names.index("hip_stiffness")])
    assert multiplier == pytest.approx(by_stiffness, rel=1e-3)


@pytest.mark.thorough
def test_the_page_of_an_optimum_on_level_ground_walks_it(level, tmp_path):
    page = gaitsweep.report(level, tmp_path).read_text(encoding="utf-8")

    (line,) = json.loads(re.search(r'id="lines">(.*?)</script>', page)[1])

    assert line["branches"][0][0][0] == 0.0
    assert line["keys"]["push_off"] == line["at"]["push_off"]
    assert len(line["keys"]["violation_limits"]) == len(VIOLATIONS)


@pytest.mark.parametrize(
    ("slopes", "free", "sentence"),
    [
        (
            [-0.01, 0.01],
            LEVEL["free"],
            "Slopes of an optimum must be all > 0, or one that is 0 or below; "
            "got -0.01 and 0.01 (axes.slope).",
        ),
        (
            [0.0],
            {"R": [0.1, 0.3]},
            "`slope` must lie in [1e-18, 0.5) rad for passive walkers; got 0: on level "
            "ground and uphill a walker needs a `push_off`",
        ),
    ],
)
def test_optima_on_level_ground_have_one_slope_and_a_drive(slopes, free, sentence):
    asked = study({**LEVEL, "free": free}, "B", {"slope": slopes})

    with pytest.raises(StudyError) as error:
        parse(asked, "", Path("s.toml"))

    told = str(error.value).replace("s.toml, ", "")
    assert told.startswith(sentence), told
