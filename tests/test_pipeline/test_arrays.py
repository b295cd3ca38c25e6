"""Orbits and basins in the archive: arrays over the grid and their own dimensions."""

import netCDF4
import numpy as np
import pytest
import xarray as xr

from gaitsweep import load
from gaitsweep.pipeline.archive import diff, verify
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.report.source import read

BASIN = """name = "b"
kind = "basin"
walker = ["D", "E"]
[axes]
slope = [0.009, 0.0126]
[options]
size = 12
steps = 30
"""
ORBIT = """name = "o"
kind = "orbit"
walker = "E"
[axes]
foot_mass_ratio = [0.0, 0.05]
slope = [0.004, 0.0125]
[options]
starts = 2
transient = 20
steps = 30
shown = 5
"""


RANGES = "stance_angle = [0.15, 0.3]\nstance_rate = [-0.3, -0.15]\n"
STUDIES = {"b": BASIN, "b2": BASIN.replace('"b"', '"b2"') + RANGES, "o": ORBIT}


def _tree(path):
    with xr.open_datatree(path) as tree:
        return tree.load()


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arrays")
    for name, text in STUDIES.items():
        (folder / f"{name}.toml").write_text(text)
        arguments = [
            "run",
            f"{folder}/{name}.toml",
            "--archive",
            f"{folder}/{name}.nc",
            "--jobs",
            "1",
            "--quiet",
        ]
        assert commands.main(arguments) == 0
    return folder


def test_a_basin_is_an_array_of_flags(archives):
    tree = _tree(archives / "b2.nc")
    basin = tree["basin"].to_dataset()
    assert basin["outcome"].dims == ("walker", "slope", "stance_angle", "stance_rate")
    assert basin["outcome"].dtype == np.int8 and basin["outcome"].shape == (
        2,
        2,
        12,
        12,
    )
    assert list(basin["walker"].values) == ["D", "E"]  # inherited from the root
    words = basin["outcome"].attrs["flag_meanings"].split()
    # Each outcome has the share of cells that the table of areas says.
    areas = tree["areas"].to_dataset(inherit=False).to_dataframe()
    counted = {}
    for row in areas.itertuples():
        cells = basin["outcome"].sel(walker=row.walker, slope=row.slope)
        counted[row.walker, row.slope] = (
            counted.get((row.walker, row.slope), 0) + row.share
        )
        assert float(
            (cells == words.index(row.outcome.replace(" ", "_"))).mean()
        ) == pytest.approx(row.share)
    assert list(counted.values()) == pytest.approx([1] * len(counted))


def test_ranges_that_differ_between_basins_are_arrays(archives):
    basin = _tree(archives / "b.nc")["basin"].to_dataset()
    values = basin["stance_angle_values"]
    assert (
        values.dims == ("walker", "slope", "stance_angle")
        and (np.diff(values, axis=-1) > 0).all()
    )
    assert float(values.sel(walker="D")[0, 0]) != float(values.sel(walker="E")[0, 0])
    table = read(archives / "b.nc").tables["basin"]
    assert len(table) == 4 * 144 and {
        "walker",
        "slope",
        "stance_angle",
        "stance_rate",
        "outcome",
    } <= set(table)
    first = table[(table["walker"] == "D") & (table["slope"] == 0.009)]
    assert first["stance_angle"].nunique() == 12 and set(first["stance_angle"]) == set(
        values.values[0, 0]
    )


def test_orbits_are_arrays_over_the_grid_with_nan_where_an_orbit_fell(archives):
    orbits = _tree(archives / "o.nc")["orbits"].to_dataset()
    assert orbits["stance_angle"].dims == ("foot_mass_ratio", "slope", "start", "step")
    assert orbits["repeats_to"].dims == ("foot_mass_ratio", "slope", "start")
    assert list(orbits["step"].values) == [25, 26, 27, 28, 29]
    falls = _tree(archives / "o.nc")["falls"].to_dataset().to_dataframe()
    walked = int(np.isfinite(orbits["stance_angle"]).all("step").sum())
    assert (
        walked
        == 8 - int((falls["start"] >= 0).sum()) - 2 * int((falls["start"] < 0).sum())
        and walked > 0
    )
    assert len(read(archives / "o.nc").tables["orbits"]) == 5 * walked


