"""The bench: its harness, its references and its peers, on the smallest run there is."""

from collections import Counter

import numpy as np
import pytest
import xarray as xr

from benchmarks import accuracies, grids, lines, machine, peers, planes, problems
from benchmarks.__main__ import main
from benchmarks.harness import Difference, largest_error
from soak import bounds, missed, stress

SLOPE = 0.005


@pytest.fixture(scope="module")
def simplest():
    return problems.family("D", SLOPE)


def test_an_error_is_over_the_largest_entry_and_nan_where_nothing_was_found():
    assert largest_error(np.array([1.0, 4.004]), np.array([1.0, 4.0])) == pytest.approx(
        1e-3
    )
    assert np.isnan(largest_error(np.array([1.0, np.nan]), np.array([1.0, 4.0])))
    assert np.isnan(largest_error(np.ones(2), np.ones(3)))


def test_the_reference_is_a_gait(simplest):
    # The reference's own Newton step has nothing left to do but its rounding; double's
    # is within the bound it gives.
    y, times, parameters = problems._lane(simplest, simplest.precise)
    again = simplest.precise.settled_stride(simplest.exact_y, times, parameters)
    assert float(abs(again["newton"]).max()) < (
        1e-25 if simplest.kind == "real128" else 1e-17
    )
    assert largest_error(y, simplest.exact_y) < 1e-12


def test_every_tolerance_of_the_engine_is_kept(simplest, monkeypatch):
    monkeypatch.setattr(problems, "THEIRS", {})
    for case in problems.strides(simplest, quick=True):
        if case.method == "heyoka, lanes":
            # One stride multiplies the error of its steps by about the largest entry of
            # its Jacobian, some tens.
            assert case.error < 300 * max(case.setting, 1e-16)


@pytest.mark.parametrize("method", ["DOP853", "LSODA"])
def test_scipy_takes_the_same_step(simplest, method):
    peer = peers.Peer(simplest.algebra, SLOPE, peers.by_scipy(method), 1e-11)
    found = peer.stride(simplest.y[:, 0] * simplest.scale[0])
    assert (
        largest_error(
            found[:2], simplest.exact["image"].astype(float) * simplest.scale[0]
        )
        < 1e-8
    )


def test_numba_takes_the_same_step(simplest):
    peer = peers.Peer(simplest.algebra, SLOPE, peers.by_numba(), 1e-13)
    found = peer.stride(simplest.y[:, 0] * simplest.scale[0])
    assert (
        largest_error(
            found[:2], simplest.exact["image"].astype(float) * simplest.scale[0]
        )
        < 1e-11
    )


def test_one_run_writes_an_archive_and_a_page(tmp_path, monkeypatch, capsys):
    # The smallest studies that have every row of the page; what is searched has tests
    # of its own.
    monkeypatch.setattr(problems, "THEIRS", {"scipy DOP853": (1e-7, 1e-5)})
    monkeypatch.setattr(
        grids,
        "QUICK",
        (
            grids.QUICK[0]._replace(
                slopes=6, keys={"foot_mass_ratio": (0.1, 0.2, 2, "log")}
            ),
        ),
    )
    monkeypatch.setattr(lines, "KEYS", {"E": lines.KEYS["E"]})
    monkeypatch.setattr(accuracies, "ACCURACIES", {True: (1e-3,)})
    monkeypatch.setattr(accuracies, "_COMPARED", {"line": 30})
    monkeypatch.setattr(planes, "_ACROSS", {True: (8, 9)})
    for module in (lines, accuracies, planes):
        monkeypatch.setattr(
            module,
            "what_more_take",
            lambda study, fewer, more: Difference(1e-3, more, 1e-3, fewer),
        )
    one = Counter(D=1)
    monkeypatch.setattr(missed, "missed", lambda numbers, draw: missed.Missed(one, one))
    monkeypatch.setattr(
        stress,
        "lanes",
        lambda count: stress.Outcomes({"point feet": Counter({"gait, long": count})}),
    )
    monkeypatch.setattr(
        bounds,
        "bounds",
        lambda each, walkers: bounds.Bounds(["D"], *np.full((4, 1), 1e-3), np.zeros(1)),
    )
    main(tmp_path / "out", True, ("D",), 40)
    assert capsys.readouterr().out.strip().endswith("bench.html")
    with xr.open_dataset(tmp_path / "out" / "bench.nc") as found:
        assert set(found.problem.values) == {
            "stride",
            "jacobian",
            "fixed point",
            "grid",
            "branch",
            "line",
        }
        assert (found.seconds_least <= found.seconds).all()
        assert (found.seconds <= found.seconds_most).all()
    with xr.open_dataset(tmp_path / "out" / "bench.nc", group="counts") as counts:
        # A point leaves the atlas by one Newton step, seldom by two.
        assert 1 <= float(counts.strides_a_gait[0]) < 1.5
        assert 0 < float(counts.share_in_flows_and_maps[0]) < 1
    with xr.open_dataset(tmp_path / "out" / "bench.nc", group="grids") as found:
        assert found.gaits.item() == 24 and found.s_of_one_point.item() > 0
    page = (tmp_path / "out" / "bench.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 4
    assert (
        "6 slopes × 2 foot_mass_ratio" in page
        and "two variables" in page
        and "with multipliers" in page
    )
    assert "Walker D" in page


def test_the_machine_is_named_by_its_make_alone():
    import socket

    told = machine.describe()
    assert {"cpu", "cores", "heyoka"} <= set(told)
    assert not any(
        ("/" in v and v.startswith("/")) or socket.gethostname() == v
        for v in told.values()
    )
