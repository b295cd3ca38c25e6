"""The archive is plain CF netCDF that any tool opens; `verify` and `diff` see what is
wrong with it.
"""

import contextlib
import errno
import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import tomllib
import zlib
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import netCDF4
import numpy as np
import pytest
import xarray as xr

from conftest import ROOT, STUDY, Toy
from gaitsweep.pipeline.api.studies import load
from gaitsweep.pipeline.archive import (
    attributes,
    diff,
    layout,
    read,
    result_tables,
    structure,
    verify,
    write,
)
from gaitsweep.pipeline.archive.points import PointWriter
from gaitsweep.pipeline.archive.provenance import commit, stored
from gaitsweep.pipeline.archive.unfold import dataset
from gaitsweep.pipeline.archive.written import write_strings
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.errors import ArchiveError, DiskFullError
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.grid.boxes import boxes
from gaitsweep.pipeline.report import pages
from gaitsweep.pipeline.statuses import ALL_STATUSES as STATUS
from gaitsweep.pipeline.store.file import CorruptStoreError
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.store.record import ChunkCodec, Record
from gaitsweep.pipeline.study import parse
from gaitsweep.tasks.contract.accuracy import OF_INTEGRATION
from gaitsweep.tasks.contract.registry import ALWAYS
from processes import descendants, ended, suspend

EVERYTHING = STUDY.replace('"multipliers"', '"multipliers", "energy", "violations"')


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    toy = Toy(tmp_path_factory.mktemp("archive"))
    toy.write(EVERYTHING)
    toy("run", "toy.toml")
    return toy.folder / "data" / "archive" / "toy.nc"


@pytest.fixture
def copy(made, tmp_path):
    shutil.copy(made, tmp_path / "copy.nc")
    return tmp_path / "copy.nc"


