"""Which tests reach which lines: a run of all tests, and its record. Run by pytest, this is the plugin that keeps it.

Coverage is begun in every process by the environment, that of workers and commands with the test that started them.
"""

import functools
import gc
import hashlib
import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path

import pytest
from coverage import Coverage, CoverageData

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
STATE = ROOT / "mutants"
TESTS = ("tests", "--ignore=tests/browser", "--ignore=tests/test_architecture.py")
PYTEST = ("-q", "-p", "no:cacheprovider", "-W", "ignore", "--tb=line")
#: A test may lean on what another of its file has solved: those that take less than this all come along [s].
CHEAP = 1.0

_took: Counter[str] = Counter()
_failed: set[str] = set()


def copy_project(name: str) -> Path:
    """Return a fresh copy of all that belongs to the project."""
    tree = STATE / name
    shutil.rmtree(tree, ignore_errors=True)
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    for file in listed.stdout.splitlines():
        (tree / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, tree / file)
    return tree


def environment(tree: Path) -> dict[str, str]:
    """What processes in a copy see: that copy, and compiled flows of their own."""
    path = os.pathsep.join(str(each) for each in (tree, tree / "tests" / "mutants"))
    return {"PYTHONPATH": path, "GAITSWEEP_CACHE": str(STATE / "cache")}


def lend_cache() -> None:
    """Copy the compiled flows, so those of mutants do not fill the user's."""
    # Not above: a process that tries a mutant imports this file, but `tasks` from its copy.
    from tasks.mechanics.kernel import cache_folder

    lent = STATE / "cache"
    shutil.rmtree(lent, ignore_errors=True)
    lent.mkdir(parents=True)
    source = cache_folder() / "cache.db"
    if source.exists():
        with sqlite3.connect(source) as old, sqlite3.connect(lent / "cache.db") as new:
            old.backup(new)


def record() -> dict[str, float]:
    """Run all tests and keep the lines that they reach, unless that is done; return how long each took [s]."""
    digest = hashlib.sha256()
    for file in sorted(file for part in ("tasks", "pipeline", "tests") for file in (ROOT / part).rglob("*.py")):
        if file.parent != HERE:
            digest.update(file.read_bytes())
    kept = STATE / "took.json"
    if not kept.exists() or json.loads(kept.read_text())["code"] != digest.hexdigest():
        for old in STATE.glob("reached*"):
            old.unlink()
        settings = STATE / "coveragerc"
        settings.write_text(
            f"[run]\nsource = pipeline,tasks\ndata_file = {STATE / 'reached'}\nparallel = true\nsigterm = true\n"
            "context = ${PYTEST_CURRENT_TEST-}\nplugins = gently\n"
        )
        tree, took = copy_project("recorded"), STATE / "recorded.json"
        shutil.copy(HERE / "gently.py", tree)
        told = {"COVERAGE_PROCESS_START": str(settings), "RECORDED": str(took)}
        subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "recording", *PYTEST, "-n2", "--dist=loadfile", *TESTS],
            cwd=tree,
            env={**os.environ, **environment(tree), **told},
            check=False,
        )
        subprocess.run(
            [sys.executable, "-m", "coverage", "combine", "--rcfile", settings, "--quiet"], cwd=tree, check=True
        )
        kept.write_text(json.dumps({"code": digest.hexdigest(), "took": json.loads(took.read_text())}))
    return json.loads(kept.read_text())["took"]


class Reach:
    """Which tests reach which lines."""

    def __init__(self, took: dict[str, float]) -> None:
        self.took = took
        self.of_file: dict[str, list[str]] = defaultdict(list)
        for test in took:
            self.of_file[test.split("::")[0]].append(test)
        self._data = CoverageData(str(STATE / "reached"))
        self._data.read()

    @functools.cache  # noqa: B019
    def _tests(self, path: Path) -> dict[int, set[str]]:
        """Tests by line of a file; what a process was begun by counts as what that test reaches."""
        found = {}
        for line, contexts in self._data.contexts_by_lineno(str(STATE / "recorded" / path)).items():
            found[line] = {re.sub(r" \((setup|call|teardown)\)$", "", context.split("|")[0]) for context in contexts}
        return found

    def tests(self, path: Path, at: tuple[int, ...]) -> list[str]:
        """Tests that reach any of some lines of a file: cheap ones first, and files that name it."""
        lines, module = self._tests(path), ".".join(path.with_suffix("").parts)
        words = set(re.split(r"[._]", module))
        reaching = set().union(*(lines.get(line, ()) for line in at)) & set(self.took)
        if not reaching:
            # Workers that are killed record nothing: whatever reaches the package may notice.
            beside = [file.relative_to(ROOT) for file in (ROOT / path.parent).glob("*.py")]
            reaching = set().union(*(tests for file in beside for tests in self._tests(file).values())) & set(self.took)
        files = {test.split("::")[0] for test in reaching}
        chosen = {file: [e for e in self.of_file[file] if e in reaching or self.took[e] < CHEAP] for file in files}

        def rank(file: str) -> tuple[bool, float]:
            kin = bool(words & set(Path(file).stem.split("_"))) or module in (ROOT / file).read_text()
            return not kin, sum(self.took[each] for each in chosen[file])

        tests = [test for file in sorted(files, key=rank) for test in chosen[file]]
        return sorted(tests, key=lambda test: self.took[test] >= CHEAP)


@pytest.fixture(scope="module", autouse=True)
def forgetting() -> None:
    """No file of tests leans on what another left in memory."""
    for kept in gc.get_objects():
        if isinstance(kept, functools._lru_cache_wrapper) and kept.__module__.startswith(("tasks", "lines")):
            kept.cache_clear()


def pytest_runtest_logstart(nodeid: str) -> None:
    if running := Coverage.current():
        running.switch_context(nodeid)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _took[report.nodeid] += report.duration
    if not report.passed:
        _failed.add(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    if not hasattr(session.config, "workerinput"):
        took = {test: time for test, time in _took.items() if test not in _failed}
        Path(os.environ["RECORDED"]).write_text(json.dumps(took, indent=0))
