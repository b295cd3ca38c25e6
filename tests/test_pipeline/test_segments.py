"""Finished chunks: packed by workers, kept unopened in a segment beside the journal, copied into the archive."""

import contextlib
import errno
import functools
import json
import os
import random
import signal
import sqlite3
import zlib
from collections import Counter

import netCDF4
import numpy as np
import pytest

from conftest import STUDY, Toy
from pipeline import serialize
from pipeline.archive import layout, points, read, verify, write
from pipeline.errors import ArchiveError, DiskFullError
from pipeline.execution.archive_chunks import ArchiveChunks
from pipeline.plan.missing import Plan
from pipeline.statuses import ALL_STATUSES
from pipeline.store import finished, lines, segment
from pipeline.store.journal import Journal
from pipeline.store.journal_file import CorruptJournalError, repair
from pipeline.store.rows import Result
from pipeline.study import parse
from processes import damaged, wait_for_points
from processes import sidecar_path as sidecar

#: Chunks of 20 points, ten of them on each of the two lines.
SMALL = {"TOY_CHUNK": "20"}
SEGMENT = f".journal{segment.SUFFIX}"
WANT = lines.needed(["stance_angle", "multiplier_real"], ["long"])


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Bytes of an undisturbed run with small chunks, its journal and its segment."""
    toy = Toy(tmp_path_factory.mktemp("small"))
    toy.write()
    toy("run", "toy.toml", **SMALL)
    return toy.bytes(), sidecar(toy).read_bytes(), sidecar(toy, SEGMENT).read_bytes()


def chunks(toy):
    """Events of the last run that hold points."""
    events = [json.loads(line) for line in sidecar(toy, ".events.jsonl").read_text().splitlines()]
    begin = max(i for i, event in enumerate(events) if event["event"] == "begin")
    return [event for event in events[begin:] if event["event"] == "chunk"]


def stored(toy):
    """Points in the journal, and those of them in finished chunks."""
    with contextlib.closing(sqlite3.connect(sidecar(toy))) as db:
        return db.execute("SELECT sum(n), sum(n * (length > 0)) FROM points").fetchone()


@pytest.mark.parametrize("options", [("--chunk", 4), ("--chunk", 20), ("--chunk", 50, "--jobs", 3), ("--jobs", 1)])
def test_finished_chunks_give_the_bytes_of_others(toy, small, options):
    toy("run", "toy.toml", *options, **SMALL)
    assert toy.bytes() == small[0]
    assert stored(toy) == ((400, 0) if "4" in map(str, options) else (400, 400))
    toy("run", "toy.toml", *options, **SMALL)
    assert toy.bytes() == small[0] and not chunks(toy)


@pytest.mark.parametrize("signum", [signal.SIGKILL, signal.SIGTERM])
def test_a_stopped_run_solves_no_finished_chunk_twice(toy, small, signum):
    process = toy.start("run", "toy.toml", "--chunk", 20, TOY_SECONDS="0.002", **SMALL)
    wait_for_points(toy, 3)
    process.send_signal(signum)
    process.communicate()
    done = sum(event["points"] for event in chunks(toy))
    toy("run", "toy.toml", "--chunk", 20, **SMALL)
    assert toy.bytes() == small[0]
    assert done > 0 and done + sum(event["points"] for event in chunks(toy)) <= 400 + 2 * 20


def test_a_tail_that_no_row_knows_is_cut_off(toy, small):
    toy("run", "toy.toml", **SMALL)
    file = sidecar(toy, SEGMENT)
    whole = file.read_bytes()
    file.write_bytes(whole + b"rest of a chunk")
    toy("run", "toy.toml", **SMALL)
    assert file.read_bytes() == whole and not chunks(toy) and toy.bytes() == small[0]


def _torn(data, dice):
    return data[: dice.randrange(len(data))]


#: What may have become of a segment, from its bytes.
FATES = {
    "torn": _torn,
    "missing": lambda data, dice: None,
    "empty": lambda data, dice: b"",
    "junk": lambda data, dice: dice.randbytes(len(data)),
    "beginning lost": lambda data, dice: bytes(16) + data[16:],
    "last chunk lost": lambda data, dice: data[:-1],
    "a bit": lambda data, dice: (k := dice.randrange(len(data))) and data[:k] + bytes([data[k] ^ 1]) + data[k + 1 :],
}


@pytest.mark.parametrize("fate", FATES)
def test_whatever_becomes_of_a_segment_the_bytes_are_the_same(toy, small, fate):
    folder = sidecar(toy).parent
    folder.mkdir(parents=True)
    sidecar(toy).write_bytes(small[1])
    if (data := FATES[fate](small[2], random.Random(fate))) is not None:
        sidecar(toy, SEGMENT).write_bytes(data)
    said = toy("run", "toy.toml", **SMALL).stderr
    assert toy.bytes() == small[0] and "was damaged; it is repaired" in said and "Traceback" not in said
    again = sum(event["points"] for event in chunks(toy))
    kept = {"beginning lost": 400, "last chunk lost": 380, "a bit": 380, "torn": 20}.get(fate, 0)
    assert again <= 400 - kept
    toy("run", "toy.toml", **SMALL)
    assert toy.bytes() == small[0] and not chunks(toy)


def test_a_segment_of_another_study_gives_none_of_its_points(toy, small):
    toy.write(STUDY.replace("[0.0, 0.25]", "[0.5, 0.75]"))
    toy("run", "toy.toml", **SMALL)
    other = sidecar(toy, SEGMENT).read_bytes()
    toy.write()
    toy("run", "toy.toml", "--fresh", **SMALL)
    sidecar(toy, SEGMENT).write_bytes(other)
    toy("run", "toy.toml", **SMALL)
    assert toy.bytes() == small[0]
    assert sum(event["points"] for event in chunks(toy)) == 400


@pytest.mark.parametrize("times", [2, pytest.param(100, marks=pytest.mark.soak)])
def test_a_damaged_segment_or_journal_gives_the_same_bytes(toy, small, tell, times):
    dice, again = random.Random(times), 0
    sidecar(toy).parent.mkdir(parents=True)
    for k in range(times):
        for what, data in (("", small[1]), (segment.SUFFIX, small[2])):
            hurt = (k % 2 == 0) == bool(what) or k % 5 == 0
            sidecar(toy, f".journal{what}").write_bytes(damaged(data, dice) if hurt else data)
        for what in (".events.jsonl", ".nc"):
            sidecar(toy, what).unlink(missing_ok=True)
        toy("run", "toy.toml", **SMALL)
        assert toy.bytes() == small[0]
        again += bool(chunks(toy))
        toy("run", "toy.toml", **SMALL)
        assert toy.bytes() == small[0] and not chunks(toy)
    tell(f"{times} damaged segments and journals: equal bytes after each, {again} with points computed again")


def test_a_foreign_file_in_the_place_of_a_segment_is_not_touched(toy):
    sidecar(toy).parent.mkdir(parents=True)
    sidecar(toy, SEGMENT).write_text("mine\n")
    for options in ((), ("--fresh",)):
        assert "is not a file of gaitsweep; move it away" in toy("run", "toy.toml", *options, expect=2).stderr
        assert sidecar(toy, SEGMENT).read_text() == "mine\n"


def test_fresh_forgets_the_segment_too(toy, small):
    toy("run", "toy.toml", **SMALL)
    size = sidecar(toy, SEGMENT).stat().st_size
    toy("run", "toy.toml", "--fresh", **SMALL)
    assert stored(toy) == (400, 400) and sidecar(toy, SEGMENT).stat().st_size == size and toy.bytes() == small[0]


def test_a_journal_of_an_earlier_version_is_told_with_what_fresh_would_cost(toy, small):
    toy("run", "toy.toml", **SMALL)
    with contextlib.closing(sqlite3.connect(sidecar(toy))) as db:
        for column in ("start", "length"):
            db.execute(f"ALTER TABLE points DROP COLUMN {column}")
        db.execute("UPDATE points SET seconds = 3.5")
        db.execute("PRAGMA application_id = 0x67735732")
        db.commit()
    before = sidecar(toy).read_bytes()
    for command in ("run", "plan"):
        said = toy(command, "toy.toml", expect=2).stderr
        assert said.count("\n") == 1
        assert "earlier version; `run --fresh` replaces it and computes its 400 points again, which took 70 s" in said
    assert sidecar(toy).read_bytes() == before
    toy("run", "toy.toml", "--fresh", **SMALL)
    assert toy.bytes() == small[0]


def test_walkers_with_and_without_knees_share_a_variable(toy):
    """Three multipliers and four: those that a walker does not have are absent."""
    toy.write(STUDY.replace('"E"', '["E", "C"]').replace("w_t = [0.0, 0.25]\n", "").replace('fits = ["scaling"]', ""))
    toy("run", "toy.toml", **SMALL)
    assert stored(toy) == (400, 400)
    copied = toy.bytes()
    toy("run", "toy.toml", "--fresh", "--chunk", 4, **SMALL)
    assert toy.bytes() == copied and stored(toy) == (400, 0)
    with netCDF4.Dataset(sidecar(toy, ".nc")) as file:
        assert file["multiplier_real"].shape[-1] == 4 and not verify.verify(sidecar(toy, ".nc"))


def test_chunks_of_which_a_few_points_are_known_are_solved_whole(toy, small):
    """Their points, as all, depend on nothing but their line."""
    few = np.linspace(0.01, 0.2, 200)[3::25].tolist()
    toy.write(STUDY.replace("{ from = 0.01, to = 0.2, n = 200 }", str(few)))
    toy("run", "toy.toml", **SMALL)
    assert stored(toy) == (16, 0)
    toy.write()
    toy("run", "toy.toml", **SMALL)
    assert toy.bytes() == small[0]
    # Of some chunks of twenty one point is known, of others none.
    assert sum(event["points"] for event in chunks(toy)) == 400 - 16 and stored(toy) == (416, 400)
    assert sum(sum(event["counts"].values()) for event in chunks(toy)) == 400 - 16


def test_archives_of_the_first_schema_are_still_read(toy):
    """Whose checksums are of boxes with all gaits."""
    toy("run", "toy.toml")
    path = sidecar(toy, ".nc")
    with netCDF4.Dataset(path, "a") as file:
        sums = json.loads(file.checksums)
        file.gaitsweep_schema = np.int32(1)
        file.delncattr("checksum_chunk")
        for name in sums:
            values = np.ma.getdata(file[name][...])
            if read.is_over_grid(file[name]):
                sums[name] = layout.checksum(values, (slice(0, 200), slice(0, 2))) % 2**32
        file.checksums = json.dumps(sums)
    assert verify.verify(path) == []
    with netCDF4.Dataset(path, "a") as file:
        file["stance_angle"][3, 1, 0] = 1.0
    assert "`stance_angle` is not as it was written." in verify.verify(path)


# The parts.


def chunk(slopes, value, extent=20, gaits=2):
    """A finished chunk: head and payload."""
    n = len(slopes)
    status = np.full((n, 4), 1, np.int8)
    status[:, :gaits] = 0
    values = {
        "status": status,
        "reason": status.astype(np.int16),
        "stance_angle": np.full((n, gaits), value) * np.arange(n)[:, None],
        "multiplier_real": np.random.default_rng(1).random((n, gaits, 3)) * value,
    }
    return finished.finish(slopes, values, ["It converged.", "None."], extent, 4), values


@pytest.fixture
def journal(tmp_path):
    found = Journal(tmp_path / "j")
    yield found
    found.close()


def test_a_finished_chunk_gives_back_what_went_in(journal):
    slopes = np.linspace(0.1, 0.2, 13)
    packed, values = chunk(slopes, 1.5)
    head = journal.add_chunk("L", "k", WANT, packed, 0.1)
    assert (head.points, head.extent, head.multipliers, head.low, head.high) == (13, 20, 4, 0.1, 0.2)
    assert head.rows() == {(0, 0, 1, 1): 13} and head.used([0]) == [0] and head.used([1, 3]) == [0, 1]
    (block,) = journal.blocks("L")
    np.testing.assert_array_equal(block.slopes, slopes)
    np.testing.assert_array_equal(block.states["status"], values["status"])
    np.testing.assert_array_equal(block.states["reason"], values["reason"])
    assert block.states["reasons"].tolist() == ["It converged.", "None."]
    data = journal.variables(block.id)
    np.testing.assert_array_equal(data["stance_angle"], values["stance_angle"])
    np.testing.assert_array_equal(data["multiplier_real"][..., :3], values["multiplier_real"])
    assert np.isnan(data["multiplier_real"][..., 3]).all()
    assert data.get("period") is None and set(data) == set(values)
    with pytest.raises(KeyError):
        data["period"]
    piece = head.piece(memoryview(packed[1]), "stance_angle", 1)
    assert piece.checksum == zlib.crc32(values["stance_angle"][:, 1].tobytes())
    assert head.piece(memoryview(packed[1]), "stance_angle", 2) is None
    with pytest.MonkeyPatch.context() as patch:  # what there is to do is known without reading the segment
        patch.setattr("pipeline.store.journal._MIN_MEASURED", 13)
        assert journal.seconds_per_point() == pytest.approx(0.1)
        patch.setattr(segment.Segment, "read", None)
        assert lines.missing(journal, "L", WANT, slopes).tolist() == []
    assert lines.missing(journal, "L", WANT, slopes[::-1]).tolist() == []
    assert lines.missing(journal, "L", WANT, np.append(slopes[3:], 0.3)).tolist() == [10]
    assert head.digest == finished.digest(slopes) != finished.digest(slopes[::-1])


def test_the_later_of_two_results_counts_whether_finished_or_not(journal):
    slopes = np.linspace(0.1, 0.2, 13)
    for value in (1.0, 2.0):
        journal.add_chunk("L", "k", WANT, chunk(slopes, value)[0], 0.1)
    sources = lines.states(journal, "L", WANT, slopes)[3]
    found = lines.fill(journal, ["stance_angle"], sources, 13, 4)["stance_angle"]
    np.testing.assert_array_equal(found[:, 0], 2.0 * np.arange(13))
    assert np.isnan(found[:, 2]).all()


@pytest.mark.parametrize("column", ["start", "length", "data_sum", "states", "slopes", "low", "n", "variables", "line"])
def test_a_damaged_row_of_a_finished_chunk_costs_that_chunk_alone(tmp_path, column):
    slopes = np.linspace(0.1, 0.4, 60)
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        for k in range(3):
            journal.add_chunk("L", "k", WANT, chunk(slopes[20 * k : 20 * k + 20], k + 1.0)[0], 0.1)
    wrong = {"states": "x'00'", "slopes": "'x'", "variables": "'x'", "line": "'M'"}.get(column, f"{column} + 1")
    with contextlib.closing(sqlite3.connect(tmp_path / "j")) as db:
        db.execute(f"UPDATE points SET {column} = {wrong} WHERE id = 2")
        db.commit()
    with contextlib.suppress(CorruptJournalError), contextlib.closing(Journal(tmp_path / "j")) as journal:
        left = lines.missing(journal, "L", WANT, slopes)
        assert column == "line" and len(left) == 20
    repair(tmp_path / "j")
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        assert lines.missing(journal, "L", WANT, slopes).tolist() == list(range(20, 40))
        journal.add_chunk("L", "k", WANT, chunk(slopes[20:40], 2.0)[0], 0.1)
        sources = lines.states(journal, "L", WANT, slopes)[3]
        found = lines.fill(journal, ["stance_angle"], sources, 60, 4)["stance_angle"][:, 0]
    np.testing.assert_array_equal(found, np.concatenate([(k + 1.0) * np.arange(20) for k in range(3)]))


def test_a_chunk_that_no_longer_fits_on_the_disk_is_told_and_the_next_takes_its_place(tmp_path, monkeypatch):
    slopes, pwrite = np.linspace(0.1, 0.4, 60), os.pwrite
    parts = [chunk(slopes[20 * k : 20 * k + 20], k + 1.0)[0] for k in range(3)]
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        journal.add_chunk("L", "k", WANT, parts[0], 0.1)

        def full(file, data, offset):
            if len(data) < 100:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return pwrite(file, data[:-90], offset)

        with monkeypatch.context() as patch, pytest.raises(DiskFullError, match="The disk is full"):
            patch.setattr(os, "pwrite", full)
            journal.add_chunk("L", "k", WANT, parts[1], 0.1)
        journal.add_chunk("L", "k", WANT, parts[2], 0.1)
        assert lines.missing(journal, "L", WANT, slopes).tolist() == list(range(20, 40))
    size = len(segment.MAGIC) + sum(len(parts[k][1]) for k in (0, 2))
    assert (tmp_path / "j-chunks").stat().st_size == size


def test_chunks_reach_the_disk_before_the_rows_that_name_them(tmp_path, monkeypatch):
    order, fsync = [], os.fsync
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        monkeypatch.setattr(os, "fsync", lambda fd: (order.append(os.readlink(f"/proc/self/fd/{fd}")), fsync(fd)))
        read_sql = Journal._read
        monkeypatch.setattr(Journal, "_read", lambda *a: (order.append(a[1]), read_sql(*a))[1])
        journal.add_chunk("L", "k", WANT, chunk(np.array([0.1]), 1.0)[0], 0.1)
    full = next(i for i, sql in enumerate(order) if "synchronous=FULL" in sql)
    insert = next(i for i, sql in enumerate(order) if sql.startswith("INSERT"))
    # Once when it is made, and before the row.
    assert order.index(str(tmp_path / "j-chunks")) < full < order.index(str(tmp_path / "j-chunks"), full) < insert


def test_a_journal_that_is_only_read_makes_no_segment(tmp_path):
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        journal.add_chunk("L", "k", WANT, chunk(np.array([0.1]), 1.0)[0], 0.1)
    os.unlink(tmp_path / "j-chunks")
    with pytest.raises(CorruptJournalError):
        Journal(tmp_path / "j", write=False)
    assert not (tmp_path / "j-chunks").exists()
    (tmp_path / "j").unlink()
    (tmp_path / "j-chunks").write_text("another's")
    with pytest.raises(ArchiveError, match="move it away"):
        Journal(tmp_path / "j")


@pytest.mark.parametrize("extent", [0, 7, 10, 100])
def test_jobs_cover_the_points_once_and_end_where_chunks_do(extent):
    division, indices = ArchiveChunks(95, extent), np.arange(95)
    for size in (1, 4, 7, 25, 1000):
        parts = division.divide(indices, size)
        np.testing.assert_array_equal(np.concatenate(parts), indices)
        if extent:
            assert all(part[0] % extent == 0 for part in parts)
        taken, rest = [], indices
        while len(rest):
            n = division.cut(rest, size)
            assert 0 < n <= 4 * size
            taken.append(rest[:n])
            rest = rest[n:]
        np.testing.assert_array_equal(np.concatenate(taken), indices)
        if 0 < extent <= 4 * size:
            assert all(division.whole(part) is not None for part in taken)


def test_a_chunk_is_whole_if_nine_tenths_of_it_are_missing():
    division = ArchiveChunks(95, 20)
    assert division.whole(np.arange(20, 38)) == slice(20, 40)
    assert division.whole(np.arange(20, 37)) is None
    assert division.whole(np.arange(81, 95)) == slice(80, 95)
    assert division.whole(np.r_[1:19, 20:40]) == slice(0, 40)
    assert division.whole(np.r_[0:20, 40:60]) is None
    assert ArchiveChunks(95, 0).whole(np.arange(95)) is None


@pytest.fixture
def chunks_of_17(monkeypatch):
    """A line of fifty slopes is a long one, of three chunks."""
    monkeypatch.setattr(layout, "CHUNK", 20)
    monkeypatch.setattr("tasks.registry.SHORT_LINE", 10)
    monkeypatch.setattr("pipeline.plan.graph.SHORT_LINE", 10)


def test_an_archive_is_written_whatever_of_a_journal_is_finished(tmp_path, monkeypatch, chunks_of_17):
    """Chunks of the same line finished, in rows, retried, or of another grid: equal bytes."""
    (tmp_path / "s.toml").write_text(
        'name = "s"\nwalker = "E"\ngaits = ["long"]\n[axes]\nslope = { from = 0.01, to = 0.1, n = 50 }\n'
        '[want]\nvariables = ["stance_angle"]\n'
    )
    study, archives, put_together = parse.read(tmp_path / "s.toml"), [], []
    region = points.PointWriter._region
    monkeypatch.setattr(points.PointWriter, "_region", lambda *a: (put_together.append(way), region(*a))[1])
    for way in ("finished", "rows", "both", "another grid"):
        with contextlib.closing(Journal(tmp_path / way)) as journal:
            plan = Plan(study, journal)
            store = functools.partial(_store, journal, plan)
            cuts = {"finished": [17, 34], "rows": [5, 20, 41], "both": [17, 34], "another grid": [25]}[way]
            for k, numbers in enumerate(np.split(np.arange(50), cuts)):
                is_row = way == "rows" or (way, k) == ("both", 1)
                store(numbers, 0 if is_row else 25 if way == "another grid" else 17)
            if way == "both":  # points of a finished chunk computed again
                store(np.arange(3, 5), 0)
            write.write(plan, tmp_path / f"{way}.nc")
            assert verify.verify(tmp_path / f"{way}.nc") == []
        archives.append((tmp_path / f"{way}.nc").read_bytes())
    assert len(set(archives)) == 1
    assert Counter(put_together) == {"rows": 3, "both": 2, "another grid": 3}  # the others are copied unopened


@pytest.mark.parametrize("atlas", ["none", "ok", "timed_out"])
def test_points_that_nobody_has_reached_are_archived_unseen(tmp_path, monkeypatch, chunks_of_17, atlas):
    """With the bytes of an archive that looks at each, and as failures of their atlas where that failed."""
    (tmp_path / "s.toml").write_text(
        'name = "s"\nwalker = "E"\n[axes]\nslope = { from = 0.01, to = 0.1, n = 50 }\n'
        '[want]\nvariables = ["stance_angle"]\n'
    )
    seen, region = [], points.PointWriter._region
    monkeypatch.setattr(points.PointWriter, "_region", lambda self, box: (seen.append(box[-1]), region(self, box))[1])
    with contextlib.closing(Journal(tmp_path / "s.journal")) as journal:
        plan = Plan(parse.read(tmp_path / "s.toml"), journal)
        if atlas != "none":
            journal.add_result(*plan.line_keys(0)["atlas"], Result(atlas, "It took too long.", 0, b""), 0.1)
        _store(journal, plan, np.arange(25, 50), 0)
        fast = write.write(plan, tmp_path / "fast.nc")
        assert seen == [slice(0, 17), slice(17, 34), slice(34, 50)][0 if atlas == "timed_out" else 1 :]
        monkeypatch.setattr(points.PointWriter, "_is_unreached", lambda *a: False)
        slow = write.write(plan, tmp_path / "slow.nc")
    assert fast == slow
    assert (tmp_path / "fast.nc").read_bytes() == (tmp_path / "slow.nc").read_bytes()
    with read.open_archive(tmp_path / "fast.nc") as file:
        expected = [ALL_STATUSES["timed_out" if atlas == "timed_out" else "not_attempted"]] * 25
        assert file["status"][:25, 0].tolist() == expected and file["stance_angle"][:25].mask.all()


def _store(journal, plan, numbers, extent):
    """Store points of a study as a finished chunk of that extent, or as a row."""
    n, slopes, key = len(numbers), plan.study.slope[numbers], plan.line_keys(0)["points"]
    status = np.full((n, 4), 1, np.int8)
    status[:, 0] = numbers % 7 == 6
    columns = {name: np.full((n, 1), np.nan) for name in plan.variables if name not in ("status", "reason")}
    columns |= {name: np.where(status[:, :1] == 0, 3, -1).astype(np.int16) for name in ("branch", "piece")}
    columns["stance_angle"][:, 0] = np.where(status[:, 0] == 0, np.sqrt(slopes), np.nan)
    reason = np.stack([numbers // 30, *[np.zeros(n, int)] * 3], axis=1).astype(np.int16)
    sentences = ["The one sentence.", "A later sentence."]
    if extent:
        values = {"status": status, "reason": reason, **columns}
        journal.add_chunk(*key, plan.want, finished.finish(slopes, values, sentences, extent, 3), 0.1)
    else:
        states = {"status": status, "reason": reason, "reasons": np.array(sentences)}
        journal.add_points(*key, plan.want, (slopes.tobytes(), serialize.dump(states), serialize.dump(columns)), 0.1)


def test_a_closed_segment_can_be_closed_again_and_read(tmp_path):
    one = segment.Segment(tmp_path / "s")
    start = one.append(b"payload")
    one.close()
    one.close()
    assert one.read(start, 7) == b"payload"
