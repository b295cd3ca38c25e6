"""Blocks of short lines: the same archives as line by line, whatever ends a run, divides it or changes its grid."""

import contextlib
import json
import random
import signal

import numpy as np
import pytest

from conftest import STUDY, Toy
from pipeline.plan.blocks import Blocks
from pipeline.plan.missing import Plan, summary
from pipeline.store.journal import Journal
from pipeline.study import parse
from processes import damaged, wait_for_points
from processes import sidecar_path as sidecar

BLOCKS = {"TOY_SIDE_BY_SIDE": "toy:lines"}
PLANE = STUDY.replace("n = 200", "n = 8").replace("[0.0, 0.25]", "{ from = 0.0, to = 0.3, n = 151 }")
#: 151 lines of 8 points, whose atlases nobody reads.
PLAIN = PLANE.replace('fits = ["scaling"]\n', "")


def chunks(toy):
    """Events of the last run that hold points."""
    events = [json.loads(line) for line in sidecar(toy, ".events.jsonl").read_text().splitlines()]
    begin = max(i for i, event in enumerate(events) if event["event"] == "begin")
    return [event for event in events[begin:] if event["event"] == "chunk"]


@pytest.fixture(scope="module")
def apart(tmp_path_factory):
    """Archives of the two planes, computed line by line."""
    archives = {}
    for name, text in (("plane", PLANE), ("plain", PLAIN)):
        toy = Toy(tmp_path_factory.mktemp(name))
        toy.write(text)
        toy("run", "toy.toml")
        archives[text] = toy.bytes()
    return archives


@pytest.mark.parametrize("text", [PLANE, PLAIN])
@pytest.mark.parametrize("jobs", [1, 3])
def test_blocks_give_the_bytes_of_lines(toy, apart, text, jobs):
    toy.write(text)
    toy("run", "toy.toml", "--jobs", jobs, **BLOCKS)
    assert toy.bytes() == apart[text]
    assert sum(event["points"] for event in chunks(toy)) == 151 * 8 and len(chunks(toy)) < 12
    assert {event["task"] for event in chunks(toy)} == {"points"}
    plan = toy("plan", "toy.toml", **BLOCKS).stdout
    assert "per line: 151 cached" in plan and "per point: 1,208 cached" in plan
    toy("run", "toy.toml", **BLOCKS)
    assert toy.bytes() == apart[text] and not chunks(toy)


def test_a_stopped_run_computes_no_block_twice(toy, apart):
    toy.write(PLAIN)
    process = toy.start("run", "toy.toml", "--jobs", "1", TOY_SECONDS="0.002", **BLOCKS)
    wait_for_points(toy, 2)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    done = sum(event["points"] for event in chunks(toy))
    toy("run", "toy.toml", **BLOCKS)
    assert toy.bytes() == apart[PLAIN]
    assert 0 < done < 151 * 8 and done + sum(event["points"] for event in chunks(toy)) <= 151 * 8 + 64 * 8


@pytest.mark.parametrize("text", [PLANE, PLAIN])
def test_a_denser_plane_reuses_the_lines_it_shares(toy, text):
    toy.write(text)
    toy("run", "toy.toml", **BLOCKS)
    toy.write(text.replace("n = 151", "n = 301"))
    plan = toy("plan", "toy.toml", **BLOCKS).stdout
    new = int(plan.split("per point: ")[1].split(" new")[0].replace(",", ""))
    # Some values of the finer axis have other last bits.
    assert 150 * 8 <= new < 200 * 8
    toy("run", "toy.toml", **BLOCKS)
    dense = toy.bytes()
    assert sum(event["points"] for event in chunks(toy)) == new
    toy("run", "toy.toml", "--fresh", **BLOCKS)
    assert toy.bytes() == dense


