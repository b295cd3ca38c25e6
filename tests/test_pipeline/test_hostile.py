"""Hostile texts and files by the thousand: one line each, no traceback, no hang, little
memory, nothing executed.
"""

import contextlib
import json
import math
import mmap
import os
import random
import re
import resource
import shutil
import signal
import sqlite3
import struct
import subprocess
import sys
import traceback
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from gaitsweep import load
from gaitsweep.pipeline.archive import diff, layout, read, verify, write
from gaitsweep.pipeline.errors import ArchiveError, GaitsweepError
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.report import pages
from gaitsweep.pipeline.store import file
from gaitsweep.pipeline.store.file import CorruptStoreError, repair
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.study import files, parse
from processes import damaged

SECONDS, GROWTH = 10, 1 << 30  # what one text or file may take [s], [byte]
BATCH = 500  # cases of one child
#: Events of the interpreter that mean that something was executed.
EXECUTED = (
    "exec",
    "pickle.find_class",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "subprocess.Popen",
)
STUDIES = [
    re.sub(r"[./]+walkers/[\w-]+\.toml", "w.toml", file.read_text())
    for file in sorted(ROOT.glob("data/studies/*/*.toml"))
]
WALKERS = [file.read_text() for file in sorted(ROOT.glob("data/walkers/*.toml"))]
STRINGS = [
    "E",
    "A",
    "log",
    "slope",
    "long",
    "basin",
    "../../etc/passwd",
    "\\u0000",
    "\\u202e",
    "💥",
    "x.toml",
    "w.toml",
]
HOSTILE = [
    *(
        "nan",
        "inf",
        "-inf",
        "1e999",
        "-0.0",
        "5e-324",
        "1e308",
        "-1",
        "0",
        "1",
        "true",
        "0x7fffffffffffffff",
        "[]",
        "{}",
    ),
    *(
        "1979-05-27",
        "1_0",
        "+1",
        "1e-400",
        "9" * 400,
        "-" + "9" * 19,
        '"' + "x" * 5000 + '"',
        '"""\n"""',
        "[0.01, 'a']",
    ),
    *(
        "[" * 40 + "]" * 40,
        "[" * 3000,
        "{ a = " * 40 + "1" + " }" * 40,
        "[[0.01], [0.02]]",
        "[nan]",
        "[1e-300, 1e300]",
    ),
    "{ from = 1e-300, to = 1e300, n = 200, spacing = 'log' }",
    "{ from = 0, to = 1, n = 1000000000000 }",
    "{ from = 1, to = 1, n = 1 }",
    "{ from = nan, to = inf, n = -1 }",
    *(f'"{text}"' for text in STRINGS),
]


def mutated_text(dice, texts):
    """A text with some lines, values or bytes of it changed."""
    lines = dice.choice(texts).splitlines()
    for _ in range(dice.choice([1, 1, 2, 3, 6])):
        at, how = dice.randrange(len(lines)), dice.randrange(8)
        if how == 0:
            lines.insert(at, lines[dice.randrange(len(lines))])
        elif how == 1:
            del lines[at]
        elif how == 2:
            lines.insert(at, dice.choice(dice.choice(texts).splitlines()))
        elif how == 3:
            numbers = list(
                re.finditer(
                    r"(?<![\w.])-?\d[\w.+-]*|\"[^\"]*\"|\[[^\[\]]*\]|\{[^{}]*\}",
                    lines[at],
                )
            )
            if numbers:
                place = dice.choice(numbers)
                lines[at] = (
                    lines[at][: place.start()]
                    + dice.choice(HOSTILE)
                    + lines[at][place.end() :]
                )
        elif how == 4:
            lines[at] = f"{lines[at].partition('=')[0]} = {dice.choice(HOSTILE)}"
        elif how == 5:
            lines[at] = f"{dice.choice(HOSTILE)} = {lines[at].partition('=')[2]}"
        elif how == 6:
            words = re.findall(r"\w+", dice.choice(texts)) or ["x"]
            lines[at] = re.sub(
                r"\w+", dice.choice(words), lines[at], count=dice.choice([1, 2])
            )
        else:
            line = bytearray(lines[at].encode("utf-8", "surrogateescape") or b"x")
            line[dice.randrange(len(line))] = dice.randrange(256)
            lines[at] = line.decode("utf-8", "surrogateescape")
        if not lines:
            break
    return "\n".join(lines).encode("utf-8", "surrogateescape")


