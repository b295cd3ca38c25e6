"""What a run finds where it is to write: nothing of anybody else is read, waited for or
written over.
"""

import contextlib
import errno
import json
import os
import resource
import socket
import sqlite3
import stat
from pathlib import Path
from unittest.mock import Mock

import netCDF4
import numpy as np
import pytest

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.archive import provenance, read
from gaitsweep.pipeline.archive.written import write_strings
from gaitsweep.pipeline.cli import claims, commands, status
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine import runner
from gaitsweep.pipeline.engine.locks import lock_archive
from gaitsweep.pipeline.engine.progress import last_state
from gaitsweep.pipeline.errors import ArchiveError, DiskFullError, shortage
from gaitsweep.pipeline.report import folder, pages
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.study import parse
from gaitsweep.tasks.contract.registry import TASKS

STUDY = {"name": "s", "walker": "E", "axes": {"slope": [0.01, 0.02]}}


def study(**changes):
    table = {**STUDY, **changes}
    return parse.parse(table, f'kind = "{table.get("kind", "grid")}"', Path("s"))


def opened(path, wanted=None, **options):
    """What a run into an archive says before its first byte; empty if it goes on."""
    errors = []
    run = runner.StudyRun(
        wanted or study(), path, runner.Options(**options), errors.append
    )
    with run._guarded():
        run._open()
    run.close()
    return str(errors[0]) if errors else ""


def state(path):
    status = path.lstat()
    return status.st_ino, status.st_mode, status.st_size, status.st_mtime_ns


def precious(path):
    path.write_text("precious")


def link(path):
    path.symlink_to("precious")


def unix_socket(path):
    with (
        contextlib.chdir(path.parent),
        socket.socket(socket.AF_UNIX) as made,
    ):  # its path must be short
        made.bind(path.name)


KINDS = [
    (precious, ""),
    (link, " is a link,"),
    (os.mkfifo, " is a named pipe,"),
    (unix_socket, " is a socket,"),
    (os.mkdir, " is a directory,"),
]
COMPANIONS = ["s.lock", "s.events.jsonl", "s.run.json"]
JOURNALS = ["s.journal", "s.journal-wal", "s.journal-shm", "s.journal-journal"]


def companions(folder):
    """The companions of an archive in a folder, which may hold them."""
    found = Companions(folder / "s.nc")
    found.folder.mkdir()
    return found


@pytest.mark.parametrize(("make", "kind"), KINDS)
@pytest.mark.parametrize("name", [*COMPANIONS, *JOURNALS])
def test_what_stands_in_the_place_of_a_companion_is_named_and_left_alone(
    tmp_path, name, make, kind
):
    own = companions(tmp_path)
    precious(own.folder / "precious")
    make(path := own.folder / name)
    before = state(path)

    if name in COMPANIONS:
        said = opened(own.archive)
    else:
        with pytest.raises(ArchiveError) as raised:
            Journal(own.journal)
        said = str(raised.value)

    assert said.startswith(f"{path} is") and said.endswith("move it away.")
    assert kind in said
    assert state(path) == before
    assert {file.name for file in own.folder.iterdir()} == {"precious", name}
    assert (own.folder / "precious").read_text() == "precious"
    assert make is not precious or path.read_text() == "precious"


@pytest.mark.parametrize(("make", "kind"), KINDS[:-1])
def test_what_stands_in_the_place_of_their_folder_is_named_and_left_alone(
    tmp_path, make, kind
):
    (tmp_path / "precious").mkdir()
    make(path := tmp_path / ".gaitsweep")
    before = state(path)

    said = opened(tmp_path / "s.nc")

    assert said.startswith(f"{path}{kind or ' is a file,'}")
    assert said.endswith("not a folder of gaitsweep; move it away.")
    assert state(path) == before and not list((tmp_path / "precious").iterdir())


