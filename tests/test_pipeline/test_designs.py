"""Studies of designs: many designs a job, cell by cell of a plane of keys, whatever
runs them.
"""

import math

import numpy as np
import pytest
import xarray as xr

import gaitsweep
from gaitsweep.pipeline.cli import plan
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.graph import layers
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.study.parse import read

STUDY = """
name = "designs"
kind = "design"
walker = {walker}
[axes]
slope = [1e-5, 0.4]
{axes}
[want]
figures = ["design"]
"""
#: Two cells, one for each value of the third key.
PLANE = "R = {{ from = 0.1, to = 0.12, n = {n} }}\nm_h = [0.0, 0.02]\nm_s = {{ from = 0.03, to = 0.04, n = {m} }}"


def written(folder, walker, axes):
    folder.mkdir(exist_ok=True)
    path = folder / "designs.toml"
    path.write_text(STUDY.format(walker=walker, axes=axes))
    return path


def run(folder, walker, axes, **options):
    archive = folder / "designs.nc"
    gaitsweep.run(written(folder, walker, axes), archive=archive, quiet=True, **options)
    return archive


def table_of(archive):
    return xr.open_dataset(archive, group="design").to_dataframe()


@pytest.mark.parametrize(
    ("walker", "axes", "batches"),
    [
        ('"B"', PLANE.format(n=25, m=20), 2),
        ('["A", "B"]', PLANE.format(n=25, m=20), 4),
        ('["A", "B"]', PLANE.format(n=5, m=7), 6),
        ('"B"', "R = [0.1, 0.2]", 1),
    ],
)
def test_every_design_belongs_to_one_job(tmp_path, walker, axes, batches):
    study = read(written(tmp_path, walker, axes))
    assert (study.plane is not None) == (study.lines >= 1000)
    assert study.batches == batches
    numbers = [study.batch(k) for k in range(batches)]
    assert sorted(np.concatenate(numbers).tolist()) == list(range(study.lines))
    for k, each in enumerate(numbers):
        line, params = (
            study.batch_line(k),
            layers.line_params(study, Method.TASK, "design", study.batch_line(k)),
        )
        for i, number in enumerate(each.tolist()):
            own = study.line(number)
            assert own["walker"] == line["walker"]
            assert own["set"] == {
                key: float(values[i]) for key, values in line["set"].items()
            }
        assert ("plane" in params) == (study.plane is not None)
        if study.plane:
            assert len(np.unique(line["set"]["m_h"])) == 1
            assert params["plane"]["keys"] == ["R", "m_s"]


@pytest.mark.parametrize(
    ("walker", "axes", "keys"),
    [
        ('{ base = "B", push_off = 0.05 }', PLANE, ["R", "m_s"]),
        ('"B"', PLANE.replace("m_s", "push_off"), ["R", "push_off"]),
    ],
)
def test_driven_walkers_on_slopes_have_planes_as_passive_ones_have(
    walker, axes, keys, tmp_path
):
    study = read(written(tmp_path, walker, axes.format(n=25, m=20)))
    assert study.along == "slope"
    assert study.plane.region["keys"] == keys
    assert study.batches == 2


def test_a_plan_tells_what_designs_cost(tmp_path):
    few, many = (
        read(written(tmp_path, '"B"', PLANE.format(n=n, m=20))) for n in (5, 100)
    )
    assert many.plane and not few.plane
    each = [
        Graph(study).seconds("design") * study.batches / study.lines
        for study in (few, many)
    ]
    assert each[1] < 0.1 * each[0]
    planned = Plan(many, Journal(tmp_path / "journal"))
    todo = summary(planned)
    # The slopes are a window, of which each design is one answer.
    assert next(plan.lines(planned, todo, many.path)).startswith(
        "designs: 100 R x 2 m_h x 20 m_s, 4,000 designs ->"
    )
    assert todo.todo["design"] == {"new": 2}
    assert todo.seconds == pytest.approx(2 * Graph(many).seconds("design"), rel=0.3)


def test_the_slopes_of_curves_are_a_window_in_their_plan(tmp_path):
    path = tmp_path / "folds.toml"
    axes = "[axes]\nslope = [0.001, 0.1]\nR = [0.0, 0.05, 0.1]\n"
    options = '[options]\nkey = "w_t"\nfrom = 0.0\nto = 0.1\n'
    path.write_text(f'name = "folds"\nkind = "curve"\nwalker = "B"\n{axes}{options}')
    planned = Plan(read(path), Journal(tmp_path / "journal"))

    first = next(plan.lines(planned, summary(planned), path))

    assert first.startswith("folds: 3 R, 3 lines ->")


