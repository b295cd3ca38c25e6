"""Orbits and basins through the command line: chaos makes any slip of a bit visible in
the archive.
"""

import os
import re
import subprocess
from pathlib import Path

import pytest

from conftest import GAITSWEEP

ROOT = Path(__file__).parent.parent
ORBIT = """name = "o"
kind = "orbit"
walker = ["D", "E"]
[axes]
slope = [0.0060, 0.0188, 0.0189]
[options]
starts = 3
transient = 80
steps = 60
shown = 20
"""
BASIN = """name = "b"
kind = "basin"
walker = "E"
[axes]
foot_mass_ratio = [0.0, 0.01]
slope = [0.0126]
[options]
size = 20
steps = 60
"""


def archived(folder, text, *options):
    folder.mkdir()
    (folder / "s.toml").write_text(text)
    command = [*GAITSWEEP, "run", "s.toml", "--quiet", *options]
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    (found,) = (folder / "data" / "archive").glob("*.nc")
    return re.sub(rb'"commit": "[0-9a-f]{40}"', b'"commit": ""', found.read_bytes())


@pytest.mark.parametrize("text", [ORBIT, BASIN], ids=["orbit", "basin"])
def test_workers_and_chunks_change_no_byte(tmp_path, text):
    one = archived(tmp_path / "one", text, "--jobs", "1")
    two = archived(tmp_path / "two", text, "--jobs", "2", "--chunk", "1")
    assert one == two
