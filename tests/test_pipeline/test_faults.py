"""Each call of the C library fails, once or from then on: one line, the right exit
code, and the next run mends all.
"""

import errno
import hashlib
import os
import pwd
import random
import resource
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from unittest.mock import Mock

import pytest

from conftest import ROOT
from faults import Faults, compiled, started
from gaitsweep.tasks.mechanics import compile_cache
from processes import damaged, drafts

STUDY = """name = "s"
walker = "D"
[axes]
slope = { from = 0.005, to = 0.01, n = 6 }
[want]
variables = ["stance_angle", "period"]
"""
#: Of twelve slopes six are in the journal; the workers finish chunks of six.
LONGER = STUDY.replace("to = 0.01, n = 6", "to = 0.016, n = 12")
RUN = ("run", "s.toml", "--quiet", "--jobs", "1")
FOREVER = 1 << 60
FILES = "write truncate create mkdir sync rename unlink open read lock map"


@dataclass(frozen=True)
class Fault:
    """Calls of these kinds fail, so many times; `codes` are right, or all. One of
    `part` calls is tried.
    """

    kinds: str
    times: int
    error: int
    codes: tuple[int, ...]
    part: int = 1


FAULTS = (
    Fault("write truncate create mkdir", FOREVER, errno.ENOSPC, (0, 4)),
    Fault("write truncate create mkdir rename", 1, errno.ENOSPC, (0, 2, 4)),
    Fault("write truncate create mkdir", FOREVER, errno.EDQUOT, (0, 4)),
    Fault(FILES, 1, errno.EIO, (0, 2)),
    Fault("write sync", FOREVER, errno.EIO, (0, 2)),
    Fault("create mkdir rename unlink", FOREVER, errno.EACCES, (0, 2)),
    Fault("open create", 1, errno.EMFILE, (0, 2, 3)),
    Fault("open create", FOREVER, errno.EMFILE, (0, 2, 3)),
    Fault("map", 1, errno.ENOMEM, (0, 2, 3)),
    Fault("fork", 1, errno.EAGAIN, (0, 3)),
    Fault("thread", 1, errno.EAGAIN, (0, 3)),
    # Where a library ends its process for want of memory, only the next run is promised
    # to mend it.
    Fault("pages malloc", 1, errno.ENOMEM, (), 1000),
    Fault("pages malloc", FOREVER, errno.ENOMEM, (), 10_000),
)


