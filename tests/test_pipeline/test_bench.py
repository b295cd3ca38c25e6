"""The bench: its harness, its references and its peers, on the smallest run there is."""

import re

import numpy as np
import pytest
import xarray as xr

from pipeline import bench
from pipeline.bench import accuracies, bench_page, lines, machine, peers, problems
from pipeline.bench.harness import Case, largest_error, time_in_turns

SLOPE = 0.005


@pytest.fixture(scope="module")
def simplest():
    return problems.family("D", SLOPE)


def test_cases_take_turns():
    order = []
    cases = [Case("D", "stride", name, 0.0, lambda name=name: order.append(name)) for name in "ab"]
    time_in_turns(cases, 3, 0.0)
    assert "".join(order) == "ab" + "ababab"
    assert all(len(case.seconds) == 3 for case in cases)


def test_an_error_is_over_the_largest_entry_and_nan_where_nothing_was_found():
    assert largest_error(np.array([1.0, 4.004]), np.array([1.0, 4.0])) == pytest.approx(1e-3)
    assert np.isnan(largest_error(np.array([1.0, np.nan]), np.array([1.0, 4.0])))
    assert np.isnan(largest_error(np.ones(2), np.ones(3)))


def test_the_reference_is_a_gait(simplest):
    # The reference's own Newton step has nothing left to do but its rounding; double's is within the bound it gives.
    y, times, parameters = problems._lane(simplest, simplest.precise)
    again = simplest.precise.settled_stride(simplest.exact_y, times, parameters)
    assert float(abs(again["newton"]).max()) < 1e-25 if simplest.kind == "real128" else 1e-17
    assert largest_error(y, simplest.exact_y) < 1e-12


def test_every_tolerance_of_the_engine_is_kept(simplest, monkeypatch):
    monkeypatch.setattr(problems, "THEIRS", {})
    for case in problems.strides(simplest, quick=True):
        if case.method == "heyoka, lanes":
            # One stride multiplies the error of its steps by about the largest entry of its Jacobian, some tens.
            assert case.error < 300 * max(case.setting, 1e-16)


@pytest.mark.parametrize("method", ["DOP853", "LSODA"])
def test_scipy_takes_the_same_step(simplest, method):
    peer = peers.Peer(simplest.algebra, SLOPE, peers.by_scipy(method), 1e-11)
    found = peer.stride(simplest.y[:, 0] * simplest.scale[0])
    assert largest_error(found[:2], simplest.exact["image"].astype(float) * simplest.scale[0]) < 1e-8


def test_numba_takes_the_same_step(simplest):
    pytest.importorskip("numba")
    peer = peers.Peer(simplest.algebra, SLOPE, peers.by_numba(), 1e-13)
    found = peer.stride(simplest.y[:, 0] * simplest.scale[0])
    assert largest_error(found[:2], simplest.exact["image"].astype(float) * simplest.scale[0]) < 1e-11


def test_one_run_writes_an_archive_and_a_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(problems, "THEIRS", {"scipy DOP853": (1e-7, 1e-5)})
    monkeypatch.setattr(peers, "HAS_NUMBA", False)
    # The smallest studies that have every row of the page.
    monkeypatch.setattr(lines, "KEYS", {"E": lines.KEYS["E"]})
    monkeypatch.setattr(lines, "LINES", {True: (2, 4)})
    monkeypatch.setattr(accuracies, "_QUICK", 0.05)
    assert bench.main(True, tmp_path / "out", ("D",), 40) == 0
    assert capsys.readouterr().out.strip().endswith("bench.html")
    with xr.open_dataset(tmp_path / "out" / "bench.nc") as found:
        assert set(found.problem.values) == {"stride", "jacobian", "fixed point", "grid", "branch", "line"}
        assert (found.seconds_least <= found.seconds).all()
        assert (found.seconds <= found.seconds_most).all()
    with xr.open_dataset(tmp_path / "out" / "bench.nc", group="counts") as counts:
        # A point leaves the atlas by one Newton step, seldom by two.
        assert 1 <= float(counts.strides_a_gait[0]) < 1.5
        assert 0 < float(counts.share_in_flows_and_maps[0]) < 1
    with xr.open_dataset(tmp_path / "out" / "bench.nc", group="missed") as found:
        assert list(found.walker.values)[-1] == "all" and float(found.gaits[-1]) > float(found.missed[-1])
    page = (tmp_path / "out" / "bench.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 4
    assert "two variables" in page and "with multipliers" in page
    assert "Walker D" in page


def test_a_table_has_counts_in_all_their_digits_and_other_numbers_in_four():
    cells = dict(zip("abcdef", (12345.0, 0.0, 123.456, 1.5e-9, float("inf"), float("nan")), strict=True))
    found = re.findall("<td>(.*?)</td>", bench_page._table([cells]))
    assert found == ["12345", "0", "123.5", "1.5e-09", "inf", "nan"]


def test_the_machine_is_named_by_its_make_alone():
    import socket

    told = machine.describe()
    assert {"cpu", "cores", "heyoka"} <= set(told)
    assert not any(("/" in v and v.startswith("/")) or socket.gethostname() == v for v in told.values())
