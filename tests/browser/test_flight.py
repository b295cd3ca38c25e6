"""The script's flight against the solver: steps, multipliers, losses and violations of
200 gaits a structure.
"""

from pathlib import Path

import numpy as np
import pytest

from gaitsweep.pipeline import dispatch, gaits
from gaitsweep.pipeline.report import pages
from gaitsweep.tasks.contract.registry import VIOLATIONS

pytestmark = pytest.mark.thorough

_SCRIPTS = Path(pages.__file__).parent / "scripts"
MECHANICS = "\n".join(
    (_SCRIPTS / name).read_text(encoding="utf-8") for name in ("flight.js", "gaits.js")
)

LOCKED_C, LOCKED_PHYSICAL = (
    {"base": name, "trailing_knee": "locked"} for name in ("C", "physical")
)

HIP = {"hip_stiffness": 0.05, "hip_damping": 5e-4, "hip_rest": 0.1, "hip_torque": 1e-3}

#: Lines of each structure: a walker's name, keys that are set, slopes.
LINES = {
    "point feet": [("D", {}, np.geomspace(1e-6, 0.1, 24))]
    + [
        ("E", {"foot_mass_ratio": ratio}, np.geomspace(1e-5, 0.12, 30))
        for ratio in (0.02, 0.1, 0.2)
    ],
    "straight legs": [
        ("B", {"R": radius}, np.geomspace(1e-5, 0.1, 24)) for radius in (0.1, 0.2, 0.4)
    ]
    + [
        ("A", {}, np.geomspace(1e-5, 0.05, 30)),
        ("physical-straight", {}, np.linspace(0.02, 0.055, 24)),
    ],
    "knees": [
        ("C", {"detuning": amount}, np.geomspace(1e-3, 0.08, 36))
        for amount in (0.0, 0.1, 0.2)
    ]
    + [
        ("C", {}, np.geomspace(1e-6, 1e-3, 12)),
        ("physical", {}, np.linspace(0.02, 0.11, 24)),
    ],
    "knees locked at heelstrike": [
        (LOCKED_C, {"detuning": amount}, np.geomspace(1e-3, 0.08, 36))
        for amount in (0.0, 0.1)
    ]
    + [
        (LOCKED_C, {}, np.geomspace(1e-6, 1e-3, 12)),
        (LOCKED_PHYSICAL, {}, np.linspace(0.02, 0.11, 60)),
    ],
    "driven": [
        ("D", {"push_off": 0.05, "hip_stiffness": 0.5}, np.linspace(0, 0.05, 26)),
        ("E", {"push_off": 0.1}, np.linspace(0, 0.05, 26)),
        ("B", {"push_off": 0.1, **HIP}, np.linspace(0, 0.05, 26)),
        ("C", {"push_off": 0.05, "hip_torque": 0.01}, np.linspace(0.01, 0.06, 26)),
        (LOCKED_C, {"push_off": 0.05, **HIP}, np.linspace(0.01, 0.06, 26)),
    ],
}
_RATES = ("stance_rate", "thigh_rate", "shank_rate")

#: One gait flown: the state after its step, its losses and violations, and the gait
#: that Newton's method finds.
_FLY = """
const [keys, points] = arguments, walker = makeWalker(keys);
return points.map(([slope, ...state]) => {
  const start = stateOf(walker, state), step = flyStep(walker, start, slope), n = start.length / 2;
  if (step.fall) return { fall: step.fall };
  const gait = findGait(walker, sectionOf(walker, start), slope), losses = lossesOf(walker, step);
  return { angle: step.end[0], rates: Array.from(step.end.subarray(n), rate => rate / walker.time),
    period: step.period * walker.time, kneestrike: step.kneestrike === null ? null : step.kneestrike * walker.time,
    losses: [losses.normal, losses.tangential, losses.kneestrike].map(loss => loss * walker.energy),
    flags: violationsOf(walker, start, step, slope).reduce((flags, name) => flags + (1 << VIOLATIONS.indexOf(name)), 0),
    found: gait && gait.y[0], multipliers: gait && multipliersOf(gait.jacobian) };
});"""


def run(browser, script, *given):
    """Value of a script that sees the functions of the mechanics and what it is given."""
    return browser.execute_script(f"{MECHANICS}\n{script}", *given)


def solved(name, setting, slopes):
    """Gaits of a line as the solver has them: dicts of the archive's variables, with
    the slope.
    """
    wanted = [
        "stance_angle",
        *_RATES,
        "period",
        "kneestrike_time",
        "multipliers",
        "energy",
        "violations",
    ]
    found = gaits(name, slopes, variables=wanted, **setting)
    for i, slope in enumerate(slopes):
        for label in found.gait.values:
            point = found.isel(slope=i).sel(gait=label)
            if np.isfinite(point.stance_angle):
                yield {"slope": float(slope)} | {
                    str(k): point[k].values for k in point.data_vars
                }


