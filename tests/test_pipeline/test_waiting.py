"""Who waits long for the answer of a question is told what is done."""

import threading

import pytest

from gaitsweep.pipeline import dispatch, terminal
from gaitsweep.pipeline.study import single_point


@pytest.fixture
def said(monkeypatch):
    """What a terminal is told while a question waits up to a tenth of a second."""
    said, told = [], threading.Event()

    def say(sentence):
        said.append(sentence)
        told.set()

    def answer(name, params):
        told.wait(0.1)
        return {}

    monkeypatch.setattr(terminal, "is_terminal", lambda: True)
    monkeypatch.setattr(terminal, "say", say)
    monkeypatch.setattr(single_point, "ask", answer)
    return said


def test_gaits_of_several_steps_that_take_long_say_why(said, monkeypatch):
    monkeypatch.setattr(dispatch, "_PATIENCE", 0.0)

    single_point.solve("D", 0.016, {}, False, steps=4)

    assert said == ["gaitsweep: Following gaits of up to 4 steps over all slopes."]


def test_an_answer_that_comes_soon_says_nothing(said):
    single_point.solve("D", 0.016, {}, False, steps=4)

    assert not said


def test_gaits_of_one_step_are_not_followed_for_long(said, monkeypatch):
    monkeypatch.setattr(dispatch, "_PATIENCE", 0.0)

    single_point.solve("D", 0.016, {}, False)

    assert not said
