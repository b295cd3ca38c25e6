"""Every script of the gallery runs as it stands, reproduces the numbers printed in its
sources, and draws.
"""

import os
import re
import subprocess
import sys

import pytest

from conftest import ROOT

#: Largest difference from each printed number: half its last digit, or what the printed
#: parameters leave open.
SCRIPTS = {
    # The doublings are read off a diagram drawn for some slopes; computed to 0.0001
    # degrees.
    "goswami_bifurcation": {"doubling 1": 0.025, "doubling 2": 0.05},
    # The knee's angle is printed to one digit: 0.2 could be 0.195, which moves the pair
    # by 0.016.
    "mcgeer_modes": {
        "magnitude of the pair": 0.016,
        "phase of the pair": 0.016,
        "third eigenvalue": 0.008,
    },
    "curved_feet": {f"loss at radius 0.{n}": 1e-4 for n in range(1, 6)}
    | {"stable on point feet": 5e-5},
    "design_map": {"simplest walker": 1.2e-4},
    # Half a millimetre of w_t, to which it is printed, moves the slope by 0.0004.
    "tolerance": {"smallest slope": 7e-4},
    "step_down": {"stance angle": 5e-5, "stance rate": 5e-5, "thigh rate": 5e-5},
}
#: Computed another way: a closed form, continuation to the special point, or the tests
#: of what is shown.
COMPUTED = {
    "goswami_bifurcation": {"doubling 1": 4.3909, "doubling 2": 4.9141},
    "curved_feet": {f"loss at radius 0.{n}": (1 - n / 10) ** 2 for n in range(1, 6)},
}


def run(name, folder):
    done = subprocess.run(
        [sys.executable, "-W", "error", str(ROOT / "docs" / "gallery" / f"{name}.py")],
        cwd=folder,
        text=True,
        capture_output=True,
        timeout=240,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_script_is_tested_and_listed():
    assert {path.stem for path in (ROOT / "docs" / "gallery").glob("*.py")} == set(
        SCRIPTS
    )
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    assert all(f"(gallery/{name}.py)" in page for name in SCRIPTS)


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_reproduces_what_is_printed(name, tmp_path):
    said = run(name, tmp_path)
    numbers = re.findall(r"^(.*): printed ([-\d.]+), computed ([-\d.]+)", said, re.M)
    for start, tolerance in SCRIPTS[name].items():
        (printed, computed), *others = [
            (float(p), float(c)) for what, p, c in numbers if what.startswith(start)
        ]
        assert not others and abs(computed - printed) <= tolerance, (
            start,
            printed,
            computed,
        )
        assert computed == pytest.approx(
            COMPUTED.get(name, {}).get(start, computed), abs=1.01e-4
        )
    (picture,) = tmp_path.glob("*.png")
    assert (
        picture.name == f"{name.replace('_', '-')}.png"
        and picture.stat().st_size > 5_000
    )
    if name == "step_down":
        assert (
            "All 40 steps end in a heelstrike." in said
            and said.count("survives a step") == 2
        )