def test_it_can_be_loaded_while_it_is_open(made):
    """In a process of its own, which the netCDF library ends where strings are read of
    a file opened three times.
    """
    script = (
        "import sys, xarray as xr; from gaitsweep.pipeline.api.studies import load; path = sys.argv[1];"
        "held = xr.open_dataset(path), xr.open_datatree(path);"
        "one, other, _ = [load(path) for _ in range(3)]; tables = [load(path, 'fits/scaling') for _ in range(2)];"
        "print(one.identical(other), tables[0].equals(tables[1]), held[0].stance_angle.equals(one.stance_angle))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script, made], cwd=ROOT, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "True True True\n", "")


@pytest.mark.parametrize("values", [["long", "", "à 30 °", "a_b c"], [""], []])
def test_strings_are_those_that_were_written(tmp_path, values):
    with netCDF4.Dataset(tmp_path / "s.nc", "w") as file:
        file.createDimension("row", len(values))
        for name in ("one", "other"):
            write_strings(
                file, name, "row", values, {"long_name": "some words", "units": "1"}
            )
    with netCDF4.Dataset(tmp_path / "s.nc") as file:
        assert file["one"][...].tolist() == file["other"][...].tolist() == values
        assert len(file.dimensions) == 2 and layout.dims(file["one"]) == ("row",)
        assert layout.checksum(file["one"][...]) == layout.checksum(
            np.array(values, object)
        )
    with xr.open_dataset(tmp_path / "s.nc") as found:
        assert found.one.values.tolist() == values and found.one.attrs == {
            "long_name": "some words",
            "units": "1",
        }


def test_plain_xarray_opens_it(made):
    with xr.open_dataset(made) as found:
        assert dict(found.sizes) == {
            "slope": 200,
            "w_t": 2,
            "gait": 2,
            "multiplier": 3,
            "reason_index": 2,
        }
        assert found.gait.values.tolist() == ["long", "short"]
        angle = found.stance_angle.sel(gait="long", w_t=0.25)
        np.testing.assert_array_equal(angle, np.cbrt(found.slope) * 1.25)
        short = found.stance_angle.sel(gait="short")
        assert (np.isfinite(short) == (found.status.sel(gait="short") == 0)).all()
        assert (
            found.branch.dtype == np.int16
            and (found.branch.sel(gait="long") == 0).all()
        )
        np.testing.assert_array_equal(
            found.branch.sel(gait="short"), np.where(np.isfinite(short), 1, -1)
        )
        reasons = found.reason_text.values[found.reason.sel(gait="short")]
        assert set(reasons[found.slope.values > 0.1].ravel()) == {
            "The branch ends below this slope."
        }
    with xr.open_dataset(made, group="fits/scaling") as fits:
        assert fits.walker.values.tolist() == ["E", "E"] and fits.exponent.dims == (
            "row",
        )


def test_everything_is_described(made):
    with netCDF4.Dataset(made) as file:
        assert file.Conventions == "CF-1.11"
        for variable in file.variables.values():
            assert variable.long_name and variable.units
            if variable.name not in (
                *file.dimensions,
                "status",
                "reason",
                "reason_text",
            ):
                assert variable.ancillary_variables == "status reason"
                assert (
                    variable.filters()["complevel"] == 1
                    and variable.filters()["fletcher32"]
                )
            else:
                assert "ancillary_variables" not in variable.ncattrs()
        assert (
            file["slope"].units == file["stance_angle"].units == "rad"
            and file["loss_normal"].units == "1"
        )
        assert not any(
            dimension.isunlimited() for dimension in file.dimensions.values()
        )
        assert (
            file["status"].dtype == np.int8
            and "worker_died" in file["status"].flag_meanings
        )
        assert file["violations"].flag_masks.tolist() == [1, 2, 4, 8, 16, 32, 64]
        about = json.loads(file.provenance)
        assert (
            about["study"].startswith('name = "toy"')
            and about["walkers"][0]["l_t"]
            and about["cpu"]
        )
        assert not any(word in file.provenance for word in ("/tmp", "/home", "jobs"))


def test_the_checksum_of_a_chunk_is_that_of_its_corner_and_its_values_checksum():
    values = zlib.crc32(b"values")
    assert layout.chunk_checksum(values, (3, 64)) == zlib.crc32(
        b"3,64" + values.to_bytes(4, "little")
    )


def git(folder, *arguments):
    """What git answers in a folder, whoever asks."""
    identity = ["-c", "user.name=x", "-c", "user.email=x@x"]
    command = ["git", *identity, *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_commit_is_that_of_the_working_tree(tmp_path, monkeypatch):
    assert bool(commit()) == (ROOT / ".git").exists()
    git(tmp_path, "init", "--quiet")
    (tmp_path / "package").mkdir()
    assert commit(tmp_path) == ""  # nothing is committed
    commit.cache_clear()

    git(tmp_path, "commit", "--quiet", "--allow-empty", "-m", "one")
    first = git(tmp_path, "rev-parse", "HEAD")
    git(tmp_path, "worktree", "add", "--quiet", "--detach", "linked")
    git(tmp_path, "commit", "--quiet", "--allow-empty", "-m", "two")
    monkeypatch.setenv("GIT_DIR", str(ROOT / ".git"))  # as a hook has it

    assert len(first) == 40 and commit(tmp_path / "linked") == first
    assert commit(tmp_path) not in ("", first, commit())
    assert commit(tmp_path / "package") == ""  # it lies in a tree that is not its own
    commit.cache_clear()

    monkeypatch.setenv("PATH", "")
    assert commit(tmp_path) == ""
    commit.cache_clear()


@pytest.mark.parametrize(
    ("said", "code"), [("not a git repository", 128), ("Out of memory", 128), ("", 127)]
)
def test_an_archive_does_not_lack_its_commit_for_want_of_memory(
    tmp_path, monkeypatch, said, code
):
    (tmp_path / ".git").mkdir()
    program = tmp_path / "git"
    program.write_text(f"#!/bin/sh\necho 'fatal: {said}' >&2\nexit {code}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))

    commit.cache_clear()
    if said == "not a git repository":
        assert commit(tmp_path) == ""
    else:
        with pytest.raises(OSError, match="memory"):
            commit(tmp_path)
    commit.cache_clear()


def test_an_archive_of_lines_says_how_each_ended(tmp_path):
    toy = Toy(tmp_path)
    toy.write(
        'name = "toy"\nkind = "orbit"\nwalker = ["E", "F"]\n[axes]\nslope = [0.1, 0.2]\nw_t = [0.0, 0.1, 13.0]\n'
    )
    said = toy("run", "toy.toml", expect=1).stderr
    reason = "The atlas of the line: it raised ValueError: no atlas here."
    assert (
        f"2 x {reason} First: E w_t=13.0\n" in said
        and "converged 4" in said
        and "raised 2" in said
    )
    with netCDF4.Dataset(tmp_path / "data" / "archive" / "toy.nc") as file:
        assert (
            file["status"].dimensions == file["reason"].dimensions == ("walker", "w_t")
        )
        assert file["status"][:].tolist() == [[0, 0, STATUS["raised"]]] * 2
        sentences = file["reason_text"][:][file["reason"][:].data]
        assert (sentences[:, 2] == reason).all() and all(
            "followed" in each for each in sentences[:, :2].ravel()
        )
        assert file["orbits/w_t"][:].tolist() == [0, 0, 0.1, 0.1] * 2


@pytest.mark.parametrize("walkers", [["E", "F"], ["F", "E"]])
def test_a_column_that_other_lines_lack_is_missing_there(tmp_path, walkers):
    toy = Toy(tmp_path)
    toy.write(
        f'name = "toy"\nkind = "orbit"\nwalker = {walkers}\n[axes]\nslope = [0.1]\n'
    )
    toy("run", "toy.toml")
    with netCDF4.Dataset(tmp_path / "data" / "archive" / "toy.nc") as file:
        table = {
            name: np.ma.filled(file[f"orbits/{name}"][:], np.nan)
            for name in ("swing_rate", "period")
        }
        words = dict(zip(walkers, file["orbits/gait"][:].tolist(), strict=True))
    np.testing.assert_array_equal(
        table["swing_rate"], [{"E": np.nan, "F": -0.1}[name] for name in walkers]
    )
    assert words == {"E": "", "F": "long"} and table["period"].tolist() == [0.2, 0.2]
    toy("verify", "data/archive/toy.nc")


@pytest.mark.parametrize(
    ("failure", "full", "error"),
    [
        (OSError(errno.ENOSPC, "full"), True, DiskFullError),
        (RuntimeError("NetCDF: HDF error"), True, DiskFullError),
        (RuntimeError("NetCDF: HDF error"), False, ArchiveError),
    ],
)
def test_a_failed_write_is_a_full_disk_where_nothing_more_can_be_written(
    copy, monkeypatch, failure, full, error
):
    """The netCDF library does not say why it cannot write."""

    def fail(plan, draft):
        draft.write_bytes(b"begun")
        raise failure

    before = copy.read_bytes()
    monkeypatch.setattr(write, "_write", fail)
    monkeypatch.setattr(
        write,
        "shortage",
        lambda error, folder: OSError(errno.ENOSPC, "full") if full else None,
    )
    with pytest.raises((ArchiveError, DiskFullError)) as raised:
        write.write(None, copy)
    assert raised.type is error
    assert copy.read_bytes() == before and list(copy.parent.iterdir()) == [copy]


def test_an_archive_that_does_not_read_back_is_not_kept(tmp_path, monkeypatch):
    """HDF5 may leave out an attribute where memory is short, and report nothing."""
    (tmp_path / "s.toml").write_text(
        'name = "s"\nwalker = "D"\n[axes]\nslope = [0.01]\n[want]\nfits = ["scaling"]\n'
    )
    path, fill, lost = tmp_path / "s.nc", PointWriter.fill, []
    assert (
        commands.main(
            [
                "run",
                f"{tmp_path}/s.toml",
                "--archive",
                str(path),
                "--jobs",
                "1",
                "--quiet",
            ]
        )
        == 0
    )
    before = path.read_bytes()

    def lose(writer, draft):
        fill(writer, draft)
        with netCDF4.Dataset(draft, "a") as file:
            place, name = lost[-1]
            (file[place] if place else file).delncattr(name)

    study = parse.read(tmp_path / "s.toml")
    stored = Companions(path).journal
    with contextlib.closing(Journal(stored, write=False)) as journal:
        for attribute in (
            ("", "title"),
            ("status", "units"),
            ("fits/scaling/exponent", "long_name"),
        ):
            lost.append(attribute)
            monkeypatch.setattr(PointWriter, "fill", lose)
            with pytest.raises(
                ArchiveError, match=r"s\.nc cannot be written: it does not read back\.$"
            ):
                write.write(Plan(study, journal), path)
            assert path.read_bytes() == before
        monkeypatch.setattr(PointWriter, "fill", fill)
        write.write(Plan(study, journal), path)
    assert path.read_bytes() == before


def never_packed(folder, name):
    """A finished run, and the row of its only point with a piece of a variable that
    cannot be unpacked.
    """
    (folder / "s.toml").write_text('name = "s"\nwalker = "D"\n[axes]\nslope = [0.01]\n')
    command = ["run", f"{folder}/s.toml", "--archive", f"{folder}/s.nc", "--jobs", "1"]
    assert commands.main([*command, "--quiet"]) == 0
    with contextlib.closing(Journal(Companions(folder / "s.nc").journal)) as journal:
        graph = Graph(parse.read(folder / "s.toml"))
        key = graph.chunk_node(graph.grid.chunk(0)).key
        head, payload = journal.get(key)
        piece = ChunkCodec.summary(head).piece(memoryview(payload), name, 0).data
        damaged = payload.replace(piece, b"\xff" * len(piece))
        journal.put(key, Record(head, damaged))
    return command


@pytest.mark.parametrize("name", ["status", "reason"])
def test_a_status_that_was_never_packed_is_damage(tmp_path, capsys, name):
    """Whatever its checksum: what no repair mends, the run leaves as it is, and names
    the way on.
    """
    command, archive = never_packed(tmp_path, name), tmp_path / "s.nc"
    before = archive.read_bytes()
    with (
        contextlib.closing(Journal(Companions(archive).journal)) as journal,
        pytest.raises(CorruptStoreError),
    ):
        write.write(Plan(parse.read(tmp_path / "s.toml"), journal), archive)
    capsys.readouterr()
    assert commands.main(command) == 2 and archive.read_bytes() == before
    said = capsys.readouterr().err.splitlines()
    assert (
        said[-1]
        == f"gaitsweep: {Companions(archive).journal} cannot be repaired; run again with --fresh."
    )
    assert (
        commands.main([*command, "--fresh", "--quiet"]) == 0
        and archive.read_bytes() == before
    )


def test_an_angle_that_was_never_packed_is_found_by_verify(tmp_path):
    """It is copied unopened."""
    command = never_packed(tmp_path, "stance_angle")
    assert commands.main([*command, "--quiet"]) == 0
    with pytest.raises(ArchiveError, match=r"s\.nc is damaged: "):
        verify.verify(tmp_path / "s.nc")


def test_attributes_that_the_library_loses_at_once_are_missed():
    kept = {"units": "1"}
    attributes.put(
        SimpleNamespace(
            setncatts=lambda values: None, ncattrs=lambda: [*kept, "long_name"]
        ),
        kept,
    )
    with pytest.raises(RuntimeError, match="attributes are lost"):
        attributes.put(
            SimpleNamespace(
                setncatts=lambda values: None, ncattrs=lambda: ["long_name"]
            ),
            kept,
        )
    failing = Mock(
        setncatts=Mock(
            side_effect=AttributeError("NetCDF: Memory allocation (malloc) failure")
        )
    )
    with pytest.raises(RuntimeError, match="Memory allocation"):
        attributes.put(failing, kept)


def test_each_line_may_have_its_own_reason(monkeypatch):
    """Forty thousand of them, as of a study of another kind than a grid; the later ones
    come first.
    """
    n = 40_000
    ends = [("converged", f"Reason {n - i:05}.") for i in range(n)]
    monkeypatch.setattr(write._LineWriter, "_outcome", lambda _, number: ends[number])
    study = SimpleNamespace(lines=n, batches=n, batch=lambda i: np.array([i]))
    graph = SimpleNamespace(
        grid=SimpleNamespace(sizes={"w_t": n}), line_keys=lambda i: i
    )
    writer = write._LineWriter(SimpleNamespace(study=study, graph=graph))
    assert writer.reason.dtype == np.int32
    assert [writer.sentences.texts[i] for i in writer.reason] == [
        reason for _, reason in ends
    ]


def test_verify_finds_nothing_wrong_with_a_whole_one(made):
    assert verify.verify(made) == []


def test_a_variable_is_checked_box_by_box(copy, monkeypatch):
    """The sum over its boxes passes 2^32; small boxes stand in for a variable of more
    than 65536 points.
    """
    monkeypatch.setattr(read, "_MAX_POINTS", 32)
    with netCDF4.Dataset(copy, "a") as file:
        file.checksum_chunk = [16, 1]
        some = list(boxes({"slope": 200, "w_t": 2}, (16, 1), 32))
        sums = []
        for i, j, k in np.ndindex(13, 2, 2):
            part = np.ma.getdata(file["stance_angle"][16 * i : 16 * i + 16, j, k])
            sums.append(
                layout.chunk_checksum(zlib.crc32(part.tobytes()), (16 * i, j, k))
            )
        assert len(some) > 10 and sum(sums) > 1 << 33
        checksums = {
            name: read._checksum(file[name]) for name in json.loads(file.checksums)
        }
        assert checksums["stance_angle"] == sum(sums) % (1 << 32)
        file.checksums = json.dumps(checksums)
    assert verify.verify(copy) == []


class _Noted:
    """A variable that notes how many values are read of it at a time."""

    def __init__(self, variable, sizes):
        self.variable, self.sizes = variable, sizes

    def __getattr__(self, name):
        return getattr(self.variable, name)

    def __getitem__(self, box):
        values = self.variable[box]
        self.sizes.append(values.size)
        return values


def test_states_are_checked_box_by_box(copy, monkeypatch):
    monkeypatch.setattr(structure, "MOST_POINTS", 16)
    sizes = []
    with netCDF4.Dataset(copy, "a") as file:
        (
            file["status"][:2, -1, -1],
            file["status"][-1, -1, -1],
            file["reason"][-1, -1, -1],
        ) = 7, 99, -1
        variables = {name: _Noted(file[name], sizes) for name in ("status", "reason")}
        found = list(
            structure._states(
                SimpleNamespace(variables=variables, dimensions=file.dimensions)
            )
        )
    assert max(sizes) <= 32 and sum(sizes) == 1600
    assert found == [
        "`status` holds values without a meaning.",
        "`reason` points outside its table.",
        "It is not complete: 2 values of `status` are not_attempted.",
    ]


def test_its_provenance_is_found_without_the_library(made):
    with netCDF4.Dataset(made) as file:
        written = json.loads(file.provenance)
    assert stored(made) == {**written, "table": tomllib.loads(written["study"])}


def _edit(path, change):
    with netCDF4.Dataset(path, "a") as file:
        change(file)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda f: f["status"].__setitem__((0, 0, 0), 7),
            "It is not complete: 1 values of `status` are not_attempted.",
        ),
        (
            lambda f: f["status"].__setitem__((0, 0, 0), 99),
            "`status` holds values without a meaning.",
        ),
        (
            lambda f: f["reason"].__setitem__((0, 0, 0), 9),
            "`reason` points outside its table.",
        ),
        (
            lambda f: f["stance_angle"].__setitem__((199, 0, 1), 1.0),
            "`stance_angle` has 1 values where nothing converged.",
        ),
        (
            lambda f: f["stance_angle"].__setitem__((0, 0, 0), 1.0),
            "`stance_angle` is not as it was written.",
        ),
        (lambda f: f.renameVariable("residual", "x"), "`residual` is missing."),
        (lambda f: f.renameVariable("period", "x"), "`period` is missing."),
        (lambda f: f.renameGroup("fits", "x"), "`fits/scaling/exponent` is missing."),
        (
            lambda f: f["fits/scaling/exponent"].__setitem__(0, 1.0),
            "`fits/scaling/exponent` is not as it was written.",
        ),
        (lambda f: f.createVariable("x", "f8", ()), "`x` is not as it was written."),
        (
            lambda f: f["fits/scaling"].createVariable("x", "f8", ()),
            "`fits/scaling/x` is not as it was written.",
        ),
        (lambda f: f["residual"].delncattr("units"), "`residual` has no units."),
        (lambda f: f.setncattr("provenance", "{"), "`provenance` is not JSON."),
        (lambda f: f.setncattr("provenance", "[1]"), "`provenance` is not JSON."),
        (lambda f: f.delncattr("checksums"), "The attribute `checksums` is missing."),
        (
            lambda f: f["residual"].delncattr("long_name"),
            "`residual` has no long_name.",
        ),
        (
            lambda f: f["fits/scaling/exponent"].delncattr("units"),
            "`fits/scaling/exponent` has no units.",
        ),
        (lambda f: f["gait"].__setitem__(0, "brisk"), "`gait` holds unknown names."),
        (
            lambda f: f["reason"].__setitem__((0, 0, 0), -1),
            "`reason` points outside its table.",
        ),
        (
            lambda f: f.renameVariable("w_t", "x"),
            "The dimension `w_t` has no coordinate.",
        ),
        (
            lambda f: f.createVariable("x", "f8", ("w_t", "slope")),
            "`x` has its dimensions in another order.",
        ),
    ],
)
def test_verify_sees(copy, change, said):
    _edit(copy, change)
    assert said in verify.verify(copy)


