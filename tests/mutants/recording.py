"""Which tests reach which lines: a run of all tests, and its record. Run by pytest,
this is the plugin that keeps it.

Coverage is begun in every process by the environment, that of workers and commands with
the test that started them.
"""

import difflib
import functools
import gc
import hashlib
import json
import os
import re
import resource
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
from coverage import Coverage, CoverageData

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
STATE = ROOT / "mutants"
PYTEST = ("-q", "-p", "no:cacheprovider", "-W", "ignore", "--tb=line")
#: Tests that take less than this are tried first, and those of the same file come along
#: [s].
CHEAP = 1.0

_USED = pytest.StashKey[
    float
]()  # processor time until the last report of this process [s]
_took: Counter[str] = Counter()
_failed: set[str] = set()


def copy_project(name: str) -> Path:
    """Return a fresh copy of all that belongs to the project."""
    tree = STATE / name
    shutil.rmtree(tree, ignore_errors=True)
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    for file in listed.stdout.splitlines():
        (tree / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(
            ROOT / file, tree / file, follow_symlinks=False
        )  # parts of the package are links
    return tree


def environment(tree: Path) -> dict[str, str]:
    """What processes in a copy see: that copy, and compiled flows of their own."""
    path = os.pathsep.join(str(each) for each in (tree, tree / "tests" / "mutants"))
    return {"PYTHONPATH": path, "GAITSWEEP_CACHE": str(STATE / "cache")}


def lend_cache() -> None:
    """Copy the compiled flows, so those of mutants do not fill the user's."""
    # Not above: a process that tries a mutant imports this file, but `tasks` from its
    # copy.
    from gaitsweep.tasks.mechanics.compile_cache import cache_folder

    lent = STATE / "cache"
    shutil.rmtree(lent, ignore_errors=True)
    lent.mkdir(mode=0o700, parents=True)
    for source in cache_folder().glob("*.compiled"):
        shutil.copy2(source, lent)


def record() -> list[dict[str, Any]]:
    """Run all tests and keep the lines that they reach; afterwards, only tests of files
    that are new or have changed.

    Returns
    -------
    list of dict
        For each run, `name` (its copy of the project), `files` (a checksum of each file
        of tests) and `took`, the processor time of each test and of the processes it
        started [s].
    """
    kept = STATE / "recorded.json"
    recordings: list[dict[str, Any]] = (
        json.loads(kept.read_text()) if kept.exists() else []
    )
    found = [
        file
        for file in sorted((ROOT / "tests").rglob("test_*.py"))
        if file.parent.name != "browser"
    ]
    sums = {
        str(file.relative_to(ROOT)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in found
    }
    known = {
        file: each
        for recorded in recordings
        for file, each in recorded["files"].items()
    }
    new = {
        file: each
        for file, each in sums.items()
        if known.get(file) != each and "architecture" not in file
    }
    if not new:
        return recordings
    name = f"recorded{len(recordings)}"
    tree, settings, took = (
        copy_project(name),
        STATE / "coveragerc",
        STATE / f"{name}.took",
    )
    settings.write_text(
        f"[run]\nsource = gaitsweep\ndata_file = {STATE / name}.lines\nparallel = true\nsigterm = true\n"
        "context = ${PYTEST_CURRENT_TEST-}\nplugins = gently\n"
    )
    shutil.copy(HERE / "gently.py", tree)
    told = {"COVERAGE_PROCESS_START": str(settings), "RECORDED": str(took)}
    subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-p",
            "recording",
            *PYTEST,
            "-n2",
            "--dist=loadfile",
            *new,
        ],
        cwd=tree,
        env={**os.environ, **environment(tree), **told},
        check=False,
    )
    subprocess.run(
        [sys.executable, "-m", "coverage", "combine", "--rcfile", settings, "--quiet"],
        cwd=tree,
        check=True,
    )
    recordings.append(
        {"name": name, "files": new, "took": json.loads(took.read_text())}
    )
    kept.write_text(json.dumps(recordings, indent=0))
    return recordings


