"""Bad input to the functions of `pipeline`: one sentence at every entry, whatever was
given.
"""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import gaitsweep
from gaitsweep.pipeline.errors import StudyError

STATE = [0.3, -0.25, -0.2]
ENTRIES = {
    "gaits": lambda **changed: gaitsweep.gaits(
        **{"walker": "E", "slope": 0.01, **changed}
    ),
    "solve": lambda **changed: gaitsweep.solve(
        **{"walker": "E", "slope": 0.01, **changed}
    ),
    "step_map": lambda **changed: gaitsweep.step_map(
        **{"walker": "E", "slope": 0.01, "state": STATE, **changed}
    ),
    "simulate": lambda **changed: gaitsweep.simulate(
        **{"walker": "E", "slope": 0.01, "state": STATE, "steps": 2, **changed}
    ),
}
SLOPES = [
    np.nan,
    np.inf,
    -0.01,
    0,
    0.5,
    10**400,
    None,
    "0.01",
    1j,
    True,
    {"a": 1},
    object(),
    np.datetime64("2020-01-01"),
]
WALKERS = [
    *(
        None,
        3,
        b"E",
        ["E"],
        object(),
        gaitsweep,
        pd.Series({"base": "E"}),
        xr.Dataset(),
        "",
        "Q",
        "E ",
        "no.toml",
    ),
    *(
        {},
        {1: 2},
        {"base": object()},
        {"base": {"base": "E"}},
        {"base": "E", "R": np.nan},
        {"base": "E", "Q": 1},
    ),
    *(
        {"base": "E", "R": -0.1},
        {"base": "E", "R": np.array([0.1])},
        {"base": "E", "R": xr.DataArray(0.1)},
    ),
]
KEYS = [
    *(
        {"R": value}
        for value in (
            np.nan,
            np.inf,
            -1.0,
            10**400,
            1e308,
            1e-320,
            None,
            "wide",
            1j,
            True,
            object(),
        )
    ),
    *({"knees": value} for value in (1, 0.0, "no", None, np.nan)),
    *(
        {"Q": 1.0},
        {"base": "A"},
        {"units": "SI"},
        {"detuning": 0.1},
        {"foot_mass_ratio": 0.1, "m_s": 0.1},
    ),
    {"m_t": 0.0, "m_s": 0.0, "m_h": 0.0},
]
STEPS = [0, -1, 1.5, 2.0, np.nan, None, "2", True, [1, 2], 10**9]
STATES = [
    *(
        None,
        3,
        "abc",
        [],
        [0.1, 0.2],
        {0.1, 0.2, 0.3},
        {"a": 1},
        [[0.1, 0.2, 0.3]],
        [np.nan, 0, 0],
        [0.2, -np.inf, 0],
    ),
    *(
        [0.2, 1j, 0],
        [0.2, "fast", 0],
        [0, 0, 0],
        [-0.1, -0.1, -0.1],
        [1.7, -1, -1],
        object(),
        xr.Dataset({"a": 1}),
    ),
]
ONLY = {
    "gaits": [
        {"variables": 3},
        {"variables": []},
        {"variables": [None]},
        {"accuracy": np.nan},
        {"accuracy": "fine"},
        {"R": [-1.0, np.nan]},
        {"slope": [0.01, 0.02], "R": [0.1, 0.2, 0.3]},
    ],
    "solve": [
        *({"slope": [0.01, 0.02]}, {"R": [0.1, 0.2]}, {"accuracy": 0}),
        *({"slope": None, "at": value} for value in (["speed"], "speed", {}, 0.4)),
        {"at": {"froude_speed": 0.2}, "vary": "foo"},
        *(
            {"slope": None, "at": {"froude_speed": 0.2}, "between": value}
            for value in (0.1, (0.01, 0.02, 0.03), (0.02, 0.01), "wide")
        ),
    ],
    "step_map": [
        {"slope": [0.01, 0.02]},
        {"R": [0.1, 0.2]},
        {"state": [0.2, 0.0, 0.0]},
        {"state": [0.2, 5.0, 5.0]},
    ],
    "simulate": [
        *(
            {"pushes": value}
            for value in ([1], {9: (0, 0)}, {"a": (0, 0)}, {0: 1}, {0: (np.nan, 0)})
        ),
        *(
            {"ground": value}
            for value in (1.0, {0: np.nan}, {0: "high"}, {2: 0.1}, {True: 0.1})
        ),
    ],
}


