"""Archives of every kind of study keep the CF conventions they declare, and describe
all they hold.
"""

import json
import subprocess
import sys
import types

import netCDF4
import numpy as np
import pytest

import gaitsweep
from conftest import GAITSWEEP
from gaitsweep.pipeline.api import studies
from gaitsweep.pipeline.archive import diff, result_tables
from gaitsweep.tasks.contract.registry import STATUSES

#: The smallest study of each kind, and one over walkers of different units.
STUDIES = {
    "grid": {
        "walker": "E",
        "axes": {"slope": [0.0005, 0.001, 0.002, 0.02], "foot_mass_ratio": [0.1, 0.05]},
        "want": {
            "variables": [
                "stance_angle",
                "period",
                "speed",
                "power",
                "multipliers",
                "energy",
                "violations",
            ],
            "fits": ["scaling", "transition"],
            "figures": ["angles"],
            "claims": ["D1"],
        },
    },
    "walkers": {
        "walker": ["A", "D"],
        "axes": {"slope": [0.01]},
        "want": {"figures": ["angles"], "claims": ["D1"]},
    },
    "branch": {"walker": "D", "axes": {"slope": {"from": 0.005, "to": 0.03, "n": 4}}},
    "orbit": {
        "walker": "D",
        "axes": {"slope": [0.012, 0.019]},
        "options": {"starts": 2, "transient": 20, "steps": 60, "shown": 8},
    },
    "cascade": {
        "walker": "D",
        "axes": {"slope": [0.012, 0.018]},
        "options": {"periods": 2, "starts": 20},
    },
    "basin": {
        "walker": "D",
        "axes": {"slope": [0.01]},
        "options": {"size": 8, "steps": 20},
    },
    "curve": {
        "walker": "F",
        "axes": {"slope": [0.005, 0.05]},
        "options": {
            "key": "foot_mass_ratio",
            "from": 0.04,
            "to": 0.06,
            "kinds": ["flip"],
        },
    },
    "no curve": {
        "walker": "E",
        "axes": {"slope": [0.005, 0.05]},
        "options": {
            "key": "foot_mass_ratio",
            "from": 0.08,
            "to": 0.12,
            "kinds": ["flip"],
        },
    },
    "optimum": {
        "walker": "E",
        "axes": {"slope": [0.005, 0.05]},
        "options": {
            "maximise": "froude_speed",
            "free": {"foot_mass_ratio": [0.04, 0.06]},
            "starts": 2,
        },
    },
    "census": {"walker": "D", "axes": {"slope": [0.01]}, "options": {"starts": 60}},
}

#: A program: the checker, strict, over the archives it is given.
CHECK = """
import sys
from compliance_checker.runner import CheckSuite, ComplianceChecker
CheckSuite.load_all_available_checkers()
ComplianceChecker.run_checker(sys.argv[2:], ["cf:1.11"], 0, "strict", output_filename=sys.argv[1],
                              output_format=["json_new"])
"""


def mapping(name):
    """A study whole, called by its own name."""
    return {
        "name": name.replace(" ", "-"),
        "kind": {"walkers": "grid", "no curve": "curve"}.get(name, name),
        **STUDIES[name],
    }


def by_one_worker(folder, names, *engine):
    """The archive of each study, of one run whose only worker computes them in turn."""
    files = []
    for name in names:
        files.append(folder / f"{len(files)}.toml")
        files[-1].write_text(studies._study(mapping(name)).text)

    command = [*GAITSWEEP, "run", *map(str, files), "--quiet", *engine]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)

    kept = folder / "data" / "archive"
    return {name: kept / f"{mapping(name)['name']}.nc" for name in names}


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    return by_one_worker(tmp_path_factory.mktemp("cf"), [*STUDIES], "--jobs", "1")


@pytest.mark.parametrize(
    "engine",
    [["--jobs", "1"], pytest.param(["--cluster", "local:1"], marks=pytest.mark.soak)],
)
def test_a_study_gives_the_same_bytes_whatever_its_worker_did_before(
    archives, tmp_path, engine
):
    """All kinds by one worker process, in another order, two of them with claims; and
    each by a worker of its own.
    """
    again = by_one_worker(tmp_path, [*reversed(STUDIES)], *engine)

    for name, archive in archives.items():
        alone = tmp_path / f"{name}.nc"
        gaitsweep.run(mapping(name), jobs=1, archive=alone, quiet=True)
        assert again[name].read_bytes() == archive.read_bytes(), name
        assert alone.read_bytes() == archive.read_bytes(), name


