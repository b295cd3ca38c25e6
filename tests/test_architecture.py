"""Who may import whom, who owns which name, and what the package list says."""

import importlib.metadata
import itertools
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import docstrings

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_import_contract_is_kept():
    from importlinter.cli import lint_imports

    assert lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0


@pytest.mark.parametrize("name", ["tasks", "pipeline"])
def test_each_import_name_has_one_owner_and_it_is_ours(name):
    """Both names are taken elsewhere; a foreign package in site-packages would win silently."""
    owners = set(importlib.metadata.packages_distributions().get(name, []))
    assert owners <= {"gaitsweep"}
    found = __import__(name)
    assert Path(found.__file__).resolve().parent == ROOT / name
    assert [Path(p).resolve() for p in found.__path__] == [ROOT / name]


def test_the_package_list_is_whole():
    listed = set(PROJECT["tool"]["setuptools"]["packages"])
    there = {
        ".".join(init.parent.relative_to(ROOT).parts)
        for name in ("tasks", "pipeline")
        for init in (ROOT / name).rglob("__init__.py")
    }
    assert there == listed


def test_tests_are_no_packages():
    assert not list((ROOT / "tests").rglob("__init__.py"))
    assert not (ROOT / "tests" / "tasks").exists()


def test_the_registry_imports_nothing_and_the_plan_no_solver():
    program = (
        "import sys; import tasks.registry; before = set(sys.modules); import pipeline.plan.missing;"
        "print(*(m for m in sys.modules if m.startswith('tasks')))"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=True)
    assert sorted(found.stdout.split()) == ["tasks", "tasks.accuracy", "tasks.costs", "tasks.registry"]


def test_importing_any_module_only_defines(tmp_path):
    """No folder is made, no setting of a library touched, no module of ours left half imported."""
    modules = [
        ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for name in ("tasks", "pipeline")
        for file in sorted((ROOT / name).rglob("*.py"))
    ]
    program = (
        f"import heyoka, importlib; before = heyoka.llvm_state.get_diskcache_path()\n"
        f"for name in {modules!r}: importlib.import_module(name)\n"
        "assert heyoka.llvm_state.get_diskcache_path() == before"
    )
    environment = {
        **os.environ,
        "HOME": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "PYTHONPATH": str(ROOT),
    }
    environment["MPLCONFIGDIR"] = str(tmp_path.parent)  # matplotlib's own
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, check=True)
    assert not [path for path in tmp_path.rglob("*") if "gaitsweep" in path.name or path.suffix == ".nc"]


def test_files_are_of_a_size_to_be_read():
    long = {
        str(f.relative_to(ROOT)): n
        for name in ("tasks", "pipeline")
        for f in (ROOT / name).rglob("*.py")
        if (n := len(f.read_text().splitlines())) > 400
    }
    assert not long


def test_every_dependency_is_locked_with_its_hash():
    lock = (ROOT / "requirements.lock").read_text()
    pinned = {line.split("==")[0].lower() for line in lock.splitlines() if "==" in line}
    project = PROJECT["project"]
    wanted = [*project["dependencies"], *itertools.chain(*project["optional-dependencies"].values())]
    assert {name.split(">")[0].lower() for name in wanted} <= pinned
    assert lock.count("--hash=sha256:") >= len(pinned)
    assert "http" not in lock and "/" not in lock


def test_arrays_are_named_in_docstrings():
    assert not [name for file in docstrings.FILES for name in docstrings.missing(file)]


def test_what_only_its_module_uses_is_private():
    texts = [*ROOT.glob("tests/**/*.py"), *ROOT.glob("docs/**/*.*"), ROOT / "pyproject.toml", *docstrings.FILES]
    words = {file: set(re.findall(r"\w+", file.read_text(encoding="utf-8"))) for file in texts if file.suffix != ".png"}
    assert not [name for file in docstrings.FILES for name in docstrings.private(file, words)]


def test_every_file_is_formatted_alike():
    command = [sys.executable, "-m", "ruff", "format", "--check", "--no-cache", "."]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_ruff_finds_nothing():
    command = [sys.executable, "-m", "ruff", "check", "--no-cache", "."]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_mypy_finds_nothing():
    done = subprocess.run([sys.executable, "-m", "mypy"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