def test_more_slopes_and_other_variables_change_every_block(toy):
    toy.write(PLAIN)
    toy("run", "toy.toml", **BLOCKS)
    toy.write(PLAIN.replace("n = 8", "n = 9"))
    assert "per point: 1,359 changed" in toy("plan", "toy.toml", **BLOCKS).stdout
    toy.write(PLAIN.replace('"multipliers"', '"period"'))
    assert "per point: 1,208 changed" in toy("plan", "toy.toml", **BLOCKS).stdout
    assert "per point: 1,208 changed" in toy("plan", "toy.toml", TOY_VERSIONS="atlas=2", **BLOCKS).stdout


@pytest.mark.parametrize("trouble", ["segfault", "raise"])
def test_lines_that_fail_in_a_block_are_kept_and_retried_by_themselves(toy, trouble):
    toy.write(PLAIN.replace("n = 151", "n = 4") + "[limits]\nseconds = 5\n")
    slope = np.linspace(0.01, 0.2, 8)[3]
    bad = {"TOY_TROUBLE": f"{trouble}@{slope}"}
    toy("run", "toy.toml", expect=1, **BLOCKS, **bad)
    once = toy.bytes()
    assert "4 retried" in toy("plan", "toy.toml", "--retry-failed", **BLOCKS).stdout
    toy("run", "toy.toml", expect=1, **BLOCKS)
    assert toy.bytes() == once and not chunks(toy)
    toy("run", "toy.toml", "--retry-failed", **BLOCKS)
    assert sum(event["points"] for event in chunks(toy)) == 4
    retried = toy.bytes()
    toy("run", "toy.toml", "--fresh", **BLOCKS)
    assert toy.bytes() == retried


@pytest.mark.parametrize("times", [2, pytest.param(60, marks=pytest.mark.soak)])
def test_a_damaged_journal_of_blocks_gives_the_same_bytes(toy, apart, tell, times):
    dice, again = random.Random(times), 0
    toy.write(PLANE)
    toy("run", "toy.toml", **BLOCKS)
    made = sidecar(toy).read_bytes()
    for _ in range(times):
        sidecar(toy).write_bytes(damaged(made, dice))
        for what in (".events.jsonl", ".nc"):
            sidecar(toy, what).unlink()
        toy("run", "toy.toml", **BLOCKS)
        assert toy.bytes() == apart[PLANE]
        again += bool(chunks(toy))
        toy("run", "toy.toml", **BLOCKS)
        assert toy.bytes() == apart[PLANE] and not chunks(toy)
    tell(f"{times} damaged journals of blocks: equal bytes after each, {again} with lines computed again")


def _plane(tmp_path, axes):
    (tmp_path / "s.toml").write_text(f'name = "s"\nwalker = ["E", "D"]\n[axes]\n{axes}\n')
    return parse.read(tmp_path / "s.toml")


def test_digests_name_lines_by_their_walker_and_values(tmp_path):
    study = _plane(tmp_path, "slope = [0.01]\nR = [0.0, 0.1, 0.2]\ng = [1.0, 2.0]")
    other = _plane(tmp_path, "slope = [0.02]\ng = [3.0, 2.0, 1.0]\nR = [0.2, 0.1]")
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        named = []
        for s in (study, other):
            digests = Blocks(s, Plan(s, journal).layers).digests(np.arange(s.lines))
            named.append({json.dumps(s.line(i), sort_keys=True): digests[i].tobytes() for i in range(s.lines)})
    for names in named:
        assert len(set(names.values())) == len(names) == 12
    shared = set(named[0]) & set(named[1])
    assert len(shared) == 8 and all(named[0][line] == named[1][line] for line in shared)
    assert not {named[0][line] for line in set(named[0]) - shared} & set(named[1].values())


def test_a_plane_of_ten_million_lines_is_planned_at_once(tmp_path):
    study = _plane(
        tmp_path, "slope = [0.01]\nR = { from = 0.0, to = 0.1, n = 5000 }\ng = { from = 1, to = 2, n = 1000 }"
    )
    plan = Plan(study, Journal(tmp_path / "j"))
    assert summary(plan).todo["points"] == {"new": 10**7}
    first = next(plan.works())
    # For each g the values of R are one cell of a plane.
    assert len(first.lines) == 5000 and Blocks(study, plan.layers).count == 2000
    plan.journal.close()
