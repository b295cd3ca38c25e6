"""Who owns which name, what imports do, and what the package list and the lock say."""

import dataclasses
import importlib.metadata
import inspect
import itertools
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from types import FunctionType
from typing import Any, get_args, get_overloads, get_type_hints

import pytest
from matplotlib.figure import Figure
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import docstrings
import gaitsweep

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


@pytest.mark.parametrize("name", ["gaitsweep.tasks", "gaitsweep.pipeline"])
def test_the_code_is_imported_from_this_folder(name):
    found = importlib.import_module(name)
    assert Path(found.__file__).resolve().parent == ROOT / name.partition(".")[2]


def test_no_module_imports_by_the_names_of_other_packages():
    """`tasks` and `pipeline` are taken elsewhere; a foreign package, or a folder of the
    user, would win silently.
    """
    found = [
        file
        for name in ("tasks", "pipeline", "gaitsweep")
        for file in (ROOT / name).rglob("*.py")
    ]
    own = re.compile(r"^\s*(from|import) (tasks|pipeline)\b", re.MULTILINE)
    assert len(found) > 200 and not [
        file for file in found if own.search(file.read_text())
    ]


def test_the_package_list_is_whole():
    listed = set(PROJECT["tool"]["setuptools"]["packages"])
    there = {
        ".".join(("gaitsweep", *init.parent.relative_to(ROOT).parts))
        for name in ("tasks", "pipeline")
        for init in (ROOT / name).rglob("__init__.py")
    }
    assert {"gaitsweep", *there} == listed


def test_tests_are_no_packages():
    assert not list((ROOT / "tests").rglob("__init__.py"))
    assert not (ROOT / "tests" / "tasks").exists()


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="git lists the files")
def test_mutants_are_tried_in_a_whole_copy_of_the_project(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tests" / "mutants")
    recording = importlib.import_module("recording")
    monkeypatch.setattr(recording, "STATE", tmp_path)
    tree = recording.copy_project("copy")
    assert all(
        (tree / "gaitsweep" / name).resolve() == tree / name
        for name in ("tasks", "pipeline", "data")
    )
    assert len(list(tree.rglob("test_*.py"))) > 100


def test_the_registry_imports_nothing_and_the_plan_no_solver():
    program = (
        "import sys; import gaitsweep.tasks.contract.registry; import gaitsweep.pipeline.graph.plan;"
        "print(*(m for m in sys.modules if m.startswith('gaitsweep.tasks')))"
    )
    found = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    assert sorted(found.stdout.split()) == [
        "gaitsweep.tasks",
        "gaitsweep.tasks.contract",
        "gaitsweep.tasks.contract.accuracy",
        "gaitsweep.tasks.contract.costs",
        "gaitsweep.tasks.contract.kinds",
        "gaitsweep.tasks.contract.options",
        "gaitsweep.tasks.contract.registry",
        "gaitsweep.tasks.contract.variables",
    ]


def test_importing_any_module_only_defines(tmp_path):
    """No folder is made, no setting of a library touched, no module of ours left half
    imported.
    """
    modules = [
        ".".join(
            ("gaitsweep", *file.relative_to(ROOT).with_suffix("").parts)
        ).removesuffix(".__init__")
        for name in ("tasks", "pipeline")
        for file in sorted((ROOT / name).rglob("*.py"))
    ]
    program = (
        f"import heyoka, importlib; before = heyoka.llvm_state.get_diskcache_enabled()\n"
        f"for name in {modules!r}: importlib.import_module(name)\n"
        "assert before and heyoka.llvm_state.get_diskcache_enabled()"
    )
    environment = {
        **os.environ,
        "HOME": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "PYTHONPATH": str(ROOT),
    }
    environment["MPLCONFIGDIR"] = str(tmp_path.parent)  # matplotlib's own
    subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, check=True
    )
    assert not [
        path
        for path in tmp_path.rglob("*")
        if "gaitsweep" in path.name or path.suffix == ".nc"
    ]


def holds_any(hint):
    return hint is Any or any(
        map(holds_any, [*hint] if isinstance(hint, list) else get_args(hint))
    )


def test_what_is_exported_has_types_and_none_of_them_is_any():
    exported = (getattr(gaitsweep, name) for name in gaitsweep.__all__)
    functions = [each for each in exported if isinstance(each, FunctionType)]
    assert {each.__name__ for each in functions} >= {"figure", "gaits", "load", "run"}
    for function in [
        *functions,
        *(each for one in functions for each in get_overloads(one)),
    ]:
        hints = get_type_hints(function, localns={"Figure": Figure})
        assert hints.keys() == {*inspect.signature(function).parameters, "return"}
        assert not [name for name, hint in hints.items() if holds_any(hint)], function
        if dataclasses.is_dataclass(hints["return"]):
            assert not list(filter(holds_any, get_type_hints(hints["return"]).values()))


LOCK = (ROOT / "requirements.lock").read_text()
PINNED = dict(re.findall(r"^([\w-]+)==.*((?:\n .*)+)", LOCK, re.MULTILINE))


def test_every_dependency_is_locked_with_its_hash():
    project, groups = PROJECT["project"], PROJECT["dependency-groups"]
    wanted = itertools.chain(
        project["dependencies"],
        *project["optional-dependencies"].values(),
        *groups.values(),
    )
    assert {name.split(">")[0].lower() for name in wanted} <= set(PINNED)
    assert all("--hash=sha256:" in hashes for hashes in PINNED.values())
    assert len(PINNED) == LOCK.count("==") - LOCK.count(" == ")
    assert "http" not in LOCK and "/" not in LOCK


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_what_is_locked_needs_nothing_else_in_any_python(python):
    environment = {
        "python_version": python,
        "python_full_version": f"{python}.1",
        "extra": "",
    }
    installed = {
        canonicalize_name(each.name): each
        for each in importlib.metadata.distributions()
    }
    needed = {
        canonicalize_name(requirement.name)
        for name in set(PINNED) & set(installed)
        for requirement in map(Requirement, installed[name].requires or [])
        if not requirement.marker or requirement.marker.evaluate(environment)
    }
    assert {"numpy", "pyyaml"} < needed <= set(PINNED)


def test_a_machine_without_python_is_told_in_a_line(tmp_path):
    folder = tmp_path / "with spaces"
    folder.mkdir()
    for name in ("Makefile", "pyproject.toml", "requirements.lock"):
        shutil.copy(ROOT / name, folder)
    done = subprocess.run(
        ["make", "--silent", "setup", "PYTHON=false"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and done.stderr.startswith(
        "gaitsweep needs Python 3.11 or later, with pip and venv: "
    )
    assert not (folder / ".venv").exists()


def test_arrays_are_named_in_docstrings_of_the_public_face():
    assert not [name for file in docstrings.FACE for name in docstrings.missing(file)]


def test_attributes_of_dataclasses_are_documented_by_their_names():
    assert not [name for file in docstrings.FILES for name in docstrings.misnamed(file)]


def test_what_only_its_module_uses_is_private():
    tables = [ROOT / "pyproject.toml", ROOT / "pipeline" / "cli" / "commands.toml"]
    texts = [
        *ROOT.glob("tests/**/*.py"),
        *ROOT.glob("docs/**/*.*"),
        *tables,
        *docstrings.FILES,
    ]
    words = {
        file: set(re.findall(r"\w+", file.read_text(encoding="utf-8")))
        for file in texts
        if file.suffix not in (".png", ".pyc")
    }
    assert not [
        name for file in docstrings.FILES for name in docstrings.private(file, words)
    ]