def test_the_checker_of_the_conventions_finds_nothing(archives, tmp_path):
    command = [
        sys.executable,
        "-W",
        "ignore",
        "-c",
        CHECK,
        str(tmp_path / "found.json"),
        *map(str, archives.values()),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (tmp_path / "found.json").exists(), done.stderr
    found = json.loads((tmp_path / "found.json").read_text())
    assert set(found) == set(map(str, archives.values()))
    for name, checks in found.items():
        checks = checks["cf:1.11"]
        said = [check["msgs"] for check in checks["all_priorities"] if check["msgs"]]
        assert not said and checks["scored_points"] == checks["possible_points"] > 20, (
            name,
            said,
        )
    # The checker takes differences of text coordinates, where it stumbles; it says so,
    # and finds nothing by it.
    stumbles = [
        line for line in done.stdout.splitlines() if line.startswith("cf:1.11.")
    ]
    assert all("strict_monotonicity" in line and "'str'" in line for line in stumbles)


def test_no_archive_differs_from_itself(archives):
    for name, archive in archives.items():
        assert diff.diff(archive, archive) == [], name


def test_a_curve_that_could_not_begin_says_so(archives):
    with (
        netCDF4.Dataset(archives["curve"]) as found,
        netCDF4.Dataset(archives["no curve"]) as none,
    ):
        assert len(found["curves/slope"]) and "followed" in str(found["reason_text"][0])
        assert not len(none["curves/slope"]) and str(none["reason_text"][0]).startswith(
            "No point of `"
        )
        assert (found["status"][...].item(), none["status"][...].item()) == (
            STATUSES["converged"],
            STATUSES["no_gait"],
        )


def _variables(group, path=""):
    for variable in group.variables.values():
        yield f"{path}{variable.name}", variable
    for name, inner in group.groups.items():
        yield from _variables(inner, f"{path}{name}/")


def test_every_variable_of_every_group_has_units_and_a_meaning(archives):
    seen = set()
    for archive in archives.values():
        with netCDF4.Dataset(archive) as file:
            assert file.Conventions == "CF-1.11"
            for name, variable in _variables(file):
                seen.add(name)
                assert variable.units, name
                if variable.dtype.kind == "f" and variable.dimensions == ("row",):
                    assert np.isnan(variable._FillValue), name
                # A bare name stands where nobody has written what a column means.
                assert (
                    variable.long_name != name.rpartition("/")[2].replace("_", " ")
                    or name == "walker"
                ), name
    groups = {name.rpartition("/")[0] for name in seen}
    assert groups >= {
        "",
        "fits/scaling",
        "fits/transition",
        "trace",
        "claims",
        "branches",
        "special_points",
        "orbits",
        "falls",
        "lyapunov",
        "survival",
        "cascade",
        "basin",
        "areas",
        "census",
        "coverage",
        "curves",
    }


def test_tables_are_in_the_walkers_units(archives):
    with (
        netCDF4.Dataset(archives["walkers"]) as mixed,
        netCDF4.Dataset(archives["cascade"]) as counted,
    ):
        assert (
            mixed["trace/theta_st"].units == "rad" and mixed["trace/time"].units == "1"
        )
        assert mixed["trace/time"].comment.startswith("in the units of each walker")
        assert counted["cascade/period"].long_name == "steps of the periodic gait"


@pytest.mark.parametrize(
    ("walker", "key", "unit"),
    [("C", "R", "m"), ("C", "eps_T", "rad"), ("E", "R", "1"), ("C", "detuning", "1")],
)
def test_values_of_a_curves_key_have_its_unit(walker, key, unit):
    options = {"key": key, "from": 0.1, "to": 0.2}
    study = studies._study(
        {
            "name": "s",
            "kind": "curve",
            "walker": walker,
            "axes": {"slope": [0.01, 0.1]},
            "options": options,
        }
    )
    for group in ("curves", "turnings", "meetings"):
        assert (
            result_tables._attributes(
                types.SimpleNamespace(study=study), group, "value"
            )["units"]
            == unit
        )


def test_errors_of_the_values_of_two_keys_have_their_units():
    plane = {"R": [0.1, 0.2], "detuning": [0.0, 1.0]}
    asked = {"name": "s", "kind": "curve", "walker": "C", "options": {"plane": plane}}
    plan = types.SimpleNamespace(
        study=studies._study(asked | {"axes": {"slope": [0.01]}})
    )
    for name, unit in (("value_error", "m"), ("other_value_error", "1")):
        found = result_tables._attributes(plan, "meetings", name)
        assert found["units"] == unit


def test_the_ranges_of_the_fitted_lines_are_slopes(archives):
    with netCDF4.Dataset(archives["grid"]) as file:
        table = file["fits/transition"]
        for name, factor in (("fitted_below", 0.1), ("fitted_above", 3.0)):
            np.testing.assert_allclose(
                table[name][...], factor * table["slope_transition"][...]
            )
            assert table[name].units == table["slope_transition"].units == "rad"
            assert (
                "slope" in table[name].long_name
                and "exponent" not in table[name].long_name
            )


def test_flags_decode_with_netcdf4_alone(archives):
    with netCDF4.Dataset(archives["grid"]) as file:
        status, violations = file["status"], file["violations"]
        words = dict(
            zip(status.flag_values.tolist(), status.flag_meanings.split(), strict=True)
        )
        assert {words[v] for v in np.unique(status[...]).tolist()} <= {
            "converged",
            "no_gait",
        }
        assert len(violations.flag_meanings.split()) == len(violations.flag_masks)
        assert not np.any(
            violations[...] & ~np.bitwise_or.reduce(violations.flag_masks)
        )
        reasons = file["reason_text"][...][file["reason"][...]]
        assert all(text.endswith(".") for text in reasons.ravel())
