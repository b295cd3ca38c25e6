"""Questions of few points are answered by code that is compiled quickly."""

import os
import subprocess
import sys
import time

import pytest

import gaitsweep
from gaitsweep.pipeline import dispatch, terminal
from gaitsweep.tasks.mechanics import kernel
from gaitsweep.tasks.mechanics.kernel import compact_code
from gaitsweep.tasks.studies import solve_points
from gaitsweep.tasks.studies.solve_at_slope import solve_one

STATE = ("stance_angle", "stance_rate", "thigh_rate", "period")
TOLD = "Compiling the equations of motion, once on this computer."
#: What a first answer may take [s of processor time], with knees and without: four to
#: seven times what it took.
FIRST = {"C": 18.0, "D": 9.0}


def gaits_of(walker):
    asked = {"walker": walker, "set": {}, "slope": 0.009, "all": False, "steps": 1}
    return solve_one(asked)["gaits"]


@pytest.mark.parametrize("walker", ["D", "E", "A", "C"])
def test_both_codes_agree_within_their_bounds(walker):
    with compact_code(print):
        answers = gaits_of(walker)

    for quick, full in zip(answers, gaits_of(walker), strict=True):
        bound = quick["error_bound"] + full["error_bound"]
        for name in STATE:
            assert abs(quick[name] / full[name] - 1) <= bound
        assert quick["multipliers"] != full["multipliers"], "both are the same code"


def test_only_questions_of_few_points_are_answered_by_it():
    for points, walkers, is_compact in (
        (1, 1, True),
        (10**4, 1, False),
        (99, 99, False),
    ):
        with dispatch.for_question(points, walkers):
            assert kernel.is_compact() == is_compact
    assert not kernel.is_compact()


def test_no_flow_is_compact_where_an_archive_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel, "FLOWS", {})
    study = {"name": "s", "walker": "D", "axes": {"slope": [0.008, 0.009]}}
    gaitsweep.run(study, jobs=1, archive=tmp_path / "s.nc", quiet=True)

    gaitsweep.gaits("D", 0.0093, m_h=0.777)  # which nothing remembers

    assert kernel.FLOWS and all(compact for *_, compact in kernel.FLOWS)


@pytest.mark.parametrize(
    ("walker", "keys", "slope", "phases"),
    [
        ("B", {"R": 0.2707}, 0.009, 1),
        ("B", {"R": 0.2707, "push_off": 0.13}, 0.0, 1),
        ("C", {"m_h": 0.0123}, 0.02, 2),
    ],
)
def test_a_question_takes_two_flows_of_a_phase(
    walker, keys, slope, phases, monkeypatch
):
    """One for the search, and one with the drive's direction for all else."""
    monkeypatch.setattr(kernel, "FLOWS", {})

    with compact_code(print):
        solve_one({"walker": walker, "set": keys, "slope": slope})

    searches = [key for key in kernel.FLOWS if key[3]]
    assert len(searches) == phases and len(kernel.FLOWS) == 2 * phases


def over_slopes(radius):
    line = {"walker": "B", "set": {"R": radius}}
    solve_points.atlas({"line": line, "coarse": True}, [])


def over_push_off(radius):
    keys = {"R": radius, "push_off": 0.13}
    solve_one({"walker": "B", "set": keys, "slope": 0.0})


@pytest.mark.parametrize("follow", [over_slopes, over_push_off])
def test_what_either_code_has_followed_the_other_follows_anew(follow, monkeypatch):
    """Branches are remembered in a process: answers of full code began at those of
    compact code, and depended in their last digits on what had been asked before.
    """
    monkeypatch.setattr(solve_points, "_MAX_SURVEYED", 8)

    def lanes(radius):
        before = integrated()
        follow(radius)
        return integrated() - before

    alone = lanes(0.2718)
    with compact_code(print):
        assert lanes(0.2719) == 0
    assert lanes(0.2719) > 0.8 * alone > 0


def integrated():
    """Lanes that full code has integrated."""
    return sum(flow.evaluations for key, flow in kernel.FLOWS.items() if not key[-1])


def test_who_waits_for_a_compiler_is_told_once(monkeypatch, capsys):
    monkeypatch.setattr(kernel, "FLOWS", {})
    monkeypatch.setattr(kernel, "_PATIENCE", 0.0)
    monkeypatch.setattr(kernel, "_waiting", kernel._Waiting())

    monkeypatch.setattr(terminal, "is_terminal", lambda: True)
    gaitsweep.solve("D", 0.00912, m_h=0.61)
    assert capsys.readouterr().err == f"gaitsweep: {TOLD}\n"

    # Nobody reads a pipe while it is written.
    monkeypatch.setattr(kernel, "FLOWS", {})
    monkeypatch.setattr(kernel, "_waiting", kernel._Waiting())
    monkeypatch.setattr(terminal, "is_terminal", lambda: False)
    gaitsweep.solve("D", 0.00912, m_h=0.62)
    assert capsys.readouterr().err == ""


def test_that_full_code_is_compiled_is_logged(monkeypatch, caplog):
    """By which runs, and commands at a terminal, tell who waits."""
    monkeypatch.setattr(kernel, "FLOWS", {})
    monkeypatch.setattr(kernel, "_PATIENCE", 0.0)
    monkeypatch.setattr(kernel, "_waiting", kernel._Waiting())

    gaits_of("D")  # nobody listens
    assert not caplog.messages and not kernel._waiting.is_told

    monkeypatch.setattr(kernel, "FLOWS", {})
    with caplog.at_level("INFO", "gaitsweep"):
        gaits_of("D")
    assert caplog.messages == [TOLD]


@pytest.mark.thorough
@pytest.mark.parametrize("walker", FIRST)
def test_a_first_answer_comes_soon(walker, tmp_path):
    """Nothing was compiled before: 30 s with knees by the code of archives."""
    first, seconds = solved(walker, tmp_path)
    assert seconds < FIRST[walker]

    again, _ = solved(walker, tmp_path)
    assert again.stdout == first.stdout


def solved(walker, folder):
    """What the command answers, and its processor time [s]."""
    command = [sys.executable, "-m", "gaitsweep", "solve", "--walker", walker]
    began = os.times()
    answer = subprocess.run(
        [*command, "--slope", "0.009"],
        env={**os.environ, "GAITSWEEP_CACHE": str(folder / "cache")},
        capture_output=True,
        text=True,
        check=True,
    )
    return answer, os.times().children_user - began.children_user


def test_who_compiles_something_else_meanwhile_is_told_once(monkeypatch):
    """Each of both told it, and their time was counted twice."""
    monkeypatch.setattr(kernel, "_PATIENCE", 0.05)
    waiting, told = kernel._Waiting(), []
    with waiting.telling(told.append), waiting.telling(told.append):
        time.sleep(0.2)
    assert told == [TOLD] and waiting.seconds < 0.35