def test_what_an_archive_always_holds_depends_on_its_kind_and_accuracy():
    assert set(structure._required(SimpleNamespace())) == set(ALWAYS)
    assert set(structure._required(SimpleNamespace(accuracy=1e-4))) == set(
        ALWAYS
    ) - set(OF_INTEGRATION)
    assert structure._required(SimpleNamespace(kind="orbit")) == ("status", "reason")


def _flip(made, copy, at, seen, files):
    """Archives with one bit flipped, number `at` and on, each found out or without
    another number.
    """
    original = made.read_bytes()
    while at.value < files:
        dice, data = random.Random(at.value), bytearray(original)
        data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
        copy.write_bytes(data)
        try:
            found = verify.verify(copy) != []
            assert found or diff.diff(made, copy) == []
        except ArchiveError:
            found = True
        seen.value += found
        at.value += 1


@pytest.mark.parametrize("flips", [20, pytest.param(60, marks=pytest.mark.thorough)])
def test_no_flipped_byte_changes_a_number_unseen(made, copy, flips):
    """In processes of their own: some flips crash the netCDF library, which is seen
    too.
    """
    fork = multiprocessing.get_context("fork")
    at, seen = fork.Value("q", 0), fork.Value("q", 0)
    while at.value < flips:
        child = fork.Process(target=_flip, args=(made, copy, at, seen, flips))
        child.start()
        child.join()
        assert child.exitcode <= 0, f"flip {at.value} changes a number unseen"
        at.value += child.exitcode < 0
        seen.value += child.exitcode < 0
    assert seen.value > flips / 6


