"""The command line with calls of the C library that fail: `Faults`, and the process
from which it forks every run.

A run is forked from a process that has imported everything, so thousands can be tried;
its workers are new processes.
"""

import contextlib
import ctypes
import importlib
import json
import mmap
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
#: Kinds of calls that `faults.c` counts, in its order.
KINDS = (
    *(
        "write",
        "truncate",
        "create",
        "mkdir",
        "sync",
        "rename",
        "unlink",
        "open",
        "read",
        "lock",
        "map",
    ),
    *("fork", "thread", "pages", "malloc"),
)
_HEAD = struct.Struct(f"8Q{len(KINDS)}Q512s600s")
#: What commands import when they first need it.
_IMPORTED = (
    *("charset_normalizer", "joblib", "netCDF4", "dask.array", "scipy.sparse"),
    *(
        "gaitsweep.pipeline.cli.run",
        "gaitsweep.pipeline.engine.runner",
        "gaitsweep.pipeline.report.pages",
        "gaitsweep.pipeline.study.parse",
    ),
)
_SECONDS = 120  # a run that takes longer hangs
_SUBREAPER = 36  # of prctl: orphans below become children of this process


@dataclass(frozen=True)
class Ended:
    """How a run ended: exit code (minus a signal), its standard error, and processes of
    it left after 3 s.

    `counts` holds the calls of each kind, `fired` the calls that failed and `what` the
    kind and file of the first.
    """

    code: int
    err: str
    left: int
    counts: dict[str, int]
    fired: int
    what: str


class Faults:
    """Runs of the command line below a folder."""

    def __init__(self, folder: Path, library: Path, **environment: str):
        self.folder = folder
        path = folder.with_name(f"{folder.name}.control")
        path.write_bytes(bytes(_HEAD.size))
        with open(path, "r+b") as file:
            self._control = mmap.mmap(file.fileno(), _HEAD.size)
        self._process = subprocess.Popen(
            [sys.executable, "-W", "ignore", __file__, str(path)],
            env={
                **os.environ,
                **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1"),
                "PYTHONPATH": str(ROOT),
                "LD_PRELOAD": str(library),
                "FAULTS": str(path),
                **environment,
            },
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __call__(
        self,
        *command: object,
        kinds: str = "",
        first: int = 0,
        times: int = 1,
        error: int = 0,
    ) -> Ended:
        """Run a command in which calls of some kinds fail, from the `first` on so many
        times.
        """
        mask = sum(1 << KINDS.index(kind) for kind in kinds.split())
        root, n = bytes(f"{self.folder}/", "utf-8"), len(KINDS)
        self._control[:] = _HEAD.pack(
            0, mask, first, times, error, self._process.pid, 0, 0, *[0] * n, root, b""
        )
        print(
            json.dumps([str(self.folder), *map(str, command)]),
            file=self._process.stdin,
            flush=True,
        )
        code, left = json.loads(self._process.stdout.readline())
        _, _, _, _, _, _, _, fired, *counts, _, what = _HEAD.unpack(self._control[:])
        kind, _, file = what.split(b"\0")[0].decode().partition(" ")
        err = self.folder.with_name(f"{self.folder.name}.err").read_text()
        called = dict(zip(KINDS, counts, strict=True))
        return Ended(
            code, err, left, called, fired, f"{KINDS[int(kind)]} {file}" if kind else ""
        )

    def close(self) -> None:
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


@contextlib.contextmanager
def started(folder: Path, library: Path, **environment: str) -> Iterator[Faults]:
    found = Faults(folder, library, **environment)
    try:
        yield found
    finally:
        found.close()


def compiled(folder: Path) -> Path | None:
    """The library, compiled; None where there is no compiler."""
    compiler, library = shutil.which("cc") or shutil.which("gcc"), folder / "faults.so"
    if not compiler or sys.platform != "linux":
        return None
    source = Path(__file__).with_suffix(".c")
    subprocess.run(
        [
            compiler,
            "-O2",
            "-Wall",
            "-Werror",
            "-shared",
            "-fPIC",
            "-o",
            library,
            source,
            "-ldl",
        ],
        check=True,
    )
    return library


def _serve(path: str) -> list[str] | None:
    """Fork for every command on standard input and tell how it ended; in the child,
    return the command.
    """
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    with open(path, "r+b") as file:
        control = mmap.mmap(file.fileno(), _HEAD.size)
    for line in sys.stdin:
        folder, *command = json.loads(line)
        child = os.fork()
        if not child:
            os.chdir(folder)
            signal.alarm(_SECONDS)
            for stream, to in ((0, os.devnull), (1, os.devnull), (2, f"{folder}.err")):
                file = os.open(to, os.O_RDWR | os.O_CREAT | os.O_TRUNC * (stream == 2))
                os.dup2(file, stream)
                os.close(file)
            control[0] = 1
            return command
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        end, left = time.monotonic() + 3, _left()
        while left and time.monotonic() < end:
            time.sleep(0.01)
            left = _left()
        control[0] = 0
        print(json.dumps([code, left]), flush=True)
    return None


def _left() -> bool:
    """Whether a process below is left."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


if __name__ == "__main__":
    from gaitsweep.tasks.contract import registry

    # Twelve slopes are a long line of whole chunks, which workers finish.
    registry.SHORT_LINE = 8
    from gaitsweep.pipeline.grid import grid

    grid.MOST_POINTS = 6
    from gaitsweep.pipeline.cli import commands

    for name in _IMPORTED:
        importlib.import_module(name)

    asked = _serve(sys.argv[1])
    if asked:
        sys.exit(commands.main(asked))
