"""The wheel: it installs and runs outside a checkout, with the studies of the paper,
whatever else is installed.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

import gaitsweep
from conftest import ROOT
from gaitsweep import StudyError
from gaitsweep.pipeline.cli import commands

RUN = {"check": True, "capture_output": True, "text": True}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder with nothing but the installed wheel, one with foreign packages, and an
    empty one.
    """
    folder = tmp_path_factory.mktemp("wheel")
    source, site, foreign, empty = (
        folder / name for name in ("source", "site", "foreign", "empty")
    )
    source.mkdir()
    for name in (
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "gaitsweep",
        "pipeline",
        "tasks",
        "data",
    ):
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(
            ROOT / name,
            source / name,
            **({"symlinks": True} if copy is shutil.copytree else {}),
        )
    (source / "data" / "archive").mkdir(exist_ok=True)
    (
        source / "data" / "archive" / "run.nc"
    ).touch()  # what a run leaves behind in a checkout
    for name in ("pipeline", "tasks"):
        (foreign / name).mkdir(parents=True)
        (foreign / name / "__init__.py").write_text(
            "raise ImportError('another package')"
        )
    empty.mkdir()
    uv = [sys.executable, "-m", "uv", "--offline", "--quiet"]
    build = [
        "build",
        "--wheel",
        "--no-build-isolation",
        "--python",
        sys.executable,
        "--out-dir",
        folder,
    ]
    subprocess.run([*uv, *build, source], **RUN)
    (wheel,) = folder.glob("*.whl")
    subprocess.run(
        [
            *uv,
            "pip",
            "install",
            "--python",
            sys.executable,
            "--no-deps",
            "--target",
            site,
            wheel,
        ],
        **RUN,
    )
    return site, foreign, empty


def python(installed, *arguments):
    site, foreign, empty = installed
    path = os.pathsep.join(map(str, (foreign, site)))
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=empty,
        env={**os.environ, "PYTHONPATH": path},
        **RUN,
    ).stdout


def test_the_wheel_runs_in_an_empty_folder_beside_foreign_packages(installed):
    site = installed[0]
    code = (
        "import gaitsweep; print(gaitsweep.__file__); "
        "from gaitsweep import gaits, load, run, simulate, solve, step_map"
    )
    assert (
        Path(python(installed, "-c", code).strip())
        == site / "gaitsweep" / "__init__.py"
    )
    plans = json.loads(
        python(installed, "-m", "gaitsweep", "plan", "paper", "examples", "--json")
    )
    shipped = [
        file.stem
        for name in ("paper", "examples")
        for file in sorted(ROOT.glob(f"data/studies/{name}/*.toml"))
    ]
    assert [plan["study"] for plan in plans] == shipped and len(shipped) > 20
    solved = python(
        installed,
        "-m",
        "gaitsweep",
        "solve",
        "--walker",
        "D",
        "--slope",
        "0.01",
        "--json",
    )
    assert {gait["gait"] for gait in json.loads(solved)} == {"long", "short"}


def test_the_wheel_brings_what_its_code_reads_and_no_results(installed):
    site = installed[0]
    code = "from gaitsweep.tasks.ledger.certificates import BACKED, FOLDER\n" + (
        "print(*(FOLDER / f'{name}.json' for names in BACKED.values() for name in names), sep='\\n')"
    )
    certificates = list(map(Path, python(installed, "-c", code).splitlines()))
    assert certificates and all(
        file.is_file() and site in file.parents for file in certificates
    )
    assert (
        site / "gaitsweep" / "data" / "studies" / "examples" / "study.schema.json"
    ).is_file()
    for name in ("gaits.json", "gaits.csv"):
        shipped = site / "gaitsweep" / "data" / "reference" / name
        assert shipped.read_bytes() == (ROOT / "data" / "reference" / name).read_bytes()
    assert (
        not list(site.rglob("*.nc"))
        and not (site / "gaitsweep" / "data" / "archive").exists()
    )


def test_what_lies_in_the_working_folder_comes_before_what_is_shipped(
    tmp_path, monkeypatch, capsys
):
    def planned(*names):
        code = commands.main(["plan", *names, "--json"])
        out, err = capsys.readouterr()
        return [plan["study"] for plan in json.loads(out)] if code == 0 else err

    monkeypatch.chdir(tmp_path)
    assert planned("paper/figure5") == ["figure5"] and "basin" in planned("paper")
    assert (
        planned("paper/figure55")
        == "gaitsweep: There is no file paper/figure55; did you mean `paper/figure5`?\n"
    )
    assert planned("mine") == "gaitsweep: There is no file mine.\n"
    (tmp_path / "paper").mkdir()
    assert (
        planned("paper")
        == "gaitsweep: There is no study (*.toml) in the folder paper.\n"
    )
    for name in ("b", "a"):
        text = f'name = "{name}"\nwalker = "D"\naxes = {{ slope = [0.01] }}\n'
        (tmp_path / "paper" / f"{name}.toml").write_text(text)
    assert planned("paper") == ["a", "b"] and planned("paper/figure5") == ["figure5"]
    (tmp_path / "paper" / "figure5").write_text(
        (tmp_path / "paper" / "a.toml").read_text()
    )
    assert planned("paper/figure5") == ["a"]


def test_what_is_shipped_has_a_name_in_python_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = gaitsweep.solve("round-foot.toml", 0.01)
    assert list(found.gait) == ["long", "short"]
    pd.testing.assert_frame_equal(
        found, gaitsweep.solve(ROOT / "data" / "walkers" / "round-foot.toml", 0.01)
    )
    (tmp_path / "round-foot.toml").write_text('[walker]\nbase = "round-foot.toml"\n')
    with pytest.raises(
        StudyError, match="based on more than 8"
    ):  # a file of one's own comes first
        gaitsweep.solve("round-foot.toml", 0.01)
    with pytest.raises(
        StudyError, match=r"^paper is a folder of \d+ studies; `run` takes one\.$"
    ):
        gaitsweep.run("paper")
    with pytest.raises(
        StudyError, match="this study is a `cascade`"
    ):  # read, then refused
        gaitsweep.run("paper/cascade", accuracy=1e-3)