def test_a_plan_of_a_billion_designs_is_made_at_once(tmp_path):
    axes = "R = { from = 0.1, to = 0.12, n = 31623 }\nm_s = { from = 0.03, to = 0.04, n = 31623 }"
    study = read(written(tmp_path, '"B"', axes))
    assert study.batches == math.ceil(31623**2 / 65536)
    last = study.batch(study.batches - 1)
    assert last[-1] == study.lines - 1 and len(last) < 65536
    assert Graph(study).seconds("design") * study.batches > 3600


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    return [
        run(
            tmp_path_factory.mktemp(f"jobs{n}"), '"B"', PLANE.format(n=25, m=20), jobs=n
        )
        for n in (1, 2)
    ]


def test_two_workers_write_the_same_bytes(archives):
    assert archives[0].read_bytes() == archives[1].read_bytes()


def test_rows_follow_the_grid_and_hold_what_designs_hold_alone(archives, tmp_path):
    table = table_of(archives[0])
    assert len(table) == 1000
    assert table[["R", "m_h", "m_s"]].apply(tuple, axis=1).is_monotonic_increasing
    assert table.surveyed.mean() < 0.02
    rows = table[table.m_s.isin([0.03, 0.04]) & table.R.isin([0.1, 0.12])]
    axes = "R = [0.1, 0.12]\nm_h = [0.0, 0.02]\nm_s = [0.03, 0.04]"
    alone = table_of(run(tmp_path, '"B"', axes, jobs=1))
    assert (alone.surveyed == 1).all() and len(rows) == len(alone) == 8
    assert (rows.smallest_at.values == alone.smallest_at.values).all()
    assert (rows.stability_lost_by.values == alone.stability_lost_by.values).all()
    for name in ("largest_stable_slope", "fastest_stable_speed"):
        bound = rows[f"{name}_error"].values + alone[f"{name}_error"].values
        assert (np.abs(rows[name].values / alone[name].values - 1) <= bound).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            "at_slope = 0.5",
            r"`at_slope` must lie in \[1e-18, 0.5\) rad; got 0.5 \(designs.toml, options.at_slope\)",
        ),
        ("at_slope = 0.0", r"`at_slope` must lie in \[1e-18, 0.5\) rad; got 0.0"),
        ("at_speed = -1", r"`at_speed` must be above 0; got -1"),
        ("at_slope = 0.01\nground = 0.6", r"`ground` must lie in \[0, 0.5\]; got 0.6"),
        (
            "ground = 0.1",
            "`ground` needs the slope at which the walker walks, `at_slope`",
        ),
        ("at_sloop = 0.1", "Unknown key `at_sloop`, did you mean `at_slope`"),
    ],
)
def test_options_that_cannot_be_are_refused(tmp_path, options, message):
    path = written(tmp_path, '"B"', "R = [0.1, 0.2]")
    path.write_text(path.read_text() + f"[options]\n{options}\n")
    with pytest.raises(StudyError, match=message):
        read(path)


@pytest.mark.parametrize("key", ["push_off", "hip_torque"])
def test_no_cost_of_transport_is_told_that_gravity_pays_in_part(tmp_path, key):
    """That of maps is the sine of the slope."""
    path = written(tmp_path, '"B"', f"R = [0.1, 0.2]\n{key} = [0.0, 0.05]")
    read(path)
    path.write_text(path.read_text() + "[options]\nat_speed = 0.1\n")

    with pytest.raises(StudyError, match="`at_speed` must be left out of maps"):
        read(path)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        (
            "R = { from = 0.1, to = 2.0, n = 30 }\nm_s = { from = 0.03, to = 0.04, n = 30 }",
            "`R` must leave the hip above the foot's centre; got 2.0",
        ),
        (
            "m_s = { from = -0.1, to = 0.1, n = 30 }\nR = [0.1, 0.2]",
            "`m_s` must be >= 0; got -0.1",
        ),
        (
            "detuning = { from = 0.0, to = 1.0, n = 30 }\nR = [0.1, 0.2]",
            "detuning.*needs walker A or C",
        ),
        (
            "R = { from = 0.1, to = 0.1, n = 1 }",
            "`from` must be less than `to` = 0.1; got 0.1",
        ),
    ],
)
def test_planes_that_leave_the_walkers_are_refused(tmp_path, axes, message):
    with pytest.raises(StudyError, match=message):
        read(written(tmp_path, '"B"', axes))


def test_a_derived_key_is_not_contradicted(tmp_path):
    axes = "detuning = { from = 0.0, to = 1.0, n = 30 }\nr_t = { from = 0.1, to = 0.2, n = 30 }"
    with pytest.raises(
        StudyError,
        match="`r_t` is set by `detuning`, which owns w_t, r_t, c_t, w_s, r_s",
    ):
        read(written(tmp_path, '"A"', axes))
