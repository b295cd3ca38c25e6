"""The hunt for the worst inputs: what it reports can be reproduced, and it would find
what is wrong.
"""

import json
import shlex

import numpy as np
import pytest

from gaitsweep.pipeline.cli.commands import main
from soak import hunt


@pytest.fixture(scope="module")
def feet():
    """A small hunt over the walker with point feet."""
    (where,) = [
        each
        for each in hunt.ranges()
        if each.walker == "E" and len(each.low) == 1 and not each.logarithmic
    ]
    return where, hunt.maximise("error bound", where, 0, 1)


def test_a_hunt_finds_nothing_wrong_and_lists_the_worst(feet):
    _, found = feet
    assert found.lines >= 9 and found.gaits > 10 and not found.wrong
    for name, worst in found.worst.items():
        values = [one.value for one in worst]
        assert values and values == sorted(values, reverse=True), name
        assert (
            len({tuple(one.keys.items()) for one in worst}) == len(worst) <= hunt.WORST
        )
    assert found.worst["true error over bound"][0].value < 1


def test_its_commands_print_the_gaits(feet, capsys):
    _, found = feet
    for name in ("fold", "error bound", "flip"):
        one = found.worst[name][0]
        command, *words = shlex.split(one.command)
        assert (command, main([*words, "--json"])) == ("gaitsweep", 0)
        angles = [gait["stance_angle"] for gait in json.loads(capsys.readouterr().out)]
        assert min(abs(angle / one.angle - 1) for angle in angles) < 1e-6


def test_keys_vanish_and_branches_come_near_each_other():
    (where,) = [
        each for each in hunt.ranges() if each.walker == "E" and each.logarithmic
    ]
    assert where.keys(np.array([0.0])) == {"foot_mass_ratio": pytest.approx(1e-13)}
    assert where.keys(np.array([1.0])) == {"foot_mass_ratio": pytest.approx(0.1)}
    assert where.keys(np.array([0.5])) == {"foot_mass_ratio": pytest.approx(1e-7)}
    # Of a slope's gaits on other branches the nearest counts, by its farthest
    # coordinate.
    place = np.array([[1.0, 1.5, 1.1, 1.0, np.nan], [2.0, 2.0, 2.2, 2.0, 2.0]])
    near = hunt._nearness(
        np.array([0.1, 0.1, 0.1, 0.2, 0.1]), np.array([0, 1, 2, 1, 3]), place
    )
    np.testing.assert_allclose(near[:3], [5, 2.5, 5])
    assert (near[3:] == -np.inf).all()


def test_what_is_wrong_is_told_with_its_command(feet, monkeypatch):
    where, _ = feet
    original, settle = hunt.compared, hunt.settle_on_branches

    def too_small(problem, guesses):
        return [
            (slope, bound, 3 * bound, *rest)
            for slope, bound, _, *rest in original(problem, guesses)
        ]

    def lost(problem, guesses, places):
        gaits = settle(problem, guesses, places)
        gaits.converged[-1] = False
        return gaits

    monkeypatch.setattr(hunt, "compared", too_small)
    found = hunt.maximise("error bound", where, 0, 1)
    assert {what for what, _ in found.wrong} == {
        "true error over bound"
    } and "wrong" in str(found)
    assert all(
        one.value == pytest.approx(3)
        and one.command.startswith("gaitsweep solve --walker E ")
        for _, one in found.wrong
    )
    monkeypatch.setattr(hunt, "settle_on_branches", lost)
    assert {what for what, _ in hunt.maximise("error bound", where, 0, 1).wrong} >= {
        "not converged"
    }
    assert found.rows()[-1].endswith(found.wrong[-1][1].command)


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_no_hunted_input_is_wrong(tell):
    found = hunt.hunt(say=tell)
    tell("\n".join([str(found), *found.rows()]))
    assert not found.wrong