@pytest.mark.parametrize(
    "text", [b"", b"CDF\x01", b"\x89HDF\r\n\x1a\n", b"not an archive at all"]
)
def test_what_is_no_archive_is_refused(tmp_path, text):
    (tmp_path / "x.nc").write_bytes(text)
    with pytest.raises(ArchiveError, match="no netCDF file"):
        verify.verify(tmp_path / "x.nc")


def test_another_netcdf_file_is_foreign(tmp_path):
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "x.nc", engine="netcdf4")
    with pytest.raises(ArchiveError, match="not an archive of gaitsweep"):
        verify.verify(tmp_path / "x.nc")


def test_equal_archives_do_not_differ(made, copy):
    assert diff.diff(made, copy) == []
    _edit(copy, lambda file: file["stance_angle"].setncattr("units", "degree"))
    assert diff.diff(made, copy) == ["`stance_angle` is in rad and in degree"]


def test_reasons_are_compared_as_sentences_whatever_their_numbers(made, copy):
    def renumber(file):
        texts = file["reason_text"][:]
        file["reason_text"][:] = texts[::-1]
        file["reason"][:] = len(texts) - 1 - file["reason"][:]

    _edit(copy, renumber)
    assert diff.diff(made, copy) == []

    _edit(copy, lambda file: file["reason"].__setitem__((slice(2), 0, 0), 0))
    assert diff.diff(made, copy) == ["`reason`: 2 of 800 differ"]