def test_the_folder_of_companions_says_what_it_is(tmp_path):
    assert opened(tmp_path / "s.nc") == ""
    assert {file.name for file in tmp_path.iterdir()} == {".gaitsweep"}

    text = (tmp_path / ".gaitsweep" / "README").read_text()
    assert len(text.splitlines()) == 2
    assert "gaitsweep" in text and "may be deleted when no run is in flight" in text

    (tmp_path / ".gaitsweep" / "README").write_text("mine")
    assert opened(tmp_path / "s.nc") == ""
    assert (tmp_path / ".gaitsweep" / "README").read_text() == "mine"


@pytest.mark.parametrize("content", ["", "\0\0\0"])
def test_what_a_power_failure_leaves_is_nobodys(tmp_path, content):
    own = companions(tmp_path)
    for name in COMPANIONS:
        (own.folder / name).write_text(content)
    assert opened(own.archive) == ""


def test_the_files_of_an_earlier_run_are_known_again(tmp_path):
    """As they are written here."""
    path = tmp_path / "s.nc"
    assert opened(path) == ""
    run = runner.StudyRun(study(), path, runner.Options(), Mock())
    run.is_open = True
    run.end(None)
    own = Companions(path)
    own.events.write_text('{"time": 1.5, "event": "begin", "study": "s"}\n')
    assert {file.name for file in own.folder.iterdir()} == {"README", *COMPANIONS}
    own.check()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (os.mkfifo, "{} is a named pipe, not an archive."),
        (unix_socket, "{} is a socket, not an archive."),
        (os.mkdir, "{} is a directory, not an archive."),
        (
            lambda path: path.symlink_to(path.name),
            "{} cannot be read: Too many levels of symbolic links.",
        ),
        (lambda path: path.symlink_to(os.devnull), "{} is a device, not an archive."),
    ],
)
def test_what_is_no_file_is_not_waited_for_as_an_archive(tmp_path, capsys, make, said):
    make(path := tmp_path / "s.nc")
    before = state(path)
    said = said.format(path)
    assert opened(path) == opened(path, fresh=True) == said and state(path) == before
    for command in ("verify", "report", "prove"):
        assert commands.main([command, str(path)]) == 2
        assert capsys.readouterr().err == f"gaitsweep: {said}\n"


def test_what_the_system_says_of_a_file_is_repeated(tmp_path, monkeypatch):
    """Who may not read an archive was told that it is no netCDF file, or that there was
    no run.
    """
    precious(path := tmp_path / "s.nc")
    precious(log := companions(tmp_path).events)

    def refused(file, *_, **__):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(file))

    monkeypatch.setattr("builtins.open", refused)
    for reader, file in ((read.size_of, path), (last_state, log)):
        with pytest.raises(
            ArchiveError, match=rf"^{file} cannot be read: Permission denied\.$"
        ):
            reader(file)


def test_a_state_is_read_of_files_only(tmp_path):
    own = companions(tmp_path)
    os.mkfifo(own.events)
    assert status.state_of(own.archive) is None
    own.events.unlink()
    own.events.write_text('{"event": "state"}\n')
    os.mkfifo(own.lock)
    assert status.state_of(own.archive) == {
        "event": "state",
        "began": 0.0,
        "over": False,
        "running": False,
    }


def test_a_run_that_has_not_yet_said_its_name_is_seen(tmp_path):
    own = companions(tmp_path)
    own.events.write_text('{"event": "state"}\n')
    with lock_archive(own.archive):
        own.lock.write_text("")
        assert status.state_of(own.archive) == {
            "event": "state",
            "began": 0.0,
            "over": False,
            "running": True,
        }


@contextlib.contextmanager
def files_end_at(size):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_limit_of_the_size_of_files_is_named(tmp_path):
    """It was called a disk I/O error, and half of a new journal a damaged one by the
    next run.
    """
    with (
        files_end_at(20_000),
        pytest.raises(
            DiskFullError, match="s.journal cannot be written: File too large"
        ),
    ):
        Journal(tmp_path / "s.journal")
    assert not list(tmp_path.iterdir())
    (large := tmp_path / "large").write_bytes(bytes(3 << 20))
    error = sqlite3.OperationalError("disk I/O error")
    with files_end_at(3 << 20):
        assert shortage(error, large).errno == errno.EFBIG
    assert shortage(error, large) is None


