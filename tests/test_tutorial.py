"""The tutorial runs as it stands, and what it prints and draws is there."""

import os
import subprocess
import sys

from conftest import ROOT


def test_the_tutorial_runs_as_a_newcomer_runs_it(tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", str(ROOT / "docs" / "tutorial.py")],
        cwd=tmp_path,
        text=True,
        capture_output=True,
        timeout=240,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"},
    )
    assert done.returncode == 0, done.stderr
    # The laws of section 6.2: long steps as the cube root of the slope, short ones as
    # the slope.
    laws = [line.split() for line in done.stdout.splitlines() if " small " in line]
    exponents = [
        (gait, round(float(exponent), 2)) for _, _, gait, _, exponent, *_ in laws
    ]
    assert sorted(exponents) == [("long", 0.33)] * 2 + [("short", 1.0)] * 2
    assert (
        "0.005 All 40 steps end in a heelstrike." in done.stdout
        and "0.05 Step 2: fell backward." in done.stdout
    )
    assert (tmp_path / "round-feet.png").stat().st_size > 10_000
    assert sorted(p.name for p in (tmp_path / "data" / "archive").glob("*.nc")) == [
        "round-feet.nc"
    ]