def test_walkers_that_differ_differ(made, copy):
    """A parameter that all walkers share is an attribute."""
    with netCDF4.Dataset(copy, "a") as file:
        file.g *= 1 + 1e-9
        file.accuracy = 1e-6
    assert diff.diff(made, copy, rtol=1e-8) == []
    assert diff.diff(made, copy) == ["`g`: 1 of 1 differ, by up to 1e-09 of their size"]


def test_diff_tells_variables_and_statuses_apart(made, copy):
    def change(file):
        file["stance_angle"][3, 1, 0] *= 1 + 1e-9
        file["multiplier_imag"][2, 0, 0, 1] += (
            1e-9 * file["multiplier_real"][2, 0, 0, 1]
        )
        file["residual"][0] += 1e-10
        file["status"][5:8, 0, 0] = 4

    _edit(copy, change)
    found = diff.diff(made, copy)
    assert found[-1] == "`status`: 3 were converged and are worker_died"
    assert [f.split(":")[0] for f in found] == [
        "`multiplier_imag`",
        "`residual`",
        "`stance_angle`",
        "`status`",
    ]
    assert "1 of 800 differ, by up to 1e-09 of their size" in found[2]
    # Measures of rounding are compared with one: their values may be small and their
    # relative differences mean nothing.
    assert found[1].endswith("differ, by up to 1e-10")
    assert diff.diff(made, copy, rtol=1e-8) == [
        "`status`: 3 were converged and are worker_died"
    ]


def test_a_variable_may_have_a_tolerance_of_its_own(made, copy, capsys):
    def change(file):
        file["stance_angle"][3, 1, 0] *= 1 + 1e-9
        file["spectral_radius"][3, 1, 0] *= 1 + 1e-6
        file["fits/scaling/exponent"][1] *= 1 + 1e-6
        file["residual"][3, 1, 0] += 1e-9
        file["error_bound"][3, 1, 0] = 0.5

    _edit(copy, change)

    def differing(*tolerances):
        code = commands.main(
            ["diff", str(made), str(copy), *(f"--rtol={t}" for t in tolerances)]
        )
        out, err = capsys.readouterr()
        return (
            code,
            [line.split("`")[1] for line in out.splitlines() if "`" in line],
            err,
        )

    # A bound or a residual is itself relative: what it may differ by is not a part of
    # its own size.
    assert differing("1e-8")[:2] == (
        1,
        ["error_bound", "spectral_radius", "fits/scaling/exponent"],
    )
    wide = "error_bound=0.999999999"
    assert differing("1e-8", wide, "spectral_radius=1e-5")[:2] == (
        1,
        ["fits/scaling/exponent"],
    )
    assert differing(
        "1e-8", wide, "spectral_radius=1e-5", "fits/scaling/exponent=1e-5"
    )[:2] == (0, [])
    assert differing("1e-8", wide, "residual=1e-12")[1][0] == "residual"
    code, _, err = differing("spectral=1e-5")
    assert code == 2 and err.count("\n") == 1 and "holds `spectral`." in err
    assert differing("2")[0] == 2


def test_whole_numbers_and_names_differ_whatever_the_tolerance(made, copy):
    _edit(copy, lambda file: file["branch"].__setitem__((slice(3), 1, 0), 7))
    other = copy.with_name("other.nc")
    shutil.copy(copy, other)
    for path, values in ((copy, ["", ""]), (other, ["", "speed"])):
        _edit(
            path,
            lambda file, values=values: write_strings(
                file["fits/scaling"], "quantity", "row", values, {}
            ),
        )
    assert "`branch`: 3 of 800 differ" in diff.diff(made, copy, rtol=0.5)
    assert diff.diff(copy, other, rtol=0.5) == [
        "`fits/scaling/quantity`: 1 of 2 differ"
    ]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ([np.nan, 2.0], "1 of 2 differ, 1 absent in one"),
        ([np.nan, 3.0], "2 of 2 differ, by up to 0.33 of their size, 1 absent in one"),
    ],
)
def test_values_that_one_archive_does_not_have_are_told(values, said):
    found = diff.Tolerance(0.0, {}).compare(
        "period", np.array(values), np.array([1.0, 2.0])
    )
    assert found == [f"`period`: {said}"]


def test_keys_of_a_leg_of_one_link_have_their_units_in_tables():
    for name, kind in {
        "l": "length",
        "m": "mass",
        "r": "length",
        "R": "length",
    }.items():
        assert result_tables.meaning_of(name, "branches") == (kind, f"walker's {name}")


def test_multipliers_differ_by_the_larger_of_their_magnitudes_whichever_archive_is_first(
    made, copy
):
    def widen(file):
        for part in ("multiplier_real", "multiplier_imag"):
            file[part][:] *= 1.105

    _edit(copy, widen)
    assert not [
        said
        for pair in ((made, copy), (copy, made))
        for said in diff.diff(*pair, rtol=0.07)
        if "multi" in said
    ]
    assert (
        len([said for said in diff.diff(made, copy, rtol=0.066) if "multi" in said])
        == 2
    )


def test_values_of_which_there_are_none_do_not_differ():
    assert not diff.Tolerance(0.0, {}).compare("period", np.zeros(0), np.zeros(0))


def test_measures_of_rounding_are_compared_with_one(copy, tmp_path):
    """One residual may be a million times another: both are rounding."""
    other = tmp_path / "other.nc"
    shutil.copy(copy, other)
    for path, residual in ((copy, 1e-16), (other, 3e-10)):
        _edit(
            path,
            lambda file, residual=residual: file["residual"].__setitem__(
                (3, 1, 0), residual
            ),
        )
    assert diff.diff(copy, other, rtol=1e-9) == []
    assert len(diff.diff(copy, other, rtol=1e-10)) == 1