def archived(path, **changes):
    """The beginning of an archive of a study: what says whose it is."""
    wanted = study(**changes)
    record = {
        "commit": "",
        "study": wanted.text,
        "walkers": [check["table"] for check in wanted.checks],
    }
    path.write_bytes(
        read._MAGIC
        + b"gaitsweep_schema"
        + json.dumps(record, sort_keys=True).encode()
        + b"\xff"
    )


@pytest.mark.parametrize(
    ("changes", "difference"),
    [
        ({}, ""),
        (
            {
                "axes": {"slope": [0.3], "R": [0.1, 0.2]},
                "want": {"variables": ["period"]},
            },
            "",
        ),
        ({"walker": ["D", "E"]}, ""),  # walkers are an axis
        ({"walker": {"base": "E", "m_h": 0.9 * (1 + 1e-15)}}, "m_h"),
        ({"walker": "D"}, "its walker has m_t = "),
        ({"kind": "orbit"}, "its kind is grid, not orbit"),
    ],
)
def test_another_study_does_not_replace_an_archive(tmp_path, changes, difference):
    archived(path := tmp_path / "s.nc")
    before = path.read_bytes()
    said = opened(path, study(**changes))
    assert (
        (difference in said and "holds another study" in said)
        if difference
        else said == ""
    )
    assert opened(path, study(**changes), fresh=True) == ""
    assert path.read_bytes() == before


def test_parameters_that_differ_by_rounding_are_those_of_the_same_walker(tmp_path):
    own = {"base": "E", "R": 0.1}
    archived(path := tmp_path / "s.nc", walker=own)
    assert opened(path, study(walker={**own, "R": 0.1 * (1 + 1e-15)})) == ""
    assert "its walker has R = 0.1, not 0.2" in opened(
        path, study(walker={**own, "R": 0.2})
    )


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b'{"commit": ',
        b'{"commit": "", "study": 3}',
        b'{"commit": "", "study": "["}',
    ],
)
def test_a_damaged_archive_may_be_replaced(tmp_path, data):
    (tmp_path / "s.nc").write_bytes(read._MAGIC + b"gaitsweep_schema" + data)
    assert (
        provenance.stored(tmp_path / "s.nc") == {} and opened(tmp_path / "s.nc") == ""
    )


@pytest.mark.parametrize(
    "name",
    ["index.html", "ledger.html", "csv/ledger.csv", "toy.html", "csv/toy-x.csv", "csv"],
)
@pytest.mark.parametrize(("make", "kind"), KINDS)
def test_a_report_replaces_only_what_a_report_has_made(tmp_path, name, make, kind):
    made = {"toy": ("<!doctype html>", {"csv/toy-x.csv": "slope,period\n1,2\n"})}
    precious(tmp_path / "precious")
    (tmp_path / name).parent.mkdir(exist_ok=True)
    make(tmp_path / name)
    before = state(tmp_path / name)
    if name == "csv" and make is os.mkdir:  # that is the folder of data
        return
    with pytest.raises(ArchiveError, match=rf"{name} is.*move it away\.$") as raised:
        folder.combine(pages._environment(), tmp_path, made, only=False)
    assert kind in str(raised.value) and {f.name for f in tmp_path.iterdir()} == {
        "precious",
        name.partition("/")[0],
    }
    assert state(tmp_path / name) == before


def test_a_report_writes_no_data_through_a_link_to_another_folder(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "csv").symlink_to("elsewhere")
    with pytest.raises(ArchiveError, match="csv is a link"):
        folder.combine(
            pages._environment(),
            tmp_path,
            {"toy": ("<!doctype html>", {"csv/toy-x.csv": "a\n1\n"})},
        )
    assert not list((tmp_path / "elsewhere").iterdir())


