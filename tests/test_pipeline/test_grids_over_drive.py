"""Grids over what drives at a fixed slope: long lines by polynomials, and planes of keys
by charts, agree with single gaits and with lines of one value each.
"""

import numpy as np
import pytest

import gaitsweep
from gaitsweep import solve
from gaitsweep.pipeline.api import in_memory
from gaitsweep.pipeline.cli.commands import main
from gaitsweep.pipeline.grid.choose_method import method_of
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.statuses import ALL_STATUSES
from gaitsweep.pipeline.study.parse import parse

WANT = ["stance_angle", "period", "cost_of_transport"]


def study(walker, axes, want=WANT, slope=(0.0,), **more):
    about = {
        "name": "s",
        "walker": walker,
        "axes": {"slope": list(slope), **axes},
        "want": {"variables": want},
    }
    return about | more


def checked(tmp_path, table):
    return parse(table, "", tmp_path / "s.toml")


def run(folder, table):
    return gaitsweep.run(table, jobs=1, archive=folder / "s.nc", quiet=True)


def assert_holds_single_gaits(
    found, walker, points, variables=("stance_angle", "period")
):
    """At points, the keys of each, within the sum of both bounds."""
    for at in points:
        keys = {key: value for key, value in at.items() if key != "slope"}

        single = solve(walker, at.get("slope", 0.0), **keys)
        point = found.sel(slope=at.get("slope", 0.0), **keys)
        assert int((point["status"] == "converged").sum()) == len(single)

        for gait in single.set_index("gait").itertuples():
            stored = point.sel(gait=gait.Index)
            within = float(stored["error_bound"]) + gait.error_bound
            for name in variables:
                off = abs(float(stored[name]) / getattr(gait, name) - 1)
                assert off <= within, (at, gait.Index, name)


def drawn(found, count, *keys):
    draw = np.random.default_rng(3)
    for _ in range(count):
        yield {key: float(draw.choice(found[key].values)) for key in keys}


def test_a_long_line_over_a_push_off_is_interpolated_within_its_bounds(tmp_path):
    """Gaits of B begin and vanish within the range."""
    pushes = {"from": 0.02, "to": 0.6, "n": 4000}
    table = study("B", {"push_off": pushes}, accuracy=1e-8)

    assert method_of(checked(tmp_path, table)) is Method.INTERPOLATED

    found = run(tmp_path, table)

    assert float(found["error_bound"].max()) <= 1e-8
    assert_holds_single_gaits(found, "B", drawn(found, 4, "push_off"))


def test_lines_over_a_push_off_have_what_lines_of_one_value_have(tmp_path):
    """Values of 0 among them, at which nothing drives."""
    pushes = [0.0, 0.03, 0.5]
    table = study("D", {"push_off": pushes}, slope=[-0.002, 0.0])

    found = run(tmp_path, table)

    points = [
        {"slope": slope, "push_off": push}
        for slope in (-0.002, 0.0)
        for push in pushes[1:]
    ]
    assert checked(tmp_path, table).drive == "push_off"
    assert (found["status"].sel(push_off=0.0) == "no_gait").all()
    assert_holds_single_gaits(found, "D", points)