def test_tables_are_compared_on_the_lines_both_archives_have(tmp_path):
    toy = Toy(tmp_path)
    for name, values in (("a", "[0.0, 0.25]"), ("b", "[0.0, 0.1, 0.25]")):
        toy.write(
            f'name = "{name}"\nkind = "orbit"\nwalker = "E"\n[axes]\nslope = [0.01, 0.02]\nw_t = {values}\n'
        )
        toy("run", "toy.toml")
    a, b = (tmp_path / "data" / "archive" / f"{name}.nc" for name in "ab")
    assert diff.diff(a, b) == [f"1 of 3 values of `w_t` are only in {b}"]
    _edit(b, lambda file: file["orbits/period"].__setitem__(5, 9.0))
    assert diff.diff(a, b)[1:] == [
        "`orbits/period`: 1 of 4 differ, by up to 1 of their size"
    ]


def test_tables_are_compared_line_by_line_whatever_the_order_of_lines(tmp_path):
    toy = Toy(tmp_path)
    for name, walkers, axes in (
        ("a", '["E", "F"]', "w_t = [0.0, 0.25]\nw_s = [0.3, 0.4]"),
        ("b", '["F", "E"]', "w_s = [0.4, 0.3]\nw_t = [0.25, 0.0]"),
    ):
        toy.write(
            f'name = "{name}"\nkind = "orbit"\nwalker = {walkers}\n[axes]\nslope = [0.01, 0.02]\n{axes}\n'
        )
        toy("run", "toy.toml")
    a, b = (tmp_path / "data" / "archive" / f"{name}.nc" for name in "ab")
    assert diff.diff(a, b) == []
    _edit(b, lambda file: file["orbits/period"].__setitem__(5, 9.0))
    assert diff.diff(a, b) == [
        "`orbits/period`: 1 of 16 differ, by up to 1 of their size"
    ]


def test_a_walker_is_not_taken_for_one_whose_name_begins_its_own(tmp_path):
    toy = Toy(tmp_path)
    for name, walkers in (("a", '["A", "C"]'), ("b", '["A", "A-printed"]')):
        toy.write(
            f'name = "{name}"\nkind = "orbit"\nwalker = {walkers}\n[axes]\nslope = [0.01]\n'
        )
        toy("run", "toy.toml")
    a, b = (tmp_path / "data" / "archive" / f"{name}.nc" for name in "ab")
    found = diff.diff(a, b)
    assert {f"1 of 2 values of `walker` are only in {path}" for path in (a, b)} <= set(
        found
    )
    assert not [f for f in found if "orbits" in f]


def test_axes_may_have_another_order(tmp_path):
    toy = Toy(tmp_path)
    for name, axes in (
        ("a", ("w_t = [0.0, 0.1, 0.2]", "w_s = [0.3, 0.4]")),
        ("b", ("w_s = [0.3, 0.4]", "w_t = [0.0, 0.1, 0.2]")),
    ):
        toy.write(
            "\n".join(
                [f'name = "{name}"\nwalker = "E"\n[axes]\nslope = [0.1, 0.2]', *axes]
            )
        )
        toy("run", "toy.toml")
    a, b = (tmp_path / "data" / "archive" / f"{name}.nc" for name in "ab")
    with xr.open_dataset(a) as one, xr.open_dataset(b) as other:
        assert one.stance_angle.dims != other.stance_angle.dims
    assert diff.diff(a, b) == []
    _edit(b, lambda file: file["period"].__setitem__((0, 0, 1, 0), 9.0))
    (found,) = diff.diff(a, b)
    assert found.startswith("`period`: 1 of 24 differ")


def test_a_dimension_that_one_archive_has_is_told(made, tmp_path):
    toy = Toy(tmp_path)
    toy.write(EVERYTHING.replace("w_t = [0.0, 0.25]", "w_s = [0.0]"))
    toy("run", "toy.toml")
    found = diff.diff(made, other := tmp_path / "data" / "archive" / "toy.nc")
    assert {
        f"the dimension `w_t` is only in {made}",
        f"the dimension `w_s` is only in {other}",
    } <= set(found)


def test_diff_aligns_by_coordinates(made, tmp_path):
    toy = Toy(tmp_path)
    toy.write(EVERYTHING.replace("[0.0, 0.25]", "[0.5, 0.25]"))
    toy("run", "toy.toml")
    other = tmp_path / "data" / "archive" / "toy.nc"
    found = diff.diff(made, other)
    assert {
        f"1 of 2 values of `w_t` are only in {path}" for path in (made, other)
    } <= set(found)
    assert not [
        f for f in found if (f.startswith("`") and "status" in f) or "stance" in f
    ]


def test_what_cannot_be_loaded_is_called_damaged(copy):
    """The chunks of a variable that the library refuses raise an error of its own."""
    data = bytearray(copy.read_bytes())
    with netCDF4.Dataset(copy) as file:
        lost = (
            np.ascontiguousarray(file["stance_angle"][:20, 0, 0].data)
            .view(np.uint8)
            .reshape(-1, 8)[:, 1]
            .tobytes()
        )
    data[data.index(lost)] ^= 1  # bytes of the mantissa that do not compress are stored
    copy.write_bytes(data)
    with pytest.raises(ArchiveError, match=r"copy.nc is damaged: .*HDF error\.$"):
        load(copy)
    assert len(load(copy, "fits/scaling")) == 2


def test_text_of_an_unknown_encoding_is_damage(copy, tmp_path):
    _edit(copy, lambda file: file["reason_text"].setncattr("_Encoding", "{}"))
    for reader in (load, lambda path: pages.write([path], tmp_path / "reports")):
        with pytest.raises(
            ArchiveError,
            match=r"copy\.nc is damaged: `reason_text` is not as it was written\.$",
        ):
            reader(copy)


def test_a_bug_is_not_called_damage(made, copy, monkeypatch, capsys):
    def slip(*_):
        return {}["x"]

    monkeypatch.setattr("gaitsweep.pipeline.archive.diff._matching_rows", slip)
    assert commands.main(["diff", str(made), str(made)]) == 2
    said = capsys.readouterr().err
    assert (
        said.startswith("gaitsweep: Internal error, KeyError") and "damaged" not in said
    )
    # In a file that is not as it was written anything may follow from that.
    _edit(copy, lambda file: file["stance_angle"].__setitem__((0, 0, 0), 1.0))
    assert commands.main(["diff", str(copy), str(made)]) == 2
    assert (
        capsys.readouterr().err
        == f"gaitsweep: {copy} is damaged: `stance_angle` is not as it was written.\n"
    )