class Reach:
    """Which tests reach which lines, also of code that has changed since: its lines are
    found again by their text.
    """

    def __init__(self, recordings: list[dict[str, Any]]) -> None:
        self.newest = {
            file: recorded["name"]
            for recorded in recordings
            for file in recorded["files"]
        }
        self.took: dict[str, float] = {}
        self.of_file: dict[str, list[str]] = defaultdict(list)
        for recorded in recordings:
            for test, took in recorded["took"].items():
                file = test.split("::")[0]
                if self.newest[file] == recorded["name"] and (ROOT / file).exists():
                    self.took[test] = took
                    self.of_file[file].append(test)

    @functools.cache  # noqa: B019
    def _tests(self, path: Path) -> dict[int, set[str]]:
        """Tests by line of a file; what a process was begun by counts as what that test
        reaches.
        """
        found: dict[int, set[str]] = defaultdict(set)
        for name in sorted(set(self.newest.values())):
            if not (before := STATE / name / path).exists():
                continue
            data = CoverageData(f"{STATE / name}.lines")
            data.read()
            contexts = data.contexts_by_lineno(str(STATE / name / "gaitsweep" / path))
            matcher = difflib.SequenceMatcher(
                None,
                before.read_text().splitlines(),
                (ROOT / path).read_text().splitlines(),
                autojunk=False,
            )
            for tag, i, _, j, after in matcher.get_opcodes():
                for line in range(j + 1, after + 1):
                    # A new line is reached by what reaches the one before.
                    there = contexts.get(i + line - j if tag == "equal" else i, ())
                    tests = (
                        re.sub(r" \((setup|call|teardown)\)$", "", each.split("|")[0])
                        for each in there
                    )
                    found[line] |= {
                        test
                        for test in tests
                        if self.newest.get(test.split("::")[0]) == name
                    }
        return found

    def tests(self, path: Path, at: tuple[int, ...]) -> list[str]:
        """Tests that reach any of some lines of a file: quick ones, then slow ones, in
        each files that name it first.

        Last come cheap tests of the same files, which may lean on what the others have
        solved.
        """
        lines, words = (
            self._tests(path),
            set(re.split(r"[/_]", str(path.with_suffix("")))),
        )
        reaching = set().union(*(lines.get(line, ()) for line in at)) & set(self.took)
        if not reaching:
            # Workers that are killed record nothing: whatever reaches the package may
            # notice.
            beside = [
                file.relative_to(ROOT) for file in (ROOT / path.parent).glob("*.py")
            ]
            reaching = set().union(
                *(tests for file in beside for tests in self._tests(file).values())
            ) & set(self.took)
        files = {test.split("::")[0] for test in reaching}
        imports = re.compile(rf"(from|import) .*\b{path.stem}\b")
        kin = {
            f
            for f in files
            if words & set(Path(f).stem.split("_"))
            or imports.search((ROOT / f).read_text())
        }
        tiers: list[dict[str, list[str]]] = [{}, {}, {}]
        for file in files:
            for test in self.of_file[file]:
                is_early = self.took[test] < (10 * CHEAP if file in kin else CHEAP)
                if test in reaching or self.took[test] < CHEAP:
                    tiers[2 if test not in reaching else not is_early].setdefault(
                        file, []
                    ).append(test)
        return [
            test
            for tier in tiers
            for file in sorted(
                tier,
                key=lambda file: (
                    file not in kin,
                    sum(self.took[test] for test in tier[file]),
                ),
            )
            for test in tier[file]
        ]


@pytest.fixture(scope="module", autouse=True)
def forgetting() -> None:
    """No file of tests leans on what another left in memory."""
    for kept in gc.get_objects():
        if isinstance(
            kept, functools._lru_cache_wrapper
        ) and kept.__module__.startswith(("gaitsweep.tasks", "lines")):
            kept.cache_clear()


def pytest_runtest_logstart(nodeid: str) -> None:
    if running := Coverage.current():
        running.switch_context(nodeid)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    used = sum(
        sum(resource.getrusage(who)[:2])
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    report.user_properties = [("used", used - item.config.stash.get(_USED, 0.0))]
    item.config.stash[_USED] = used
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _took[report.nodeid] += dict(report.user_properties).get("used", 0.0)
    if not report.passed:
        _failed.add(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    if not hasattr(session.config, "workerinput"):
        took = {test: time for test, time in _took.items() if test not in _failed}
        Path(os.environ["RECORDED"]).write_text(json.dumps(took, indent=0))
