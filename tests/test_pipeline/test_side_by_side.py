"""Lines side by side: the same archives as line by line, whatever ends a run, divides
it or changes its grid.
"""

import contextlib
import itertools
import json
import random
import signal

import numpy as np
import pytest

from conftest import STUDY, Toy
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.study import parse
from processes import companions, damaged, wait_for_points

SIDE_BY_SIDE = {"TOY_SIDE_BY_SIDE": "toy:lines"}
GRID = STUDY.replace("n = 200", "n = 8").replace(
    "[0.0, 0.25]", "{ from = 0.0, to = 0.3, n = 151 }"
)
#: 151 lines of 8 points, whose atlases nobody reads.
PLAIN = GRID.replace('fits = ["scaling"]\n', "")
#: The same, with atlases that a fit reads.
READ = GRID.replace('["scaling"]', '["transition"]')


def chunks(toy):
    """Events of the last run that hold points."""
    events = [
        json.loads(line) for line in companions(toy).events.read_text().splitlines()
    ]
    begin = max(i for i, event in enumerate(events) if event["event"] == "begin")
    return [event for event in events[begin:] if event["event"] == "chunk"]


@pytest.fixture(scope="module")
def wholes(tmp_path_factory):
    """Archives of the grids from undisturbed runs."""
    archives = {}
    for k, text in enumerate((GRID, PLAIN, READ)):
        toy = Toy(tmp_path_factory.mktemp(str(k)))
        toy.write(text)
        toy("run", "toy.toml", **SIDE_BY_SIDE)
        archives[text] = toy.bytes()
        archives[text, "file"] = toy.folder / "data" / "archive" / "toy.nc"
    return archives


def test_they_hold_what_lines_by_themselves_do(toy, wholes):
    """Their archives have other chunks."""
    toy.write(GRID)
    toy("run", "toy.toml")
    assert (
        "They agree." in toy("diff", "data/archive/toy.nc", wholes[GRID, "file"]).stdout
    )


@pytest.mark.parametrize("text", [GRID, PLAIN, READ])
@pytest.mark.parametrize("options", [("--jobs", 1), ("--jobs", 3, "--chunk", 100)])
def test_jobs_and_chunks_change_no_byte(toy, wholes, text, options):
    toy.write(text)
    toy("run", "toy.toml", *options, **SIDE_BY_SIDE)
    assert toy.bytes() == wholes[text]
    assert (
        sum(event["points"] for event in chunks(toy)) == 151 * 8
        and len(chunks(toy)) < 12
    )
    assert {event["task"] for event in chunks(toy)} == {"points"}
    plan = toy("plan", "toy.toml", **SIDE_BY_SIDE).stdout
    assert "per line: 151 cached" in plan and "per point: 1,208 cached" in plan
    toy("run", "toy.toml", **SIDE_BY_SIDE)
    assert toy.bytes() == wholes[text] and not chunks(toy)


def test_a_stopped_run_computes_no_chunk_twice(toy, wholes):
    toy.write(PLAIN)
    process = toy.start(
        "run", "toy.toml", "--jobs", "1", TOY_SECONDS="0.002", **SIDE_BY_SIDE
    )
    wait_for_points(toy, 2)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    done = sum(event["points"] for event in chunks(toy))
    toy("run", "toy.toml", **SIDE_BY_SIDE)
    assert toy.bytes() == wholes[PLAIN]
    assert (
        0 < done < 151 * 8
        and done + sum(event["points"] for event in chunks(toy)) <= 151 * 8 + 64 * 8
    )


@pytest.mark.parametrize("text", [GRID, PLAIN])
def test_a_grid_reuses_the_chunks_that_it_shares(toy, text):
    """Lines are in chunks of 64: those that follow others of a shorter axis are new."""
    shorter = text.replace("to = 0.3, n = 151", "to = 0.256, n = 129")
    toy.write(shorter)
    toy("run", "toy.toml", **SIDE_BY_SIDE)
    toy.write(text)
    plan = toy("plan", "toy.toml", **SIDE_BY_SIDE).stdout
    assert f"per point: {(151 - 128) * 8} new, {128 * 8:,} cached" in plan
    toy("run", "toy.toml", **SIDE_BY_SIDE)
    longer = toy.bytes()
    assert sum(event["points"] for event in chunks(toy)) == (151 - 128) * 8
    toy("run", "toy.toml", "--fresh", **SIDE_BY_SIDE)
    assert toy.bytes() == longer


@pytest.mark.parametrize("lines", [151, 8])
def test_axes_may_be_named_in_another_order(toy, lines):
    """Numbers of as many lines as slopes were transposed without a word."""
    text = PLAIN.replace("n = 151", f"n = {lines}")
    head, slope, rest = text.partition("slope = { from = 0.01, to = 0.2, n = 8 }\n")
    toy.write(text)
    toy("run", "toy.toml", **SIDE_BY_SIDE)
    toy.write(f"{head}{rest.replace('[want]', f'{slope}[want]')}")
    toy("run", "toy.toml", **SIDE_BY_SIDE)
    turned = toy.bytes()
    toy("run", "toy.toml", "--fresh", **SIDE_BY_SIDE)
    assert toy.bytes() == turned and chunks(toy)


@pytest.mark.parametrize("environment", [{}, SIDE_BY_SIDE])
def test_a_walker_with_knees_may_join_and_leave(toy, environment):
    """It has four multipliers, and the others' are archived with as many; theirs of
    before were three.
    """
    few = PLAIN.replace("n = 151", "n = 21")
    both = few.replace('"E"', '["E", "C"]')
    archives = {}
    for text in (few, both, few):
        toy.write(text)
        toy("run", "toy.toml", **environment)
        archives.setdefault(text, toy.bytes())
        assert toy.bytes() == archives[text]
        assert toy("verify", "data/archive/toy.nc").stdout.count("intact") == 1
    toy.write(both)
    toy("run", "toy.toml", "--fresh", **environment)
    assert toy.bytes() == archives[both]