def keys_of(name, setting):
    """Keys of a walker as a page has them, with the limits of violations."""
    parameters = dispatch.ask("check_walker", {"walker": name, "set": setting})[
        "parameters"
    ]
    return {**parameters, "violation_limits": [v.limit for v in VIOLATIONS.values()]}


def apart(found, wanted):
    """Largest difference of the power sums of two sets of multipliers, which nearly
    equal ones determine well.
    """
    size = max(map(abs, wanted))
    return max(
        abs(sum((z / size) ** k for z in found) - sum((z / size) ** k for z in wanted))
        for k in (1, 2, 3)
    )


@pytest.mark.parametrize("structure", LINES)
def test_a_step_of_the_script_is_the_archives(browser, structure):
    browser.get("about:blank")
    count = 0
    for name, setting, slopes in LINES[structure]:
        keys = keys_of(name, setting)
        known = list(solved(name, setting, slopes))
        starts = [
            [p["slope"], float(p["stance_angle"]), *(float(p[rate]) for rate in _RATES)]
            for p in known
        ]
        for start, gait, flown in zip(
            starts, known, run(browser, _FLY, keys, starts), strict=True
        ):
            where = name, setting, start
            assert "fall" not in flown, (where, flown)
            rates = np.array(start[2 : 2 + len(flown["rates"])])
            assert abs(flown["angle"] / start[1] - 1) < 1e-6, where
            assert (
                np.abs(np.array(flown["rates"]) - rates).max()
                < 1e-6 * np.abs(rates).max()
            ), where
            assert abs(flown["period"] / float(gait["period"]) - 1) < 1e-6, where
            if flown["kneestrike"] is not None:
                assert (
                    abs(flown["kneestrike"] - float(gait["kneestrike_time"]))
                    < 1e-6 * flown["period"]
                ), where
            losses = np.nan_to_num(
                [
                    float(gait[f"loss_{part}"])
                    for part in ("normal", "tangential", "kneestrike")
                ]
            )
            assert (
                np.abs(np.array(flown["losses"]) - losses).max() < 1e-6 * losses.sum()
            ), where
            assert abs(flown["found"] / start[1] - 1) < 1e-6, where
            values = gait["multiplier_real"][:3] + 1j * gait["multiplier_imag"][:3]
            assert apart([complex(*z) for z in flown["multipliers"]], values) < 1e-6, (
                where
            )
            assert flown["flags"] == int(gait["violations"]), where
            count += 1
    assert count >= 200


@pytest.mark.parametrize(
    ("walker", "slope", "violation", "below", "above"),
    [
        ("D", 0.009, "friction", 0.15, 1.0),
        ("C", 0.02, "scuff", 0.002, 0.005),
        ("physical", 0.036, "stance_knee_unlocks", 1e-3, 5e-3),
        ("C", 1e-4, "release_hyperextends", 1e-6, 1e-3),
        ("physical-straight", 0.3, "release_penetrates", 0.01, 0.2),
        ("physical-straight", 0.3, "trailing_foot_pulls", 1e-4, 1e-3),
        (LOCKED_C, 0.07, "trailing_knee_unlocks", 1e-4, 0.1),
    ],
)
def test_a_violation_is_flagged_above_its_limit(
    browser, walker, slope, violation, below, above
):
    browser.get("about:blank")
    keys, number = keys_of(walker, {}), list(VIOLATIONS).index(violation)
    known = list(solved(walker, {}, [slope]))
    starts = [
        [p["slope"], float(p["stance_angle"]), *(float(p[rate]) for rate in _RATES)]
        for p in known
    ]
    for limit, is_flagged in ((below, True), (above, False)):
        bits = gaits(
            walker, slope, variables=["violations"], violation_limits={violation: limit}
        ).violations.values
        keys["violation_limits"][number] = limit
        flown = [
            gait["flags"] >> number & 1 for gait in run(browser, _FLY, keys, starts)
        ]
        assert flown == (bits[: len(known)] >> number & 1).tolist()
        assert any(flown) == is_flagged


def test_a_scuff_between_two_samples_is_flagged(browser):
    browser.get("about:blank")
    for name, slopes in (("C", [0.324, 0.325]), ("physical", [0.355])):
        keys = {**keys_of(name, {}), "violation_limits": [0.0] * len(VIOLATIONS)}
        known = list(solved(name, {}, slopes))
        starts = [
            [p["slope"], float(p["stance_angle"]), *(float(p[rate]) for rate in _RATES)]
            for p in known
        ]
        assert [flown["flags"] & 1 for flown in run(browser, _FLY, keys, starts)] == [
            int(p["scuff_depth"] > 0) for p in known
        ]