def test_a_fault_of_who_reads_is_not_called_damage(made):
    """Where a table with text was read, its variables gave characters from then on, and
    other checksums.
    """
    with pytest.raises(ZeroDivisionError), read.open_archive(made) as file:
        assert dataset(file["fits/scaling"]).load().walker.dtype.kind in "OU"
        raise ZeroDivisionError
    for error in (OSError(errno.ENOSPC, "No room"), MemoryError()):
        with pytest.raises(type(error)), read.open_archive(made):
            raise error


def _changed(**changes):
    """Change parts of the provenance."""
    return lambda f: f.setncattr(
        "provenance", json.dumps({**json.loads(f.provenance), **changes})
    )


def _without_place(file):
    """A table with a column of the axis `w_t`, which says nothing."""
    column = file["fits/scaling"].createVariable("w_t", "f8", ("row",))
    column.setncatts({"units": "1", "long_name": "w_t"})
    column[:] = np.nan


def _put(name, value):
    return lambda f: f[name].__setitem__((0,) * f[name].ndim, value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_put("slope", np.nan), "`slope` holds values that are not finite."),
        (_put("slope", np.inf), "`slope` holds values that are not finite."),
        (_put("slope", 0.5), "`slope` must lie in [1e-18, 0.5) rad, or in (-0.5, 0]."),
        (
            _put("slope", 9e-19),
            "`slope` must lie in [1e-18, 0.5) rad, or in (-0.5, 0].",
        ),
        *(
            (
                lambda f, name=name: f[name].__setitem__(0, f[name][1]),
                f"`{name}` holds a value twice.",
            )
            for name in ("slope", "multiplier", "gait")
        ),
        (_put("w_t", -np.inf), "`w_t` holds values that are not finite."),
        (_without_place, "`fits/scaling/w_t` holds values that are not finite."),
        (lambda f: f.setncattr("R", np.nan), "The attribute R is not a finite number."),
        (lambda f: f.setncattr("R", "0"), "The attribute R is not a finite number."),
        (lambda f: f.setncattr("kind", "walk"), "`kind` is no kind of study."),
        (
            lambda f: f.setncattr("accuracy", "x"),
            "The attribute `accuracy` is no number that it may be.",
        ),
        (
            lambda f: f.setncattr("steps", "x"),
            "The attribute `steps` is no number that it may be.",
        ),
        (
            lambda f: f["violations"].setncattr("flag_masks", "x y"),
            "The flags of `violations` have other meanings.",
        ),
        (
            lambda f: f["violations"].setncattr("flag_meanings", 3),
            "Its types are not those of an archive (AttributeError).",
        ),
        (_put("stance_angle", np.nan), "`stance_angle` has 1 values that no gait has."),
        (_put("period", np.inf), "`period` has 1 values that no gait has."),
        (_changed(walkers=None), "`walkers` in `provenance` is no list."),
        (_changed(walkers=[]), "`provenance` holds no walker."),
        (_changed(walkers=[3]), "Its origins are not those of an archive (TypeError)."),
        (
            _changed(walkers=[{"R": np.nan}]),
            "`provenance` holds a walker whose R is not a finite number.",
        ),
        (
            _changed(walkers=[{"R": None}]),
            "`provenance` holds a walker whose R is not a finite number.",
        ),
        (_changed(study=3), "`study` in `provenance` is no text."),
        (
            _changed(study="x = ["),
            "Its origins are not those of an archive (TOMLDecodeError).",
        ),
        (_changed(varied=[]), "`varied` in `provenance` is no table."),
    ],
)
def test_impossible_contents_are_invalid_however_right_their_checksums(
    made, copy, tmp_path, change, said
):
    with netCDF4.Dataset(copy, "a") as file:
        change(file)
        file.set_auto_mask(False)
        names = [name for name, _ in layout.variables(file)]
        file.checksums = json.dumps(
            {name: read._checksum(file[name]) for name in names}, sort_keys=True
        )
    assert said in verify.verify(copy)
    for reader in (
        load,
        lambda path: pages.write([path], tmp_path / "reports"),
        lambda path: diff.diff(made, path),
    ):
        try:
            reader(copy)
        except ArchiveError as error:
            assert str(error).startswith(f"{copy} is damaged: ")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("accuracy", ["1e-6", np.nan, -1e-6, np.array([1e-6, 1e-7]), 3]),
        ("steps", [np.int32(0), 2.0, np.arange(3), np.int64(2**62)]),
        ("not_attempted", ["x", np.int64(-1), np.nan]),
    ],
)
def test_a_number_among_the_attributes_is_one(copy, name, values):
    for value in values:
        _edit(copy, lambda file, value=value: file.setncattr(name, value))

        assert f"The attribute `{name}` is no number that it may be." in verify.verify(
            copy
        )


@pytest.mark.parametrize("value", ["x", np.nan, np.arange(2), np.array([], "i8")])
def test_chunks_of_checksums_that_are_no_numbers_are_damage(copy, value):
    _edit(copy, lambda file: file.setncattr("checksum_chunk", value))

    for reader in (verify.verify, lambda path: diff.diff(path, path)):
        with contextlib.suppress(ArchiveError):
            reader(copy)
    assert read.damage(copy)


class _Counted:
    """A variable that counts how often each of its values is read, whole chunks of at
    most a hundred at a time.
    """

    def __init__(self, shape, chunk="contiguous"):
        self.shape, self.times, self.chunk = shape, np.zeros(shape, int), chunk
        self.ndim, self.chunking = self.times.ndim, lambda: chunk

    def __getitem__(self, index):
        assert self.times[index].size <= 100
        if self.chunk != "contiguous":
            ends = zip(index, self.chunk, self.shape, strict=True)
            assert all(
                s.start % c == 0 and (s.stop % c == 0 or s.stop == n)
                for s, c, n in ends
            )
        self.times[index] += 1