def test_more_slopes_and_other_variables_change_every_chunk(toy):
    toy.write(PLAIN)
    toy("run", "toy.toml", **SIDE_BY_SIDE)
    toy.write(PLAIN.replace("n = 8", "n = 9"))
    assert "per point: 1,359 new" in toy("plan", "toy.toml", **SIDE_BY_SIDE).stdout
    toy.write(PLAIN.replace('"multipliers"', '"period"'))
    assert "per point: 1,208 changed" in toy("plan", "toy.toml", **SIDE_BY_SIDE).stdout
    assert (
        "per point: 1,208 changed"
        in toy("plan", "toy.toml", TOY_VERSIONS="atlas=2", **SIDE_BY_SIDE).stdout
    )


@pytest.mark.parametrize("trouble", ["segfault", "raise"])
def test_one_bad_point_of_each_line_costs_these_alone(toy, trouble):
    toy.write(PLAIN.replace("n = 151", "n = 3") + "[limits]\nseconds = 5\n")
    slope = np.linspace(0.01, 0.2, 8)[3]
    toy("run", "toy.toml", expect=1, TOY_TROUBLE=f"{trouble}@{slope}", **SIDE_BY_SIDE)
    once = toy.bytes()
    (event,) = chunks(toy)
    assert event["counts"] == {
        "converged": 21,
        {"segfault": "worker_died", "raise": "raised"}[trouble]: 3,
    }
    assert (
        "24 retried" in toy("plan", "toy.toml", "--retry-failed", **SIDE_BY_SIDE).stdout
    )
    toy("run", "toy.toml", expect=1, **SIDE_BY_SIDE)
    assert toy.bytes() == once and not chunks(toy)
    toy("run", "toy.toml", "--retry-failed", **SIDE_BY_SIDE)
    retried = toy.bytes()
    toy("run", "toy.toml", "--fresh", **SIDE_BY_SIDE)
    assert toy.bytes() == retried


@pytest.mark.parametrize("text", [PLAIN, READ])
def test_a_line_without_an_atlas_fails_alone(toy, text):
    bad = text.replace(
        "{ from = 0.0, to = 0.3, n = 151 }", "[0.0, 0.5, 13.0]"
    )  # 13 is what the toy refuses
    toy.write(bad)
    toy("run", "toy.toml", expect=1, **SIDE_BY_SIDE)
    (event,) = chunks(toy)
    assert event["counts"] == {"converged": 16, "raised": 8}
    plan = toy("plan", "toy.toml", "--retry-failed", **SIDE_BY_SIDE).stdout
    assert "per point: 24 retried" in plan  # with its chunk


@pytest.mark.parametrize("times", [2, pytest.param(60, marks=pytest.mark.soak)])
def test_a_damaged_journal_gives_the_same_bytes(toy, wholes, tell, times):
    dice, again = random.Random(times), 0
    toy.write(READ)
    toy("run", "toy.toml", **SIDE_BY_SIDE)
    made = companions(toy).journal.read_bytes()
    for _ in range(times):
        companions(toy).journal.write_bytes(made[:100] + damaged(made[100:], dice))
        for file in (companions(toy).events, companions(toy).archive):
            file.unlink()
        toy("run", "toy.toml", **SIDE_BY_SIDE)
        assert toy.bytes() == wholes[READ]
        again += bool(chunks(toy))
        toy("run", "toy.toml", **SIDE_BY_SIDE)
        assert toy.bytes() == wholes[READ] and not chunks(toy)
    tell(
        f"{times} damaged journals of lines: equal bytes after each, {again} with lines computed again"
    )


def _grid(tmp_path, axes):
    (tmp_path / "s.toml").write_text(
        f'name = "s"\nwalker = ["E", "D"]\n[axes]\n{axes}\n'
    )
    return parse.read(tmp_path / "s.toml")


def test_the_key_of_a_chunk_tells_its_walkers_values_and_slopes(tmp_path):
    axes = "slope = [0.01]\nR = [0.0, 0.1, 0.2]\ng = [1.0, 2.0]"
    texts = [
        axes,
        axes.replace("0.01", "0.02"),
        axes.replace("0.2", "0.25"),
        "slope = [0.01]\ng = [1.0, 2.0]\nR = [0.0, 0.1, 0.2]",
    ]
    keys = []
    for text in (*texts, axes):
        graph = Graph(_grid(tmp_path, text))
        keys.append(graph.chunk_key(graph.grid.chunk(0)))
    assert len(set(keys[:-1])) == len(texts) and keys[-1] == keys[0]


def test_a_plane_of_ten_million_lines_is_planned_at_once(tmp_path):
    study = _grid(
        tmp_path,
        "slope = [0.01]\nR = { from = 0.0, to = 0.1, n = 5000 }\ng = { from = 1, to = 2, n = 1000 }",
    )
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        plan = Plan(study, store)
        assert summary(plan).todo["points"] == {"new": 10**7}
        charts, first = itertools.islice(plan.nodes(), 2)
        (needed,) = plan.graph.charts_of(first.chunk, lambda _: [])

    # The lines over R are a plane, which all values of g share.
    assert charts.task == "charts" and needed.key == charts.key
    assert summary(plan).todo["charts"] == {"new": 10**7}
    # Chunks of 512 lines hold 32 values of g, the last of 1000 eight.
    assert first.points == len(first.chunk.numbers) == 16_384
    assert plan.graph.grid.chunks == 2 * 10 * 32
