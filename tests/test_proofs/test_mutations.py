"""Proofs must break when the physics or the rigour is altered: each change to the
source is made, and seen.
"""

import importlib
import inspect
import sys

import pytest
from flint import ctx

from exact_gaits import check_durations, check_remainder, guess, reference, setting
from gaitsweep.tasks.proofs.gait import prove

#: Changes of the equations: module, what stands there, what is put in its place, and
#: gaits whose proof it must break.
PHYSICS = {
    "sign of the swing leg's weight": (
        "motion",
        "turning - swing_weights[j]",
        "turning + swing_weights[j]",
        "DA",
    ),
    "sign of the knee's centrifugal term": (
        "motion",
        "force[1] += product",
        "force[1] -= product",
        "C",
    ),
    "sign in the mass matrix": (
        "motion",
        "whole_y = hinge_y + body.R * y",
        "whole_y = hinge_y - body.R * y",
        "A",
    ),
    "mass of one shank": (
        "body",
        '2 * (k["m_t"] + k["m_s"])',
        '2 * k["m_t"] + k["m_s"]',
        "AC",
    ),
    "inertia of the shank": (
        "body",
        'shank_centre) + k["r_s"] ** 2',
        "shank_centre)",
        "AC",
    ),
    "eps_S dropped": ("body", "sin_S = zero if", "sin_S = zero if True or", "AC"),
    "knee on the other side": (
        "body",
        '-k["l_t"]).turned(cos_T, -sin_T)',
        '-k["l_t"]).turned(cos_T, sin_T)',
        "AC",
    ),
    "no rolling while swinging": (
        "motion",
        "self.rolling = of_foot * sin",
        "self.rolling = 0 * of_foot",
        "AC",
    ),
    "no rolling at impacts": (
        "collisions",
        "-body.l * cos - body.R,",
        "-body.l * cos,",
        "AC",
    ),
    "stance knee of the impact free": (
        "collisions",
        "own = inertia + body.coupling.x",
        "own = inertia",
        "C",
    ),
    "impulse at the wrong foot": (
        "collisions",
        "hip_before = _hip(body, old)",
        "hip_before = _hip(body, new)",
        "DAC",
    ),
}
#: Changes of the enclosure: module, what stands there, what is put in its place, and
#: the lemma that fails.
RIGOUR = {
    "no remainder": (
        "enclosure",
        "return [[*s, r] for s, r in",
        "return [[*s, 0 * r] for s, r in",
        check_remainder,
    ),
    "remainder of one state": (
        "enclosure",
        "    box = enclose(body, slope, start, h)\n",
        "    box = start\n",
        check_remainder,
    ),
    "middle of the period": (
        "enclosure",
        "(whole - time for whole in duration)",
        "(duration[0] - time, duration[1].mid() - time)",
        check_durations,
    ),
}
REFERENCES = {
    "D": ("D", "0.009", "long"),
    "A": ("A", "0.01", "long"),
    "C": ("C", "0.01", "long"),
}


@pytest.fixture
def mutate(monkeypatch):
    """Put an altered module's functions and classes wherever the original's are known."""

    def change(name, old, new):
        module = importlib.import_module(f"gaitsweep.tasks.proofs.{name}")
        source = inspect.getsource(module)
        assert source.count(old) >= 1, f"{name} has no {old!r}"
        scope = dict(vars(module))
        exec(compile(source.replace(old, new), module.__file__, "exec"), scope)
        for place in [
            m
            for n, m in sys.modules.items()
            if n.startswith("gaitsweep.tasks.proofs.") or n == "exact_gaits"
        ]:
            for key, value in list(vars(place).items()):
                own = getattr(value, "__module__", None) == module.__name__
                if own and key in scope and key != "NotProvedError" and callable(value):
                    monkeypatch.setattr(place, key, scope[key])

    return change


def proved(letter):
    name, slope, label = REFERENCES[letter]
    return prove(
        setting(name, slope), guess(reference(name, slope, label)), label=label
    ).proved


@pytest.mark.parametrize("letter", REFERENCES)
def test_without_a_mutation_the_gait_is_proved(letter, mutate):
    mutate(
        "motion",
        "self.n = len(state) // 2",
        "self.n = len([*state]) // 2",
    )
    assert proved(letter)


@pytest.mark.parametrize("what", PHYSICS)
def test_altered_physics_proves_nothing(what, mutate):
    module, old, new, letters = PHYSICS[what]
    mutate(module, old, new)
    assert not any(proved(letter) for letter in letters)


@pytest.mark.parametrize("what", RIGOUR)
def test_an_altered_enclosure_fails_its_lemma(what, mutate):
    module, old, new, lemma = RIGOUR[what]
    with ctx.workprec(106):
        mutate(module, old, new)
        with pytest.raises(AssertionError):
            lemma()