def planned(folder, dice):
    """A mutated study, perhaps with a mutated walker beside it, is read and planned."""
    (folder / "w.toml").write_bytes(mutated_text(dice, WALKERS))
    (folder / "s.toml").write_bytes(mutated_text(dice, STUDIES))
    if dice.random() < 0.2:
        files.walker("w.toml", folder)
    study = parse.read(folder / "s.toml")
    if study.points <= 100_000:
        summary(Plan(study, Journal(folder / "none", write=False)))


def read_all(folder):
    """Import and compile whatever good studies need, once."""
    (folder / "w.toml").write_text(WALKERS[0])
    for text in STUDIES:
        (folder / "s.toml").write_text(text)
        summary(
            Plan(parse.read(folder / "s.toml"), Journal(folder / "none", write=False))
        )


#: Journals with a chunk of a line, with lines side by side, and with tables of another
#: kind.
RUNS = {
    "chunk": 'walker = "D"\n[axes]\nslope = { from = 0.004, to = 0.016, n = 300 }\n[want]\nfits = ["scaling"]\n',
    "lines": 'walker = "E"\n[axes]\nslope = [0.01, 0.02]\nR = [0.0, 0.1]\n[want]\nvariables = ["multipliers"]\n',
    "orbit": 'kind = "orbit"\nwalker = "D"\n[axes]\nslope = [0.01, 0.015]\n[options]\nsteps = 30\n',
}