def test_an_archive_that_crashes_the_library_is_not_opened_here(copy, monkeypatch):
    """Another process has tried it."""
    monkeypatch.setattr(read.subprocess, "Popen", lambda *_, **__: ended(-11))
    monkeypatch.setattr(netCDF4, "Dataset", None)
    with pytest.raises(ArchiveError, match="the netCDF library crashes on it"):
        read.probe([copy])
    assert read.not_attempted(copy) is None


def test_an_archive_is_loaded_in_no_other_process(copy, monkeypatch):
    """That takes as long as ten loads; `verify` and `report` try files first that may
    crash the library.
    """
    monkeypatch.setattr(read.subprocess, "Popen", Mock(side_effect=AssertionError))
    assert load(copy).sizes["gait"]


@pytest.fixture
def reader(tmp_path):
    """A process that reads an archive, by a command of the shell."""

    def write(command):
        (tmp_path / "reader").write_text(f"#!/bin/sh\ntouch begun\n{command}\n")
        (tmp_path / "reader").chmod(0o755)
        return str(tmp_path / "reader")

    return write


def test_a_command_that_was_suspended_blames_no_archive(tmp_path, reader):
    """It and the process that reads the archive, which wakes last, stopped for longer
    than that may take.
    """
    program = (
        "import sys; from pathlib import Path; from gaitsweep.pipeline.archive import read\n"
        f"sys.executable, read._TIMEOUT = {reader('exec sleep 1')!r}, 3.0; read.probe([Path('any.nc')])"
    )
    (tmp_path / "any.nc").touch()
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": ROOT},
    )
    while not (tmp_path / "begun").exists() and process.poll() is None:
        time.sleep(0.02)
    suspend(process.pid, 3.3)
    assert process.wait(20) == 0


def test_an_archive_on_which_the_library_hangs_is_damaged(
    tmp_path, monkeypatch, reader
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        sys, "executable", reader("ulimit -S -t $4; while :; do :; done")
    )
    monkeypatch.setattr(read, "_TIMEOUT", 1.0)
    (tmp_path / "a.nc").touch()
    began, before = time.monotonic(), descendants(os.getpid())
    with pytest.raises(ArchiveError, match="the netCDF library hangs on it"):
        read.probe([tmp_path / "a.nc"])
    assert time.monotonic() - began < 10 and descendants(os.getpid()) == before


def test_an_archive_of_much_in_few_bytes_has_the_time_to_be_read(tmp_path, monkeypatch):
    """One of a billion points, 433 MB of zeros for the most part, was called damaged
    after two minutes.
    """
    allowed = []
    monkeypatch.setattr(
        read.subprocess,
        "Popen",
        lambda command, **_: allowed.append(int(command[4])) or ended(0),
    )
    (tmp_path / "a.nc").touch()
    os.truncate(tmp_path / "a.nc", 433_000_000)
    read.probe([tmp_path / "a.nc"])
    assert allowed[0] > 2000


def test_an_archive_is_probed_in_every_value_some_at_a_time(monkeypatch):
    """One value that crashes the library is enough, and a foreign file may be larger
    than the memory.
    """
    shapes = ((), (0,), (7,), (1000,), (31, 5), (10, 4, 30), (2, 101))
    inner, outer = ({str(shape): _Counted(shape) for shape in shapes} for _ in range(2))
    # As of a long line each: rows of a hundred lines were read, and every chunk as
    # often as a line has rows.
    outer["chunks"] = _Counted((90, 7, 2), [20, 1, 1])
    deep = SimpleNamespace(variables=inner, groups={})
    masked = Mock()
    file = SimpleNamespace(
        set_auto_mask=masked,
        variables=outer,
        groups={"fits": SimpleNamespace(variables={}, groups={"scaling": deep})},
    )
    # One that only raises an error does not hide those after it.
    file.variables = {"no numbers": SimpleNamespace(shape=None), **outer}
    monkeypatch.setattr(read, "open_archive", lambda path: contextlib.nullcontext(file))
    monkeypatch.setattr(read, "_MAX_VALUES", 100)
    read._read_whole(Path("file.nc"))
    assert all(
        (variable.times == 1).all() for variable in (*inner.values(), *outer.values())
    )
    masked.assert_called_once_with(False)


def _junk(path, original, dice):
    data = bytearray(original)
    for _ in range(dice.randint(1, 4)):
        at, n = dice.randrange(len(data)), dice.choice([1, 1, 2, 8, 64])
        data[at : at + n] = dice.randbytes(n)
    if dice.random() < 0.2:
        del data[dice.randrange(len(data)) :]
    path.write_bytes(data)


def _read_many(original, path, at, files):
    """Mangled archives number `at` and on, read and verified where a crash ends this
    process; `at` counts them.
    """
    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
    while at.value < files:
        signal.alarm(20)
        _junk(path, original, random.Random(at.value))
        with contextlib.suppress(ArchiveError):
            verify.verify(path)
        at.value += 1


@pytest.mark.parametrize("files", [300, pytest.param(100_000, marks=pytest.mark.soak)])
def test_mangled_archives_never_end_in_a_traceback(tmp_path, capsys, files):
    """Where the netCDF library crashes or never returns, the command says so in one
    line.
    """
    toy = Toy(tmp_path)
    toy.write(STUDY.replace("n = 200", "n = 9"))
    toy("run", "toy.toml")
    original = (tmp_path / "data" / "archive" / "toy.nc").read_bytes()
    fork, path = multiprocessing.get_context("fork"), tmp_path / "junk.nc"
    at, fatal = fork.Value("q", 0), Counter()
    while at.value < files:
        child = fork.Process(target=_read_many, args=(original, path, at, files))
        child.start()
        child.join()
        if not child.exitcode:
            continue
        assert child.exitcode < 0, f"archive {at.value} ends in a traceback"
        fatal[signal.Signals(-child.exitcode).name] += 1
        # Intact, where an earlier archive had broken the library's memory in the
        # process that ended here.
        code, said = commands.main(["verify", str(path)]), capsys.readouterr().out
        assert said.count("\n") == 1 and (
            code == 1 or (code == 0 and "is intact" in said)
        )
        at.value += 1
    print(f"{files} mangled archives; of these end their reader: {dict(fatal)}")
