"""Studies over a plane of keys: divided into cells, each computed as a whole, whatever runs them."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import pipeline
from pipeline.engine.runner import _check_room
from pipeline.errors import DiskFullError
from pipeline.graph.graph import Graph
from pipeline.statuses import ALL_STATUSES
from pipeline.study.parse import read
from tasks import solve_points

STUDY = """
name = "plane"
walker = "{walker}"
[axes]
slope = [0.008, 0.01]
{axes}
[want]
variables = ["stance_angle", "period", "loss_normal"]
"""
BOTH = ["long", "short"]
AXES = "R = { from = 0.0, to = 0.2, n = 12 }\nm_s = { from = 0.08, to = 0.12, n = 6 }"


def written(folder, text):
    folder.mkdir(exist_ok=True)
    path = folder / "plane.toml"
    path.write_text(text)
    return path


def run(folder, text, **options):
    archive = folder / "plane.nc"
    pipeline.run(written(folder, text), archive=archive, quiet=True, **options)
    return archive


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    return run(tmp_path_factory.mktemp("one"), STUDY.format(walker="B", axes=AXES), jobs=1)


def test_the_lines_of_a_chunk_know_their_cells(tmp_path):
    study = read(written(tmp_path, STUDY.format(walker="B", axes=AXES)))
    assert study.plane.parts == (2, 1)
    graph = Graph(study)
    chunks = [graph.grid.chunk(k) for k in range(graph.grid.chunks)]
    assert sorted(np.concatenate([chunk.lines for chunk in chunks])) == list(range(72))
    for chunk in chunks:
        params = graph.params(graph.chunk_node(chunk))
        assert len(params["cells"]) == 2
        for number, line in zip(chunk.lines.tolist(), params["lines"], strict=True):
            cell, values = params["cells"][line["cell"]], study.line(number)["set"]
            assert cell["low"] == study.plane.cell(values)["low"]
            assert all(a <= values[key] <= b for key, a, b in zip(cell["keys"], cell["low"], cell["high"], strict=True))


def test_the_digest_of_a_line_tells_its_cell_and_slopes(tmp_path):
    """One slope at which a line is not accepted has it followed by itself at all: fewer slopes may give other bits."""
    other_cells, other_lines = AXES.replace("to = 0.2", "to = 0.22"), AXES.replace("n = 12", "n = 13")
    digests = []
    whole, fewer = STUDY, STUDY.replace("[0.008, 0.01]", "[0.01]")
    for name, text, axes in (
        ("one", whole, AXES),
        ("two", whole, other_cells),
        ("three", whole, other_lines),
        ("four", fewer, AXES),
    ):
        study = read(written(tmp_path / name, text.format(walker="B", axes=axes)))
        graph = Graph(study)
        first = [i for i in range(study.lines) if study.line(i)["set"] == {"R": 0.0, "m_s": 0.08}]
        digests.append(graph.digests(np.array(first)).tolist())
    assert digests[0] not in digests[1:]


def test_the_digest_of_a_line_tells_a_value_on_the_border_of_its_cell(tmp_path):
    """It belongs to the next cell, but is among those that decide whether patches are worth their making."""
    digests, values = [], []
    for k, others in enumerate(("0.18", "0.1, 0.18")):
        axes = f"R = [0.0, 0.08, {others}, 0.2]\nm_s = {{ from = 0.08, to = 0.12, n = 16 }}"
        study = read(written(tmp_path / str(k), STUDY.format(walker="B", axes=axes)))
        values.append(study.plane.cell(study.line(0)["set"])["values"][0].tolist())
        digests.append(Graph(study).digests(np.array([0])).tolist())
    assert values == [[0.0, 0.08], [0.0, 0.08, 0.1]]
    assert digests[0] != digests[1]


def test_the_digests_of_lines_are_the_same_over_a_falling_axis(tmp_path):
    digests = []
    for name, R in (("rising", "[0.0, 0.08, 0.1, 0.18, 0.2]"), ("falling", "[0.2, 0.18, 0.1, 0.08, 0.0]")):
        axes = f"R = {R}\nm_s = {{ from = 0.08, to = 0.12, n = 13 }}"
        study = read(written(tmp_path / name, STUDY.format(walker="B", axes=axes)))
        graph = Graph(study)
        digests.append(graph.digests(np.arange(study.lines)).reshape(*study.line_shape[1:], 2))
    assert np.array_equal(digests[0], digests[1][::-1])


@pytest.mark.parametrize("axes", ["R = { from = 0.0, to = 0.2, n = 7 }\nm_s = { from = 0.08, to = 0.12, n = 9 }"])
def test_few_lines_are_no_plane(tmp_path, axes):
    assert read(written(tmp_path, STUDY.format(walker="B", axes=axes))).plane is None


def test_a_plane_that_no_disk_holds_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.engine.runner._MIN_BYTES", 10**12)
    with pytest.raises(DiskFullError, match=r"^144 points need 1,296,000.0 GB at least; [\d,.]+ are free\.$"):
        run(tmp_path, STUDY.format(walker="B", axes=AXES))
    assert not (tmp_path / "plane.nc").exists()


def test_what_the_disk_can_hold_is_not_refused(tmp_path, monkeypatch):
    """Of a coarse sweep 8,157,867 bytes were measured, of which its slopes take 8e6; windows have no points."""
    monkeypatch.setattr("pipeline.engine.runner.shutil.disk_usage", lambda path: SimpleNamespace(free=8_200_000))
    million = 'name = "s"\nwalker = "D"\ngaits = ["long"]\n[axes]\nslope = { from = 0.001, to = 0.01, n = 1000000 }\n'
    branches = 'kind = "branch"\n' + million + "R = { from = 0.0, to = 0.1, n = 1000 }\n"
    for text in ("accuracy = 1e-2\n" + million + '[want]\nvariables = ["period"]\n', branches):
        _check_room(read(written(tmp_path, text)), tmp_path / "s.nc")
    with pytest.raises(DiskFullError, match="^1,000,000,000 points need"):
        _check_room(read(written(tmp_path, branches.replace("branch", "grid"))), tmp_path / "s.nc")


def test_two_workers_write_the_same_bytes(archive, tmp_path):
    other = run(tmp_path, STUDY.format(walker="B", axes=AXES), jobs=2)
    assert other.read_bytes() == archive.read_bytes()


def test_a_plane_holds_what_its_lines_hold(archive):
    plane = pipeline.load(archive)
    for i, k in ((0, 0), (5, 3), (6, 0), (11, 5)):
        one = pipeline.gaits("B", plane.slope.values, R=float(plane.R[i]), m_s=float(plane.m_s[k])).sel(gait=BOTH)
        other = plane.isel(R=i, m_s=k).sel(gait=BOTH)
        for name in ("stance_angle", "period"):
            bound = other.error_bound.values + one.error_bound.values
            assert (np.abs(other[name].values / one[name].values - 1) <= bound).all()
        assert other.loss_normal.values == pytest.approx(one.loss_normal.values, rel=1e-11)
    assert (plane.status.sel(gait=BOTH) == "converged").all()


def test_violations_are_measured_walker_by_walker(tmp_path):
    text = STUDY.format(walker="B", axes=AXES.replace("n = 12", "n = 11")).replace("loss_normal", "scuff_depth")
    plane = pipeline.load(run(tmp_path, text, jobs=1))
    one = pipeline.gaits("B", plane.slope.values, R=0.2, m_s=0.12, variables=["scuff_depth"])
    depth = plane.scuff_depth.isel(R=-1, m_s=-1).sel(gait=BOTH)
    assert depth.values == pytest.approx(one.scuff_depth.sel(gait=BOTH).values, rel=1e-9)


def test_arrays_over_a_plane_give_what_a_study_over_it_gives(archive, monkeypatch):
    """Through the same cells, in whatever order the values come, and beside a slope that cannot be."""
    monkeypatch.setattr(solve_points, "atlas", None)  # no line is surveyed by itself
    monkeypatch.setattr(solve_points, "lines", None)
    plane = xr.load_dataset(archive).transpose("R", "m_s", "slope", ...)
    R, m_s = plane.R.values[::-1, None, None], plane.m_s.values[:, None]
    answer = pipeline.gaits("B", [0.01, 0.7, 0.008], R=R, m_s=m_s, variables=["stance_angle", "period", "loss_normal"])
    assert (answer.status.values[:, :, 1] == ALL_STATUSES["raised"]).all()
    answer = answer.isel(dim_0=slice(None, None, -1), dim_2=[2, 0], gait=slice(plane.sizes["gait"]))
    for name in ("stance_angle", "period", "loss_normal", "error_bound", "status", "branch", "piece"):
        np.testing.assert_array_equal(answer[name].values, plane[name].values)
    words = (data.reason_text.values[data.reason.values] for data in (answer, plane))
    np.testing.assert_array_equal(*words)


def test_arrays_that_are_no_plane_are_solved_line_by_line(monkeypatch):
    monkeypatch.setattr("tasks.solve_planes.lines", None)
    m_s = np.linspace(0.08, 0.12, 70)
    R = np.where(np.arange(70) < 69, 0.1, 0.2)
    assert (pipeline.gaits("B", 0.01, R=R, m_s=m_s, variables=["period"]).status.sel(gait=BOTH) == 0).all()


def test_lines_of_cells_that_fail_are_solved_one_by_one(monkeypatch):
    def fail(params, inputs):
        raise FloatingPointError

    monkeypatch.setattr("tasks.solve_planes.lines", fail)
    answer = pipeline.gaits("B", 0.01, m_s=np.linspace(0.08, 0.12, 64), variables=["period"])
    assert (answer.status.sel(gait=BOTH) == 0).all()