@pytest.mark.parametrize("entry", ENTRIES)
def test_wrong_arguments_are_one_sentence(entry):
    wrong = (
        [{"slope": value} for value in SLOPES]
        + [{"walker": value} for value in WALKERS]
        + KEYS
        + ONLY[entry]
    )
    wrong += [{"steps": value} for value in STEPS] if entry != "step_map" else []
    wrong += (
        [{"state": value} for value in STATES]
        if entry in ("step_map", "simulate")
        else []
    )
    for changed in wrong:
        with pytest.raises(StudyError) as caught:
            ENTRIES[entry](**changed)
        sentence = str(caught.value)
        assert "\n" not in sentence and len(sentence) < 250 and sentence[-1] in ".?", (
            changed
        )
        # The sentence names what is wrong: the argument, a key of the walker, or the
        # unknown name.
        assert "`" in sentence or sentence.startswith(("Shapes", "There is no file")), (
            changed
        )


def test_wrong_arguments_of_a_run_are_one_sentence():
    wrong = [
        {"jobs": 10**6},
        *({"cluster": value} for value in (5, b"local:2")),
        *({"archive": v} for v in (5, ".", "")),
    ]
    for changed in wrong:
        (name,) = changed
        with pytest.raises(StudyError, match=f"^`{name}` must "):
            gaitsweep.run(
                {"name": "wrong", "walker": "E", "axes": {"slope": [0.01]}}, **changed
            )


def test_a_start_that_never_strikes_is_an_outcome_of_a_simulation():
    for state in ([0.2, 0.0, 0.0], [0.2, 5.0, 5.0]):
        walk = gaitsweep.simulate("E", 0.01, state, 3)
        assert walk.outcome.item() == "fell backward" and walk.steps_taken == 0
        assert (
            walk.reason.item() == "Step 0: fell backward."
            and np.isnan(walk.stance_angle[1:]).all()
        )


def test_a_table_may_be_based_on_a_file_everywhere(tmp_path):
    (tmp_path / "mine.toml").write_text('[walker]\nbase = "E"\nR = 0.2\n')
    gait = gaitsweep.gaits("E", 0.01, R=0.2, m_h=0.1).isel(gait=0)
    state = [
        gait[name].item() for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    for base in (tmp_path / "mine.toml", str(tmp_path / "mine.toml")):
        table = {"base": base, "m_h": 0.1}
        assert gaitsweep.gaits(table, 0.01).isel(gait=0).stance_angle.item() == state[0]
        assert gaitsweep.solve(table, 0.01).stance_angle[0] == state[0]
        assert gaitsweep.step_map(table, 0.01, state).state == pytest.approx(
            state, rel=1e-10
        )
        assert gaitsweep.simulate(table, 0.01, state, 1).stance_angle[
            1
        ] == pytest.approx(state[0], rel=1e-10)


@pytest.mark.parametrize("knees", [False, np.False_])
def test_knees_are_changed_alike_everywhere(knees):
    gait = gaitsweep.gaits("C", 0.02, knees=knees).isel(gait=0)
    state = [
        gait[name].item() for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    row = gaitsweep.solve("C", 0.02, knees=knees).iloc[0]
    assert row.stance_angle == gait.stance_angle.item() and np.isnan(
        row.kneestrike_time
    )
    assert gaitsweep.step_map("C", 0.02, state, knees=knees).state == pytest.approx(
        state, rel=1e-10
    )
    assert gaitsweep.simulate("C", 0.02, state, 1, knees=knees).stance_angle[
        1
    ] == pytest.approx(state[0], rel=1e-10)
