"""What several test folders share: the command line over toy tasks, in processes of its own."""

import functools
import gc
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TOYS = ROOT / "tests" / "test_pipeline"

# Signals that are ignored stay so in every process below: tests under `nohup`, or in the background, want them heard.
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
            [sys.executable, "-W", "ignore", str(TOYS / "gaitsweep_toy.py"), *map(str, arguments)],
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

    def __call__(self, *arguments: object, expect: int = 0, **environment: str) -> subprocess.CompletedProcess:
        process = self.start(*arguments, **environment)
        out, err = process.communicate(timeout=240)
        assert process.returncode == expect, f"exit {process.returncode}: {out}{err}"
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def bytes(self, name: str = "toy") -> bytes:
        """Bytes of an archive, but for the commit: one made while the tests run is not their matter."""
        return self.clean((self.folder / "data" / "archive" / f"{name}.nc").read_bytes())

    @staticmethod
    def clean(archive: bytes) -> bytes:
        """An archive's bytes without the commit."""
        return re.sub(rb'"commit": "[0-9a-f]{40}"', b'"commit": ""', archive)


@pytest.fixture(scope="module", autouse=True)
def forgetting(pytestconfig: pytest.Config) -> None:
    """While it is recorded which tests reach a function, no file of tests leans on what another left in memory."""
    if pytestconfig.stash[RECORDING]:
        for kept in gc.get_objects():
            if isinstance(kept, functools._lru_cache_wrapper) and kept.__module__.startswith(("tasks", "lines")):
                kept.cache_clear()


@pytest.fixture
def toy(tmp_path: Path) -> Iterator[Toy]:
    found = Toy(tmp_path)
    found.write()
    yield found
    found.close()


@pytest.fixture(autouse=True)
def _compute_everything_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line computed twice in a test is to be compared with itself, not found again."""
    if "tasks.solve_points" in sys.modules:
        monkeypatch.setattr(sys.modules["tasks.solve_points"], "_MAX_SURVEYED", 0)


TOLD = pytest.StashKey[list[tuple[str, str, float]]]()
RECORDING = pytest.StashKey[bool]()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[TOLD] = []
    # mutmut records calls in this process alone; others started from here run as ever.
    config.stash[RECORDING] = os.environ.get("MUTANT_UNDER_TEST") == "stats"
    if config.stash[RECORDING]:
        del os.environ["MUTANT_UNDER_TEST"]


@pytest.fixture
def tell(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Put what a long test found into the table at the end of the run; a short one is silent."""
    began, name = time.monotonic(), request.node.name
    if not request.node.get_closest_marker("soak"):
        return lambda found: None
    return lambda found: request.config.stash[TOLD].append((name, found, time.monotonic() - began))


class Resumed:
    """Cases of a long test, from where an earlier run of it with this code ended, until its share of time is over."""

    def __init__(self, name: str):
        self.found: Counter[str] = Counter()
        self.done = self.cases = 0
        self._file = ROOT / "soak" / f"{name}.json"

    def __call__(self, cases: int) -> Iterator[int]:
        """Numbers of cases, of so many; what the test counts in `found` is kept too."""
        self.cases = cases
        code = hashlib.sha256(b"".join(file.read_bytes() for file in sorted(ROOT.glob("[pt]*/**/*.py")))).hexdigest()
        kept = json.loads(self._file.read_text()) if self._file.exists() else {}
        if kept.get("code") == code and kept["done"] < cases:
            self.done, self.found = kept["done"], Counter(kept["found"])
        end = time.monotonic() + float(os.environ.get("SOAK_SECONDS", "1200"))
        self._file.parent.mkdir(exist_ok=True)
        try:
            while self.done < cases and time.monotonic() < end:
                yield self.done
                self.done += 1
        finally:
            self._file.write_text(json.dumps({"code": code, "done": self.done, "found": self.found}))

    @property
    def state(self) -> str:
        return f"{self.done:,} of {self.cases:,}"


@pytest.fixture
def resumed(request: pytest.FixtureRequest) -> Resumed:
    return Resumed(re.sub(r"\W+", "-", request.node.name).strip("-"))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    told = config.stash[TOLD]
    if told:
        terminalreporter.section("what the long tests found")
        width = max(len(name) for name, _, _ in told)
        for name, found, seconds in told:
            terminalreporter.write_line(f"{name:<{width}}  {seconds:7.1f} s  {found}")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Bytes of an undisturbed run."""
    toy = Toy(tmp_path_factory.mktemp("whole"))
    toy.write()
    toy("run", "toy.toml")
    return toy.bytes()