class Trials:
    """A tiny study computed, computed further and reported, undisturbed, and again with
    faults.
    """

    def __init__(self, faults: Faults):
        self.faults, self.folder = faults, faults.folder
        self.commands = {
            "first": RUN,
            "further": RUN,
            "report": ("report", "data/archive/s.nc"),
        }
        self.wanted: dict[str, dict[str, bytes]] = {}
        self.before: dict[str, dict[str, bytes]] = {}
        self.counts: dict[str, dict[str, int]] = {}
        self._starts = {name: faults.folder.with_name(name) for name in self.commands}
        self.folder.mkdir(exist_ok=True)
        (self.folder / "s.toml").write_text(STUDY)
        for name, command in self.commands.items():
            shutil.copytree(self.folder, self._starts[name])
            if name == "first":  # the compiled code is not yet cached
                self._run(name)
                self._restore(name)
            self.before[name] = self._outputs()
            self._run(name)
            self.counts[name] = (
                faults(*command).counts if name == "report" else self._run_again(name)
            )
            self.wanted[name] = self._outputs()
            if name == "first":
                (self.folder / "s.toml").write_text(LONGER)

    def _run(self, name: str) -> dict[str, int]:
        ended = self.faults(*self.commands[name])
        assert (ended.code, ended.err) == (0, ""), ended
        return ended.counts

    def _run_again(self, name: str) -> dict[str, int]:
        self._restore(name)
        return self._run(name)

    def _restore(self, name: str) -> None:
        shutil.rmtree(self.folder)
        shutil.copytree(self._starts[name], self.folder)

    def _outputs(self) -> dict[str, bytes]:
        files = [*self.folder.glob("data/archive/*.nc"), *self.folder.glob("reports/*")]
        return {
            file.name: file.read_bytes()
            for file in files
            if not file.name.startswith(".")
        }

    def cases(self) -> list[tuple[str, Fault, int]]:
        """Command, fault, and which call of its kinds is the first to fail, in an order
        drawn by hash.
        """
        found = [
            (name, fault, k)
            for name, counts in self.counts.items()
            for fault in FAULTS
            for k in range(
                1, 1 + sum(counts[kind] for kind in fault.kinds.split()), fault.part
            )
        ]
        return sorted(
            found, key=lambda case: hashlib.sha256(repr(case).encode()).digest()
        )

    def problems(self, name: str, fault: Fault, first: int) -> tuple[list[str], str]:
        """What is wrong after a fault and after the same command again; and how the
        fault ended.
        """
        self._restore(name)
        ended = self.faults(
            *self.commands[name],
            kinds=fault.kinds,
            first=first,
            times=fault.times,
            error=fault.error,
        )
        found, lines = [], ended.err.splitlines()
        # HDF5 crashes if its last write, on closing a file that was flushed before,
        # fails: the next run mends that.
        is_last_write = (
            ended.code == -11
            and ended.what.startswith(("write", "truncate"))
            and "/.s.nc." in ended.what
        )
        if fault.codes and ended.code not in fault.codes and not is_last_write:
            found.append(f"exit {ended.code}")
        is_said = (
            len(lines) <= 1
            and "Traceback" not in ended.err
            and bool(lines) >= (ended.code > 0)
        )
        if not is_said and "malloc" not in fault.kinds:
            found.append(f"standard error is {ended.err!r}")
        if ended.left:
            found.append("processes are left")
        kept = {
            file: data for file, data in self._outputs().items() if file.endswith(".nc")
        }
        whole = [
            {f: d for f, d in each[name].items() if f.endswith(".nc")}
            for each in (self.before, self.wanted)
        ]
        if kept not in whole and ended.code != 1:
            found.append(f"archives are neither old nor new: {list(kept)}")
        again = self.faults(*self.commands[name])
        if (
            ended.code == again.code == 1
        ):  # a library met want of memory and said something else
            again = self.faults(*self.commands[name], "--retry-failed")
        if again.code or again.err:
            found.append(f"again: exit {again.code}, {again.err!r}")
        elif self._outputs() != self.wanted[name]:
            found.append("again: other bytes")
        if left := drafts(self.folder) - {".lock"}:
            found.append(f"again: drafts {left}")
        how = f"{errno.errorcode[fault.error]} {ended.what.split()[0] if ended.what else 'none'} {ended.code}"
        return found, f"{how}: {ended.what} {ended.err.strip()}"


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults")
    library = compiled(folder)
    if not library:
        pytest.skip("there is no C compiler, or this is not Linux")
    with started(
        folder / "run", library, GAITSWEEP_CACHE=str(folder / "cache")
    ) as faults:
        yield Trials(faults)


@pytest.mark.thorough
@pytest.mark.parametrize("n", [8, pytest.param(None, marks=pytest.mark.soak)])
def test_whatever_call_fails_the_same_command_again_gives_the_same_bytes(
    trials, tell, resumed, n
):
    cases = trials.cases()
    for k in range(n) if n else resumed(len(cases)):
        found, how = trials.problems(*cases[k])
        assert not found, (cases[k], how)
        resumed.found[how.split(":")[0]] += 1
    tell(
        f"{resumed.state}, each with the bytes of an undisturbed run afterwards: {dict(sorted(resumed.found.items()))}"
    )