def test_arrays_are_verified_and_compared(archives, tmp_path):
    for name in ("b", "b2", "o"):
        path = archives / f"{name}.nc"
        assert verify.verify(path) == [] and diff.diff(path, path) == []
    changed = tmp_path / "o.nc"
    changed.write_bytes((archives / "o.nc").read_bytes())
    with netCDF4.Dataset(changed, "a") as file:
        file["orbits/period"][0, 0, 0, 0] = 9.0
    assert diff.diff(archives / "o.nc", changed)[0].startswith(
        "`orbits/period`: 1 of 40 differ"
    )
    assert verify.verify(changed) == ["`orbits/period` is not as it was written."]


def test_only_the_lines_that_both_archives_have_are_compared(archives, tmp_path):
    (tmp_path / "one.toml").write_text(ORBIT.replace("[0.0, 0.05]", "[0.05]"))
    one = tmp_path / "one.nc"
    assert (
        commands.main(
            [
                "run",
                f"{tmp_path}/one.toml",
                "--archive",
                str(one),
                "--jobs",
                "1",
                "--quiet",
            ]
        )
        == 0
    )
    found = diff.diff(archives / "o.nc", one)
    assert found == [
        f"1 of 2 values of `foot_mass_ratio` are only in {archives / 'o.nc'}"
    ]


@pytest.mark.parametrize(
    ("name", "slopes"), [("b", [0.009, 0.0126]), ("o", [0.004, 0.0125])]
)
def test_slopes_are_compared_whatever_their_order(archives, tmp_path, name, slopes):
    both = [*slopes, 0.0127]
    paths = []
    for k, values in enumerate((both, both[::-1])):
        (tmp_path / "s.toml").write_text(
            STUDIES[name].replace(str(slopes), str(values))
        )
        paths.append(tmp_path / f"{k}.nc")
        assert (
            commands.main(
                [
                    "run",
                    f"{tmp_path}/s.toml",
                    "--archive",
                    str(paths[k]),
                    "--jobs",
                    "1",
                    "--quiet",
                ]
            )
            == 0
        )
    assert diff.diff(*paths) == []
    # Of arrays the slopes are compared that both archives have.
    group = "orbits" if name == "o" else "basin"
    found = [
        sentence
        for sentence in diff.diff(paths[1], archives / f"{name}.nc")
        if f"`{group}/" in sentence
    ]
    assert (
        found[0] == f"1 of {len(both)} values of `{group}/slope` are only in {paths[1]}"
    )
    assert not any("of their size" in sentence for sentence in found)


def test_parameters_are_variables_where_they_vary_and_attributes_where_not(
    archives, tmp_path
):
    orbits, basin = (
        _tree(archives / "o.nc").to_dataset(),
        _tree(archives / "b.nc").to_dataset(),
    )
    # Each foot has the ratio of the total mass, the two hip masses of the thighs the
    # rest.
    assert orbits["m_s"].dims == ("foot_mass_ratio",) and list(
        orbits["m_s"].values
    ) == pytest.approx([0.0, 0.05])
    assert (
        2 * (orbits["m_s"] + orbits["m_t"]) + orbits["m_h"]
    ).values == pytest.approx([1.0, 1.0])
    assert orbits.attrs["R"] == 0.0 and "R" not in orbits
    assert basin["m_s"].dims == ("walker",) and basin["m_s"].attrs["units"] == "1"
    assert list(basin["walker"].where(basin["m_s"] > 0, drop=True).values) == ["E"]
    (tmp_path / "d.toml").write_text(
        'name = "d"\nwalker = ["A", "C"]\n[axes]\ndetuning = [0.0, 1.0]\nc_s = [0.17, 0.18]\nslope = [0.03]\n'
    )
    path = tmp_path / "d.nc"
    assert (
        commands.main(
            [
                "run",
                f"{tmp_path}/d.toml",
                "--archive",
                str(path),
                "--jobs",
                "1",
                "--quiet",
            ]
        )
        == 0
    )
    tuned = xr.load_dataset(path)
    assert (
        tuned["w_t"].dims == ("walker", "detuning")
        and tuned["w_t"].attrs["units"] == "m"
    )
    assert tuned["w_t"].sel(detuning=1.0).values == pytest.approx([0, 0], abs=1e-15)
    assert tuned["c_s"].dims == ("c_s",) and tuned.attrs["g"] == 9.81
    assert verify.verify(path) == []


def test_arrays_are_loaded_as_tables(archives):
    basin, orbits = load(archives / "b2.nc", "basin"), load(archives / "o.nc", "orbits")
    assert (
        len(basin) == 4 * 144
        and set(basin["walker"]) == {"D", "E"}
        and "fell forward" in set(basin["outcome"])
    )
    assert {"foot_mass_ratio", "slope", "start", "step", "period"} <= set(
        orbits
    ) and orbits["period"].notna().all()