def test_bytes_of_lines_over_what_drives_do_not_depend_on_workers_and_chunks(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(
        'name = "s"\nwalker = "D"\naccuracy = 1e-6\n[axes]\nslope = [0.0]\n'
        "push_off = { from = 0.03, to = 0.4, n = 300 }\n"
        '[want]\nvariables = ["stance_angle"]\n'
    )
    made = []

    for jobs, chunk in (("1", "300"), ("2", "37")):
        archive = tmp_path / f"{chunk}.nc"
        where = ["--archive", str(archive), "--quiet"]
        main(["run", str(path), "--jobs", jobs, "--chunk", chunk, *where])
        made.append(archive.read_bytes())

    assert made[0] == made[1]


@pytest.mark.parametrize(
    ("more", "along"),
    [
        ({}, "push_off"),
        ({"slope": [0.0, 0.01]}, "slope"),
        ({"slope": [0.01]}, "slope"),
        ({"axes": {"push_off": [0.1]}}, "slope"),
    ],
)
def test_grids_are_along_what_drives_where_slopes_do_not(more, along, tmp_path):
    given = {"axes": {"push_off": [0.0, 0.1, 0.2]}} | more

    assert checked(tmp_path, study("B", **given)).along == along


def test_a_torque_turns_no_legs_without_inertia(tmp_path):
    table = study("D", {"hip_torque": [0.1, 0.2], "push_off": [0.1, 0.2]})
    assert checked(tmp_path, table).along == "push_off"

    del table["axes"]["push_off"]
    table["walker"] = {"base": "D", "push_off": 0.1}
    assert checked(tmp_path, table).along == "slope"


@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", [{}, {"accuracy": 1e-8}])
def test_a_plane_over_the_push_off_and_a_key_is_by_charts(accuracy, tmp_path):
    """Steps of B vanish along a curve through it; its mass, and so the unit of impulses,
    changes.
    """
    axes = {
        "push_off": {"from": 0.03, "to": 0.2, "n": 12},
        "m_h": {"from": 0.8, "to": 1.6, "n": 60},
    }
    table = study("B", axes, **accuracy)

    assert method_of(checked(tmp_path, table)) is Method.PLANE

    found = run(tmp_path, table)

    assert (found["status"] == "no_gait").sel(gait="short").any()
    assert_holds_single_gaits(found, "B", drawn(found, 10, "push_off", "m_h"))


@pytest.mark.thorough
def test_driven_walkers_on_slopes_have_charts_as_passive_ones_have(tmp_path):
    axes = {
        "slope": {"from": 0.005, "to": 0.03, "n": 10},
        "R": {"from": 0.05, "to": 0.25, "n": 60},
    }
    walker = {"base": "B", "push_off": 0.05}
    table = study(walker, axes) | {"axes": axes}

    assert method_of(checked(tmp_path, table)) is Method.PLANE

    found = run(tmp_path, table)

    points = list(drawn(found, 10, "slope", "R"))
    for at in points:
        at["push_off"] = 0.05
    found = found.expand_dims(push_off=[0.05])
    assert_holds_single_gaits(found, "B", points)


def assert_is_single(point, walker, slope, **keys):
    """A point of `gaits` is a gait found alone, within the sum of both bounds."""
    single = solve(walker, slope, **keys)
    point = point.sel(gait=list(single["gait"]))
    assert (point["status"] == ALL_STATUSES["converged"]).all()

    off = np.abs(point["stance_angle"].values / single["stance_angle"] - 1)
    within = point["error_bound"].values + single["error_bound"]
    assert (off <= within).all()


class Asked:
    """Lines and points that were asked of the tasks."""

    def __init__(self, monkeypatch):
        self.along = []
        original = in_memory._solve

        def solved(lines):
            self.along += [(one.along, len(one.at)) for one in lines]
            return original(lines)

        monkeypatch.setattr(in_memory, "_solve", solved)


def test_gaits_of_arrays_are_solved_along_what_drives(monkeypatch):
    """On level ground and uphill; downhill along the slope, as studies have them. What
    cannot be has its own status.
    """
    asked = Asked(monkeypatch)
    slope = np.array([-0.001, 0.0, 0.01])
    push = np.array([0.0, 0.05, 0.2, 0.1, -1.0])

    found = gaitsweep.gaits("D", slope[:, None], push_off=push)

    assert sorted(asked.along) == [*[("push_off", 3)] * 2, *[("slope", 1)] * 4]
    has_raised = found["status"] == ALL_STATUSES["raised"]
    assert has_raised[:, 4].all()
    assert has_raised[:2, 0].all()
    assert not has_raised[:, 1:4].any()
    for i, j in ((0, 2), (1, 1), (2, 3)):
        point = found.isel(dim_0=i, dim_1=j)
        assert_is_single(point, "D", slope[i], push_off=push[j])


def test_gaits_of_arrays_are_those_of_a_study_over_what_drives(tmp_path):
    """But for rounding, which is that of compact code; lines of two walkers are surveyed
    side by side.
    """
    want = ["stance_angle", "cost_of_transport", "sensitivities"]
    push, m_h = [0.05, 0.1, 0.2], [0.9, 1.1]
    stored = run(tmp_path, study("B", {"push_off": push, "m_h": m_h}, want=want))

    found = gaitsweep.gaits(
        "B", 0.0, push_off=np.array(push)[:, None], m_h=m_h, variables=want
    )

    found = found.sel(gait=stored["gait"].values)
    for name in ("stance_angle", "cost_of_transport", "stance_angle_by_key"):
        there = stored[name].sel(slope=0.0).transpose("push_off", "m_h", "gait", ...)
        np.testing.assert_allclose(found[name], there, rtol=1e-9, atol=1e-9)


def test_a_torque_between_legs_without_inertia_is_told_point_by_point(monkeypatch):
    asked = Asked(monkeypatch)

    gaitsweep.gaits("D", 0.0, hip_torque=np.array([0.01, 0.02]), push_off=0.1)

    assert sorted(asked.along) == [("slope", 1)] * 2
