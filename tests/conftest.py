"""What several test folders share: the command line over toy tasks, in processes of its
own.
"""

import functools
import hashlib
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TOYS = ROOT / "tests" / "test_pipeline"
#: The command line in a process of its own.
GAITSWEEP = (sys.executable, "-W", "ignore", "-m", "gaitsweep")

# Signals that are ignored stay so in every process below: tests under `nohup`, or in
# the background, want them heard.
for _number in (signal.SIGHUP, signal.SIGTERM):
    signal.signal(_number, signal.SIG_DFL)
signal.signal(signal.SIGINT, signal.default_int_handler)

STUDY = """name = "toy"
walker = "E"
[axes]
slope = { from = 0.01, to = 0.2, n = 200 }
w_t = [0.0, 0.25]
[want]
variables = ["stance_angle", "multipliers"]
fits = ["scaling"]
"""


@dataclass
class Toy:
    """A folder in which `gaitsweep` runs toy tasks."""

    folder: Path
    environment: dict[str, str] = field(default_factory=dict)
    started: list[subprocess.Popen] = field(default_factory=list)

    def write(self, text: str = STUDY, name: str = "toy.toml") -> Path:
        (self.folder / name).write_text(text)
        return self.folder / name

    def start(self, *arguments: object, **environment: str) -> subprocess.Popen:
        path = os.pathsep.join([str(ROOT), str(TOYS)])
        process = subprocess.Popen(
            [sys.executable, str(TOYS / "gaitsweep_toy.py"), *map(str, arguments)],
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": path, **self.environment, **environment},
            text=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self.started.append(process)
        return process

    def close(self) -> None:
        for process in self.started:
            if process.poll() is None:
                process.kill()
            process.communicate()

    def __call__(
        self, *arguments: object, expect: int = 0, **environment: str
    ) -> subprocess.CompletedProcess:
        process = self.start(*arguments, **environment)
        out, err = process.communicate(timeout=240)
        assert process.returncode == expect, f"exit {process.returncode}: {out}{err}"
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def bytes(self, name: str = "toy") -> bytes:
        """Bytes of an archive, but for the commit: one made while the tests run is not
        their matter.
        """
        return self.clean(
            (self.folder / "data" / "archive" / f"{name}.nc").read_bytes()
        )

    @staticmethod
    def clean(archive: bytes) -> bytes:
        """An archive's bytes without the commit."""
        return re.sub(rb'"commit": "[0-9a-f]{40}"', b'"commit": ""', archive)


@pytest.fixture
def toy(tmp_path: Path) -> Iterator[Toy]:
    found = Toy(tmp_path)
    found.write()
    yield found
    found.close()


@pytest.fixture(autouse=True)
def _compute_everything_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line computed twice in a test is to be compared with itself, not found again."""
    if "gaitsweep.tasks.studies.solve_points" in sys.modules:
        monkeypatch.setattr(
            sys.modules["gaitsweep.tasks.studies.solve_points"], "_MAX_SURVEYED", 0
        )


SHARE = 1200.0  # of the time of all, that one test of many cases takes at a time [s]


class Soak:
    """What the long tests found: kept, with `SOAK_SECONDS`, until code changes, and not
    found again.

    `make soak` sets how long they may take together; begun again, it goes on where it
    stopped. Without it, a test that is asked for by name runs to its end.
    """

    def __init__(self) -> None:
        self.told: dict[str, tuple[str, float]] = {}
        self.begun: dict[str, tuple[int, dict[str, int]]] = {}
        self.passed: list[str] = []
        limit = os.environ.get("SOAK_SECONDS")
        self.end = time.monotonic() + float(limit or "inf")
        self.file = ROOT / "soak.json" if limit else None
        if not self.file:
            return
        sources = sorted(
            file
            for folder in ("pipeline", "tasks", "tests")
            for file in (ROOT / folder).rglob("*.py")
        )
        self.code = hashlib.sha256(
            b"".join(file.read_bytes() for file in sources)
        ).hexdigest()
        if self.file.exists():
            kept = json.loads(self.file.read_text())
            if kept.pop("code") == self.code:
                vars(self).update(kept)

    @property
    def left(self) -> float:
        """Time left for all long tests [s]."""
        return self.end - time.monotonic()

    def keep(self) -> None:
        if self.file:
            kept = {
                name: getattr(self, name)
                for name in ("code", "told", "begun", "passed")
            }
            self.file.write_text(json.dumps(kept))


SOAK = pytest.StashKey[Soak]()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[SOAK] = Soak()


@functools.cache
def _tiers() -> tuple[dict[str, int], frozenset[str]]:
    """Order of the files of tests, and what is left to `make check`."""
    tiers = tomllib.loads((ROOT / "tests" / "tiers.toml").read_text())
    return {file: k for k, file in enumerate(tiers["dearest_first"])}, frozenset(
        tiers["thorough"]
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that `make test` leaves out, and begin with the dearest files, so
    that no worker ends alone.

    A long test has all its time, unless `make soak` sets how much.
    """
    order, thorough = _tiers()
    for item in items:
        if item.get_closest_marker("soak") and not os.environ.get("SOAK_SECONDS"):
            item.add_marker(pytest.mark.timeout(0))
        if {
            item.nodeid,
            item.nodeid.split("[")[0],
            item.nodeid.split("::")[0],
        } & thorough:
            item.add_marker("thorough")
    items.sort(key=lambda item: order.get(item.nodeid.split("::")[0], -1))


def pytest_runtest_setup(item: pytest.Item) -> None:
    soak = item.config.stash[SOAK]
    if item.get_closest_marker("soak"):
        if item.nodeid in soak.passed:
            pytest.skip("passed before")
        if soak.left < 0:
            pytest.skip("time is over: `make soak` goes on here")


@pytest.fixture
def tell(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Put what a long test found into the table at the end of the run; a short one is
    silent.
    """
    began, name, soak = time.monotonic(), request.node.name, request.config.stash[SOAK]
    if not request.node.get_closest_marker("soak"):
        return lambda found: None
    return lambda found: soak.told.update({name: (found, time.monotonic() - began)})


class Resumed:
    """Cases of a long test, from where an earlier run of it with this code ended, until
    its share of time is over.
    """

    def __init__(self, soak: Soak, name: str):
        self.soak, self.name, self.cases = soak, name, 0
        self.done, found = soak.begun.get(name, (0, {}))
        self.found = Counter(found)

    def __call__(self, cases: int) -> Iterator[int]:
        """Numbers of cases, of so many; what the test counts in `found` is kept too."""
        self.cases = cases
        end = time.monotonic() + (
            min(SHARE, self.soak.left) if self.soak.file else math.inf
        )
        while self.done < cases and time.monotonic() < end:
            yield self.done
            self.done += 1
            self.soak.begun[self.name] = self.done, dict(self.found)
            self.soak.keep()

    @property
    def state(self) -> str:
        return f"{self.done:,} of {self.cases:,}"


@pytest.fixture
def resumed(request: pytest.FixtureRequest) -> Resumed:
    return Resumed(request.config.stash[SOAK], request.node.nodeid)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.when == "call" and item.get_closest_marker("soak"):
        soak, resumed = (
            item.config.stash[SOAK],
            getattr(item, "funcargs", {}).get("resumed"),
        )
        if report.passed and not (resumed and resumed.done < resumed.cases):
            soak.passed.append(item.nodeid)
        soak.keep()
    return report


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    told = config.stash[SOAK].told
    if told:
        terminalreporter.section("what the long tests found")
        width = max(map(len, told))
        for name, (found, seconds) in told.items():
            terminalreporter.write_line(f"{name:<{width}}  {seconds:7.1f} s  {found}")


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Bytes of an undisturbed run, one for all files of tests."""
    toy = Toy(tmp_path_factory.mktemp("whole"))
    toy.write()
    toy("run", "toy.toml")
    return toy.bytes()