def run_all(folder):
    """Archives and journals of real runs."""
    for name, text in RUNS.items():
        (folder / f"{name}.toml").write_text(f'name = "{name}"\n{text}')
    code = (
        "import sys; from gaitsweep.pipeline.cli.commands import main; sys.exit(main())"
    )
    command = [
        sys.executable,
        "-W",
        "ignore",
        "-c",
        code,
        "run",
        "--quiet",
        *(f"{name}.toml" for name in RUNS),
    ]
    subprocess.run(
        command, cwd=folder, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    for k in range(30):
        for case in (crafted, stored):
            with contextlib.suppress(Exception):
                case(folder, random.Random(k))


ATTRIBUTES = [
    *(
        "",
        "x",
        "💥",
        "../../../tmp/x",
        "<script>alert(1)</script>",
        "{" * 3000,
        "{}",
        "[1]",
        "null",
        "nan",
        "\x1b[2J\n",
    ),
    *(
        0,
        -1,
        2**62,
        np.nan,
        np.inf,
        1e308,
        np.array([], "f8"),
        np.arange(3),
        np.arange(2000),
        "9" * 5000,
        "E" * 100_000,
    ),
]


def crafted(folder, dice):
    """An archive of valid HDF5 whose attributes, values or names are not as gaitsweep
    writes them; checksums are.
    """
    name, path = dice.choice([*RUNS]), folder / "crafted.nc"
    original = folder / "data" / "archive" / f"{name}.nc"
    shutil.copy(original, path)
    with read.open_netcdf(path, "a") as file:
        file.set_auto_chartostring(False)
        for _ in range(dice.choice([1, 1, 2, 4])):
            _craft(file, dice)
        file.set_auto_chartostring(True)
        if dice.random() < 0.9:
            with contextlib.suppress(Exception):
                _mend_checksums(file)
    how = dice.random()
    with contextlib.suppress(GaitsweepError):
        verify.verify(path)
    with contextlib.suppress(GaitsweepError):
        diff.diff(original, path)
    with contextlib.suppress(GaitsweepError):
        load(path)
    for table in ("branches", "special_points", "orbits") if how < 0.5 else ():
        with contextlib.suppress(GaitsweepError):
            load(path, table)
    if how < 0.1:
        pages.write([path], folder / "reports", only=True)
    with read.open_archive(path):
        pass


def _craft(file, dice):
    groups = [file]
    for group in groups:
        groups += group.groups.values()
    group = dice.choice([file, *groups])
    variables, how = [*group.variables.values()], dice.randrange(6)
    owner = dice.choice([group, *variables])
    value = dice.choice(ATTRIBUTES)
    with contextlib.suppress(
        AttributeError, TypeError, ValueError, IndexError, RuntimeError, OverflowError
    ):
        if how == 0:
            owner.setncattr(dice.choice(owner.ncattrs()), value)
        elif how == 1:
            owner.delncattr(dice.choice(owner.ncattrs()))
        elif how == 2:
            variable = dice.choice(variables)
            here = tuple(dice.randrange(n) for n in variable.shape)
            is_text = variable.dtype == "S1"
            variable[here] = (
                str(value)[:1].encode()
                if is_text
                else dice.choice([-1, 0, 7, 127, 1e300, np.nan, -np.inf])
            )
        elif how == 3:
            group.renameVariable(
                dice.choice([*group.variables]),
                dice.choice(["x", "slope2", "status", "a/b", "💥"]),
            )
        elif how == 4:
            variable = dice.choice(variables)
            variable[...] = (
                str(value)[:1].encode()
                if variable.dtype == "S1"
                else dice.choice([-1, 0, 99])
            )
        else:
            group.createVariable(
                dice.choice(["y", "stance_angle2", "status"]),
                dice.choice(["f8", "i1", str]),
                (),
            )


def _mend_checksums(file):
    file.set_auto_mask(False)
    sums = {name: read._checksum(variable) for name, variable in layout.variables(file)}
    file.checksums = json.dumps(sums, sort_keys=True)


def stored(folder, dice):
    """A journal with faults, in bytes or in rows with right checksums: planned,
    repaired and archived.

    Of a row that somebody made, whose values can be unpacked and mean nothing, the
    command may say "Internal error".
    """
    name, path = dice.choice([*RUNS]), folder / "stored.journal"
    for suffix in ("", "-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
        kept = folder / "data/archive/.gaitsweep" / f"{name}.journal{suffix}"
        if kept.exists():
            shutil.copy(kept, path.with_name(path.name + suffix))
    is_made = dice.random() < 0.6
    if is_made:
        _change_row(path, dice)
    else:
        target = dice.choice(
            [found for found in folder.glob("stored.journal*") if found.stat().st_size]
        )
        target.write_bytes(damaged(target.read_bytes(), dice))
    study = parse.read(folder / f"{name}.toml")
    for _ in range(3):
        journal = None
        try:
            journal = Journal(path)
            plan = Plan(study, journal)
            summary(plan)
            write.write(plan, folder / "stored.nc")
            return
        except CorruptStoreError:
            repair(path)
        except ArchiveError as error:  # the mark by which it is known, in bytes
            assert "move it away" in str(error)
            return
        except (ArithmeticError, LookupError, SystemError, TypeError, ValueError):
            if not is_made:
                raise
        finally:
            if journal:
                journal.close()


def _change_row(path, dice):
    """Change one value of a row, and its checksums."""
    db = sqlite3.connect(path)
    number, *row = dice.choice(
        db.execute("SELECT id, key, head, payload FROM records").fetchall()
    )
    at = dice.randrange(len(row))
    old = row[at]
    if isinstance(old, bytes) and old and dice.random() < 0.9:
        row[at] = damaged(old, dice)
    else:
        row[at] = dice.choice(
            [
                None,
                "",
                b"",
                -1,
                0,
                2**62,
                1e300,
                math.nan,
                "x" * 1000,
                "ok",
                b"junk",
                17,
                0.01,
            ]
        )
    with contextlib.suppress(TypeError, sqlite3.Error, OverflowError):
        key, head, payload = row
        sums = file.sums(number, key, head, payload)
        changed = number, key, *sums, head, payload
        db.execute("INSERT OR REPLACE INTO records VALUES (?, ?, ?, ?, ?, ?)", changed)
    db.commit()
    db.close()


def _memory():
    return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE


def _is_ours(event, arguments, folder):
    """Whether a program or library is executed, as on import, or a tuple is given the
    names of a table.
    """
    if event != "exec":
        return False
    code = arguments[0]
    inner = [
        constant for constant in code.co_consts if hasattr(constant, "co_varnames")
    ]
    is_file = os.path.isabs(code.co_filename) and not code.co_filename.startswith(
        str(folder)
    )
    return is_file or (len(inner) == 1 and inner[0].co_varnames[:1] == ("_cls",))


def _watched(case, folder, first, last, place, found):
    """In a child: cases, each under a watch; the number of the present one is kept in
    shared memory.
    """
    resource.setrlimit(
        resource.RLIMIT_AS, (_virtual() + GROWTH, resource.RLIM_INFINITY)
    )
    executed, counts = [], Counter()

    def watch(event, arguments):
        if event in EXECUTED and not _is_ours(event, arguments, folder):
            executed.append((event, arguments))

    sys.addaudithook(watch)
    start = _memory()
    for k in range(first, last):
        place[:8] = struct.pack("<Q", k)
        signal.alarm(SECONDS)
        try:
            case(folder, random.Random(k))
            counts["accepted"] += 1
        except GaitsweepError as error:
            counts["refused"] += 1
            assert "\n" not in str(error) and len(str(error)) < 1000, str(error)
        signal.alarm(0)
        assert not executed, executed
        assert _memory() - start < GROWTH // 2, "memory grows"
    found.write_text(json.dumps(counts))


def _virtual():
    return int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE


def survived(case, folder, first, last):
    """Try a batch of cases in a child; how they ended, and what went wrong with the one
    that ended it, if any.
    """
    place, found, said = mmap.mmap(-1, 8), folder / "found.json", folder / "said"
    child = os.fork()
    if not child:
        code = 1
        try:
            _watched(case, folder, first, last, place, found)
            code = 0
        except BaseException:
            said.write_text(traceback.format_exc())
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    (k,) = struct.unpack("<Q", place[:8])
    if code:
        return (
            {},
            f"{case.__name__} {k}: {said.read_text() if code == 1 else signal.Signals(-code).name}",
        )
    return json.loads(found.read_text()), ""


@pytest.mark.parametrize(
    ("prepare", "case", "n"),
    [
        pytest.param(prepare, case, n, marks=marks, id=f"{case.__name__}-{n}")
        for prepare, case, short, long in (
            (read_all, planned, 500, 1_000_000),
            (run_all, crafted, 25, 20_000),
            (run_all, stored, 50, 80_000),
        )
        for n, marks in ((short, ()), (long, pytest.mark.soak))
    ],
)
def test_hostile_input_is_refused_or_read(
    tmp_path, monkeypatch, tell, resumed, prepare, case, n
):
    """Of the archives that crash the netCDF library, which a process of its own tries,
    see `test_archive.py`.
    """
    monkeypatch.setattr(read, "probe", lambda paths: None)
    prepare(tmp_path)
    batch = min(BATCH, n)
    for k in resumed(n // batch) if n > BATCH else range(n // batch):
        counts, wrong = survived(case, tmp_path, k * batch, (k + 1) * batch)
        assert not wrong, wrong
        resumed.found.update(counts)
    tell(f"{resumed.found.total():,} of {n:,} cases: {dict(resumed.found)}")