def test_data_that_a_killed_report_left_are_replaced(tmp_path):
    (tmp_path / "csv").mkdir()
    (tmp_path / "csv" / "toy-x.csv").write_text("slope,period\n3,4\n")
    made = {"toy": ("<!doctype html>", {"csv/toy-x.csv": "slope,period\n1,2\n"})}
    folder.combine(pages._environment(), tmp_path, made, only=False)
    assert (tmp_path / "csv" / "toy-x.csv").read_text() == "slope,period\n1,2\n"
    folder.combine(
        pages._environment(), tmp_path, {}, only=False
    )  # index and ledger are known again


@pytest.fixture
def ledger(tmp_path, monkeypatch):
    """An archive that holds claim D2, in the folder of archives."""
    monkeypatch.chdir(tmp_path)
    (folder := tmp_path / "data" / "archive").mkdir(parents=True)
    with netCDF4.Dataset(folder / "ledger.nc", "w") as file:
        record = {"commit": "", "study": '[want]\nclaims = ["D2"]', "walkers": []}
        file.provenance = json.dumps(
            {**record, "tasks": {"claims": TASKS["claims"].version}}, sort_keys=True
        )
        file.gaitsweep_schema = np.int32(2)
        group = file.createGroup("claims")
        group.createDimension("row", 1)
        columns = {
            "id": "D2",
            "verdict": "stored",
            "quotation": "q",
            "source": "s",
            "interval": "",
            "computed": "c",
        }
        for name, value in columns.items():
            write_strings(group, name, "row", [value], {"units": "1"})
        for name, value in {
            "printed_value": np.nan,
            "printed_half_unit": 0.0,
            "value": 0.5,
        }.items():
            group.createVariable(name, "f8", ("row",))[:] = value
            group[name].units = "1"
    monkeypatch.setattr(
        claims,
        "ask",
        lambda call, params: [{"id": params["ids"][0], "verdict": "computed"}],
    )
    return folder / "ledger.nc"


def told(capsys):
    assert commands.main(["claims", "D3", "D2", "--json"]) == 0
    return {claim["id"]: claim for claim in json.loads(capsys.readouterr().out)}


def test_claims_are_read_from_archives_and_the_others_computed(ledger, capsys):
    found = told(capsys)
    assert [*found] == ["D2", "D3"] and found["D3"]["verdict"] == "computed"
    assert (
        found["D2"]["verdict"] == "stored"
        and found["D2"]["printed_value"] is None
        and found["D2"]["value"] == 0.5
    )


@pytest.mark.parametrize(
    "other",
    [
        *({"tasks": tasks} for tasks in ({"claims": 0}, {}, 3)),
        *({"study": text} for text in ("", "want = 3", '[want]\nclaims = [["D2"]]')),
    ],
)
def test_claims_of_another_version_or_record_are_computed_again(ledger, capsys, other):
    with netCDF4.Dataset(ledger, "a") as file:
        file.provenance = json.dumps(
            {**json.loads(file.provenance), **other}, sort_keys=True
        )
    assert told(capsys)["D2"]["verdict"] == "computed"


def test_each_claim_is_printed_as_soon_as_it_is_known(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    seen = []

    def ask(call, params):
        seen.append(capsys.readouterr().out)
        blank = dict.fromkeys(("quotation", "source", "computed"), "") | dict.fromkeys(
            ("printed_value", "value")
        )
        return [{"id": params["ids"][0], "verdict": "proved", **blank}]

    monkeypatch.setattr(claims, "ask", ask)
    assert commands.main(["claims", "D2", "D3"]) == 0
    assert seen[0] == "" and seen[1].startswith("D2: proved\n")


def test_kinds_of_files_are_told_by_their_mode():
    assert (
        paths.kind_of(stat.S_IFBLK | 0o600) == "a device"
        and paths.kind_of(stat.S_IFREG | 0o600) == ""
    )