SOLVE = (
    "import json; from gaitsweep.pipeline.study.single_point import solve;"
    "print(json.dumps(solve('D', 0.01, {}, False, 1, None)['gaits']))"
)


def _solving(cache, largest):
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "GAITSWEEP_CACHE": str(cache),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    command = [sys.executable, "-W", "ignore", "-c", SOLVE]
    return subprocess.Popen(
        command, env=environment, text=True, preexec_fn=limit, **pipes
    )


def _solved(cache, n=1, largest=resource.RLIM_INFINITY, said=""):
    """What so many processes that share a compile cache give, of which all give the
    same; its files end at a size.

    Nothing else is printed, but for one line that ends as `said`.
    """
    processes = [_solving(cache, largest) for _ in range(n)]
    ends = {
        (*process.communicate(timeout=900), process.returncode) for process in processes
    }
    ((out, err, code),) = ends
    assert (err.count("\n"), code) == (bool(said), 0) and err.endswith(said), err
    return out


@pytest.mark.parametrize(
    ("n", "damages"), [(2, 1), pytest.param(20, 60, marks=pytest.mark.soak)]
)
def test_a_compile_cache_changes_no_number(tmp_path, tell, n, damages):
    """Cold and shared by processes, then with a bit of its machine code flipped, or
    torn and damaged anyhow.
    """
    cache = tmp_path / "cache"
    wanted = _solved(cache, n)
    whole = {file: file.read_bytes() for file in cache.glob("*.compiled")}
    assert len(whole) > 2
    for k in range(damages):
        dice = random.Random(k)
        file = dice.choice(sorted(whole))
        if k % 2:
            data = damaged(whole[file], dice)
        else:
            code = bytearray(whole[file])
            code[dice.randrange(100, len(code))] ^= 1 << dice.randrange(8)
            data = bytes(code)
        file.write_bytes(data)

        assert _solved(cache) == wanted, k
        assert data == whole[file] or file.read_bytes() != data
    tell(f"{n} processes share a cold cache; {damages} damaged: the same numbers")


def test_a_compile_cache_is_not_used_where_others_may_change_it(tmp_path):
    """It is said once, and nothing is kept there."""
    folder = tmp_path / "some" / "cache"
    folder.mkdir(parents=True)
    folder.chmod(0o777)
    line = f"The compile cache in {folder} is not used: {folder} is no folder that only you may change.\n"

    _solved(folder, said=line)

    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    "sizes",
    [(200_000,), pytest.param((0, 1, 4096, 50_000, 300_000), marks=pytest.mark.soak)],
)
def test_a_compile_cache_that_cannot_be_written_changes_nothing_but_time(
    tmp_path, tell, sizes
):
    """Its disk is full at several sizes, also of one that was filled before; its folder
    is a file, or read only.
    """
    cache, file = tmp_path / "cache", tmp_path / "file"
    wanted = _solved(cache)
    file.write_text("x")
    for size in sizes:
        full = tmp_path / f"full at {size}"
        assert _solved(full, largest=size) == wanted, size
        assert _solved(full) == wanted, size
    assert _solved(file) == wanted and file.read_text() == "x"
    if len(sizes) > 1:
        assert (
            _solved(cache, largest=0)
            == _solved("/proc/self")
            == _solved("/proc/none")
            == wanted
        )
        for code in cache.glob("*.compiled"):
            code.unlink()
            code.mkdir()
        assert _solved(cache) == wanted
    tell(
        f"full at {len(sizes)} sizes, a file or folder in its place, a folder read only: the same numbers"
    )


def test_who_has_no_home_has_no_compile_cache(tmp_path, monkeypatch):
    """A folder called `~` was made where the command was given."""
    monkeypatch.chdir(tmp_path)
    for name in ("HOME", "XDG_CACHE_HOME", "GAITSWEEP_CACHE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", Mock(side_effect=KeyError))
    assert compile_cache.usable_folder() is None
    assert not list(tmp_path.iterdir())
