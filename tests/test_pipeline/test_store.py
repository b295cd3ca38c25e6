"""The store gives back what was written, or says that it is damaged."""

import contextlib
import errno
import os
import random
import shutil
import sqlite3
import zlib

import numpy as np
import pytest

from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.errors import ArchiveError, DiskFullError
from gaitsweep.pipeline.grid.grid import Shape
from gaitsweep.pipeline.outcomes import count, count_rows
from gaitsweep.pipeline.statuses import STATUS_NAMES
from gaitsweep.pipeline.store import file, journal
from gaitsweep.pipeline.store.file import CorruptStoreError, forget, repair
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.store.memory import Memory
from gaitsweep.pipeline.store.points import Points, joined, sentence_number
from gaitsweep.pipeline.store.record import ChunkCodec, Record
from gaitsweep.pipeline.store.store import Outcome
from gaitsweep.tasks.contract import variables
from gaitsweep.tasks.contract.registry import VARIABLES
from processes import damaged

N = 40  # records in a store of the tests
PACKED = serialize.dump({"x": 1})
summary, decode = ChunkCodec.summary, ChunkCodec.decode


def filled(path, n=N, size=500):
    with contextlib.closing(Journal(path)) as found:
        for k in range(n):
            found.put(f"points-{k}", record(k, size))
    return path


def record(k, size=500):
    """Record of a number."""
    return Record(bytes([k]) * 9, np.full(size, k, "f8").tobytes())


def reopened(path):
    """A store as the next run has it."""
    try:
        return Journal(path)
    except CorruptStoreError:
        repair(path)
        return Journal(path)


def whole(found, n=N, size=500):
    """Numbers of the records that are there; each is as it was written, or this raises."""
    there = [k for k in range(n) if f"points-{k}" in found]
    for k in there:
        head, payload = found.get(f"points-{k}")
        assert (
            head == bytes([k]) * 9 == found.head(f"points-{k}")
            and payload == np.full(size, k, "f8").tobytes()
        )
    return there


def sql(path, *statements):
    """What somebody else does to a store."""
    with contextlib.closing(sqlite3.connect(path)) as db:
        for statement in statements:
            db.execute(statement)
        db.commit()


class StoreTests:
    """What every store does; `store` is an empty one."""

    def test_a_record_is_found_by_its_key(self, store):
        for k in range(5):
            store.put(f"points-{k}", record(k))

        assert "points-3" in store and "points-5" not in store
        assert store.get("points-3") == record(3)
        assert store.head("points-3") == record(3).head

    def test_the_latest_record_of_a_key_counts(self, store):
        for k in range(5):
            store.put(f"points-{k}", record(k))

        store.put("points-3", Record(b"head", b"later"))

        assert store.get("points-3") == (b"head", b"later")
        assert store.head("points-3") == b"head" and len(list(store)) == 5

    def test_keys_come_in_the_order_of_their_records(self, store):
        for key in "abca":
            store.put(key, record(1))

        assert list(store) == ["b", "c", "a"]
        assert store.number("b") < store.number("c") < store.number("a") == store.last
        assert store.number("d") == 0

    def test_an_empty_store_holds_nothing(self, store):
        assert not store and not list(store) and store.last == 0
        with pytest.raises(ArchiveError):
            store.get("a")
        assert store.head("a") is None and store.chunk("a") is None
        store.put("a", Record(b"", b""))
        assert store and store.get("a") == (b"", b"")

    def test_results_are_kept_with_how_they_ended(self, store):
        store.put_result("a", Outcome("ok", ""), PACKED)
        store.put_result("b", Outcome("raised", "It raised."), b"")

        assert store.outcome("a") == ("ok", "") and store.result("a") == {"x": 1}
        assert store.outcome("b") == ("raised", "It raised.")
        assert store.result("b") is None
        assert store.outcome("none") is None and store.result("none") is None

    def test_what_was_never_packed_is_damage(self, store):
        store.put("c", Record(serialize.dump(["other", ""]), b""))
        store.put("d", Record(b"junk", b""))
        store.put_result("e", Outcome("ok", ""), b"no packed result")

        for key in "cde":
            with pytest.raises(type(store.damage())):
                store.result(key)
        for read in (store.chunk, store.points):
            with pytest.raises(type(store.damage())):
                read("d")

    def test_points_are_read_with_all_variables_or_some(self, store):
        own, result = points(1, 4)
        shape = Shape((4,), (4,), 0)
        store.put("points", ChunkCodec(shape, 3, ["long"]).encode(own))

        some = store.points("points", ["branch"])

        assert list(some.values) == ["branch"] and store.chunk("points").shape == shape
        np.testing.assert_array_equal(some.values["branch"], result["branch"][:, :2])
        assert store.points("points").values.keys() == own.values.keys()

    def test_notes_are_kept_beside_records(self, store):
        assert store.note("code") is None
        store.set_note("code", "one")
        store.set_note("code", "other")
        assert store.note("code") == "other" and not store


class TestJournal(StoreTests):
    @pytest.fixture
    def store(self, tmp_path):
        with contextlib.closing(Journal(tmp_path / "j")) as found:
            yield found

    def test_what_was_stored_is_there_when_it_is_opened_again(self, store):
        store.put("a", record(1))
        store.put("a", record(2))
        store.set_note("code", "one")

        with contextlib.closing(Journal(store.path)) as again:
            assert again.get("a") == record(2) and again.number("a") == 2
            assert again.note("code") == "one"
            assert again._execute("SELECT count(*) FROM records") == [(1,)]


class TestMemory(StoreTests):
    @pytest.fixture
    def store(self):
        return Memory()

    def test_what_was_not_used_longest_is_dropped(self):
        one = sum(map(len, record(1)))
        store = Memory(2 * one)
        for key in "ab":
            store.put(key, record(1))
        store.get("a")

        store.put("c", record(2))
        assert "b" in store and store.size > store.bound
        store.trim()

        assert "a" in store and "c" in store and "b" not in store
        assert store.size == store.bound
        store.put("c", record(3))
        assert store.size == store.bound and store.get("c") == record(3)
        store.put("d", record(4, 5000))  # larger than the bound
        store.trim()
        assert store.size == 0 and "d" not in store


def test_a_repair_finds_records_beyond_the_numbers_that_others_left(tmp_path):
    """As a thousand chunks leave them that are computed again, with one more variable."""
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        for k in 2 * [*range(file._MAX_GAP + 1)]:
            found.put(f"points-{k}", Record(b"head", b"payload"))
    for number in (None, 2**63 - 1):  # the last that there can be, too
        if number:
            sql(
                tmp_path / "j",
                f"UPDATE records SET id = {number} WHERE key = 'points-0'",
            )
        repair(tmp_path / "j")
        with contextlib.closing(Journal(tmp_path / "j")) as found:
            assert len([*found]) == file._MAX_GAP + (number is None)


def test_of_two_records_that_a_kill_left_the_later_counts(tmp_path):
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        for number, data in ((1, b"earlier"), (2, b"later")):
            sums = file.sums(number, "k", b"", data)
            found._execute(
                "INSERT INTO records VALUES (?, ?, ?, ?, ?, ?)",
                number,
                "k",
                *sums,
                b"",
                data,
            )
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        assert found.get("k") == (b"", b"later")


def test_a_store_is_forgotten_with_all_its_files_and_another_file_is_not(tmp_path):
    forget(filled(tmp_path / "j"))
    assert not list(tmp_path.iterdir())
    other = tmp_path / "other"
    other.write_text("not ours")
    with pytest.raises(ArchiveError, match="move it away"):
        forget(other)
    assert other.read_text() == "not ours"


@pytest.mark.parametrize("part", np.linspace(0, 1, 12))
def test_a_store_cut_anywhere_keeps_its_beginning(tmp_path, part):
    size = os.path.getsize(filled(tmp_path / "j"))
    os.truncate(tmp_path / "j", int(part * size))
    with contextlib.closing(reopened(tmp_path / "j")) as found:
        assert len(whole(found)) >= N * part - 8


#: How the columns of a row may be damaged.
OTHER = {
    "id": "id + 400",
    "key": "'other'",
    "sum": "sum + 1",
    "payload_sum": "NULL",
    "head": "x'00'",
    "payload": "zeroblob(length(payload))",
}


@pytest.mark.parametrize("column", OTHER)
def test_whatever_is_damaged_in_a_row_costs_that_row_alone(tmp_path, column):
    filled(tmp_path / "j", 3)
    sql(tmp_path / "j", f"UPDATE records SET {column} = {OTHER[column]} WHERE id = 2")
    with (
        contextlib.suppress(CorruptStoreError),
        contextlib.closing(Journal(tmp_path / "j")) as found,
    ):
        whole(found, 3)
        assert column == "key"  # it is not found, and so not read
    repair(tmp_path / "j")
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        assert whole(found, 3) == [0, 2]


@pytest.mark.parametrize(
    ("new", "left"),
    [(b"hexd BLOB, payload BLOB", [0, 1, 2]), (b"head BLOB  payload BLOB", [])],
)
def test_a_store_with_other_columns_is_repaired(tmp_path, new, left):
    """Damaged names change no record; with a column less none can be read."""
    data = filled(tmp_path / "j", 3).read_bytes()
    assert data.count(b"head BLOB, payload BLOB") == 1
    (tmp_path / "j").write_bytes(data.replace(b"head BLOB, payload BLOB", new))
    with pytest.raises(CorruptStoreError):
        Journal(tmp_path / "j")
    repair(tmp_path / "j")
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        assert whole(found, 3) == left


@pytest.mark.parametrize("seed", range(4))
def test_what_a_damaged_store_gives_is_what_was_written(tmp_path, seed):
    """At a random place, in the file or the log beside it."""
    dice, lost = random.Random(seed), 0
    with contextlib.closing(Journal(filled(tmp_path / "whole", 20))) as found:
        for k in range(20, N):
            found.put(f"points-{k}", record(k))
        files = {
            suffix: (tmp_path / f"whole{suffix}").read_bytes()
            for suffix in ("", "-wal")
        }
    if seed < 2:
        files = {"": (tmp_path / "whole").read_bytes()}
    for _ in range(15):
        hurt = dice.choice([suffix for suffix in files if files[suffix]])
        for suffix, data in files.items():
            (tmp_path / f"j{suffix}").write_bytes(
                damaged(data, dice) if suffix == hurt else data
            )
        try:
            with contextlib.closing(Journal(tmp_path / "j")) as found:
                there = whole(found)
        except CorruptStoreError:
            repair(tmp_path / "j")
            with contextlib.closing(Journal(tmp_path / "j")) as found:
                there = whole(found)
        except ArchiveError as error:  # the mark by which it is known
            assert "move it away" in str(error)
            there = []
        lost += N - len(there)
        for path in tmp_path.glob("j*"):
            path.unlink()
    assert (
        lost < 15 * N * (1 if seed < 2 else 2) / 3
    )  # SQLite reads a log up to where it is torn


def test_a_repaired_store_is_not_overwritten_by_the_log_of_the_damaged_one(tmp_path):
    """As a crash leaves it: what is in the log is in the repaired store, and the log
    itself is gone.
    """
    crashed = tmp_path / "crashed"
    crashed.mkdir()
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        found.put("points-0", record(0))
        for path in tmp_path.glob("j*"):
            shutil.copy(path, crashed)
    assert (crashed / "j-wal").stat().st_size
    repair(crashed / "j")
    assert [path.name for path in crashed.iterdir()] == ["j"]
    with contextlib.closing(Journal(crashed / "j")) as found:
        assert whole(found) == [0]


def test_a_disk_too_full_to_mend_on_is_said_and_nothing_lost(tmp_path, monkeypatch):
    filled(tmp_path / "j")

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with (
        monkeypatch.context() as patch,
        pytest.raises(DiskFullError, match="The disk is full"),
    ):
        patch.setattr(os, "replace", full)
        repair(tmp_path / "j")
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        assert whole(found) == list(range(N))


@pytest.mark.parametrize(
    ("full", "error"), [(False, ArchiveError), (True, DiskFullError)]
)
def test_a_log_that_cannot_be_written_is_a_full_disk_only_if_it_is_one(
    tmp_path, monkeypatch, full, error
):
    """A folder that came into its place, say."""
    (tmp_path / "j-wal").mkdir()
    monkeypatch.setattr(file, "is_ours", lambda path: False)
    monkeypatch.setattr(
        file, "shortage", lambda *_: OSError(errno.ENOSPC, "full") if full else None
    )
    with pytest.raises((ArchiveError, DiskFullError)) as raised:
        Journal(tmp_path / "j")
    assert raised.type is error


def test_a_file_of_somebody_else_is_told_and_not_touched(tmp_path):
    """An earlier version's journal, too."""
    sql(
        tmp_path / "j",
        "CREATE TABLE records (id INTEGER PRIMARY KEY)",
        "INSERT INTO records VALUES (1)",
    )
    before = (tmp_path / "j").read_bytes()
    for write in (True, False):
        with pytest.raises(
            ArchiveError,
            match="not a journal of this version of gaitsweep; move it away",
        ):
            Journal(tmp_path / "j", write)
    assert (tmp_path / "j").read_bytes() == before and [
        f.name for f in tmp_path.iterdir()
    ] == ["j"]


def readable_by_others(folder):
    for parent in (folder, *folder.parents):
        if parent.stat().st_uid == os.geteuid() and "pytest-of-" in str(parent):
            parent.chmod(0o755)


def as_somebody_else(call):
    """Exit code of a process of another user that calls a function."""
    if not (child := os.fork()):
        try:
            os.setuid(65534)
            os._exit(call())
        except ArchiveError:
            os._exit(101)
        except BaseException:
            os._exit(102)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
def test_somebody_else_reads_a_store_while_it_is_written(tmp_path):
    """Of a folder where they may not write: what is in the log counts, and nothing is
    called damaged.
    """
    folder = tmp_path / "archive"
    folder.mkdir()
    readable_by_others(folder)

    def known():
        with contextlib.closing(Journal(folder / "j", write=False)) as other:
            return len(whole(other))

    with contextlib.closing(Journal(folder / "j")) as found:
        for k in range(20):
            found.put(f"points-{k}", record(k))
            assert k % 5 or as_somebody_else(known) == k + 1


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
@pytest.mark.parametrize("write", [False, True], ids=["plan", "run"])
def test_who_may_not_write_a_store_leaves_nothing_in_the_way_of_who_may(
    tmp_path, write
):
    """In a folder where both may write; SQLite left a lock file that only the other
    could have written.
    """
    folder = tmp_path / "archive"
    folder.mkdir()
    readable_by_others(folder)
    folder.chmod(0o777)
    filled(folder / "j")
    assert as_somebody_else(lambda: Journal(folder / "j", write).close() or 0) == (
        101 if write else 0
    )
    assert [path.name for path in folder.iterdir()] == ["j"]


def test_reading_a_store_that_is_not_there_makes_none(tmp_path):
    found = Journal(tmp_path / "j", write=False)
    assert not found
    found.close()
    assert not (tmp_path / "j").exists()


def test_a_record_that_no_longer_fits_on_the_disk_is_told_and_the_next_is_kept(
    tmp_path,
):
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        (pages,) = found._execute("PRAGMA page_count")[0]
        found._execute(f"PRAGMA max_page_count={pages + 3}")
        with pytest.raises(DiskFullError, match="The disk is full"):
            found.put("big", Record(b"", bytes(1 << 20)))
        assert "big" not in found
        found.put("small", Record(b"head", b"payload"))
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        assert list(found) == ["small"] and found.get("small") == (b"head", b"payload")


def test_what_is_stored_reaches_the_disk_at_least_every_half_second(
    tmp_path, monkeypatch
):
    times, asked = iter([10.0, 10.1, 10.6, 10.7]), []
    monkeypatch.setattr(journal.time, "monotonic", lambda: next(times))
    with contextlib.closing(Journal(tmp_path / "j")) as found:
        execute = found._execute
        monkeypatch.setattr(
            found,
            "_execute",
            lambda sql, *values: asked.append(sql) or execute(sql, *values),
        )
        for k in range(4):
            found.put(str(k), Record(b"", b""))
    assert [sql[-6:] for sql in asked if "synchronous" in sql] == [
        "s=FULL",
        "NORMAL",
        "s=FULL",
        "NORMAL",
    ]


# Records of chunks.


def points(lines, slopes, gaits=2, seed=0):
    dice, n = np.random.default_rng(seed), lines * slopes
    status = np.full((n, 4), 1, np.int8)
    status[:, :gaits] = 0
    result = {
        "status": status,
        "reason": status.astype(int) + seed,
        "reasons": np.array(["It converged.", "None.", "Another."]),
        "stance_angle": np.where(status == 0, dice.random((n, 4)), np.nan),
        "multiplier_real": np.where(
            status[..., None] == 0, dice.random((n, 4, 3)), np.nan
        ),
        "branch": np.where(status == 0, 2, -1).astype(np.int16),
    }
    want = ("stance_angle", "multiplier_real", "branch", "status")
    return Points.of_task(result, {"want": want, "slope": np.empty(n)}), result


SHAPES = {
    "part of a line": Shape((13, 1), (20, 1), 0),
    "lines, slopes last": Shape((3, 2, 5), (4, 2, 5), 2),
    "lines, slopes between": Shape((3, 5, 2), (3, 5, 4), 1),
    "whole": Shape((6, 5), (6, 5), 0),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_record_gives_back_what_went_in(name):
    shape = SHAPES[name]
    slopes = shape.sizes[shape.slope]
    lines = int(np.prod(shape.sizes)) // slopes
    own, result = points(lines, slopes)
    packed = ChunkCodec(shape, 4, ["long", "short"]).encode(own)
    found, contents = decode(packed), summary(packed.head)
    for key in ("status", "stance_angle", "branch"):
        expected = (
            result[key] if key == "status" else result[key][:, :2]
        )  # without gaits that do not exist
        np.testing.assert_array_equal(found.values[key], expected)
    np.testing.assert_array_equal(
        found.values["multiplier_real"][..., :3], result["multiplier_real"][:, :2]
    )
    assert np.isnan(found.values["multiplier_real"][..., 3]).all()
    texts = np.vectorize(found.sentences.get)(found.values["reason"])
    np.testing.assert_array_equal(texts, result["reasons"][result["reason"]])
    assert contents.rows(range(4)) == {(0, 0, 1, 1): lines * slopes} and contents.rows(
        [0, 2]
    ) == {(0, 1): lines * slopes}
    assert (
        list(contents.sentences([0]).values()) == ["It converged."]
        and len(contents.sentences()) == 2
    )
    assert contents.holds(["branch"], ["long"]) and not contents.holds(
        ["period"], ["long"]
    )
    assert not contents.holds(["branch"], ["other1"])
    piece = contents.piece(memoryview(packed.payload), "stance_angle", 1)
    laid_out = shape.unfold(result["stance_angle"][:, 1].copy())
    assert laid_out.shape == shape.sizes and piece.checksum == zlib.crc32(
        np.ascontiguousarray(laid_out).tobytes()
    )
    assert contents.piece(memoryview(packed.payload), "stance_angle", 2) is None


@pytest.mark.parametrize("name", SHAPES)
def test_points_that_are_kept_are_those_that_are_packed(name):
    shape = SHAPES[name]
    slopes = shape.sizes[shape.slope]
    own, _ = points(int(np.prod(shape.sizes)) // slopes, slopes)

    packed, kept = (
        decode(ChunkCodec(shape, 4, ["long"], is_packed).encode(own))
        for is_packed in (True, False)
    )

    assert packed.sentences == kept.sentences
    for variable, values in packed.values.items():
        gaits, absent = values.shape[1], VARIABLES[variable].absent
        np.testing.assert_array_equal(kept.values[variable][:, :gaits], values)
        np.testing.assert_array_equal(kept.values[variable][:, gaits:], absent)
        assert kept.values[variable].dtype == values.dtype


def test_points_that_failed_have_the_sizes_of_the_others():
    """Those that are kept had no derivatives, instead of absent ones by each key."""
    variables.admit(["speed_by_key"])
    shape = SHAPES["part of a line"]
    names = ("speed_by_key", "multiplier_real", "status", "reason")
    failed = Points.of_ending(
        int(np.prod(shape.sizes)), "raised", "It is wrong.", names
    )

    for is_packed in (True, False):
        found = decode(ChunkCodec(shape, 4, ["long"], is_packed, 15).encode(failed))
        assert found.values["speed_by_key"].shape[2:] == (15,)
        assert found.values["multiplier_real"].shape[2:] == (4,)


def test_points_lie_in_the_grid_as_their_lines_and_slopes_say():
    shape = Shape((3, 5, 2), (3, 5, 2), 1)
    rows = np.arange(30)  # line by line, five slopes each
    laid_out = shape.unfold(rows)
    assert laid_out[2, 3, 1] == (2 * 2 + 1) * 5 + 3
    np.testing.assert_array_equal(shape.fold(laid_out), rows)


def test_parts_are_joined_with_what_each_of_them_has():
    """Of one the worker died, and one has a gait more."""
    one, two = points(1, 4)[0], points(1, 3, gaits=3, seed=1)[0]
    lost = Points.of_ending(2, "worker_died", "The worker died of SIGSEGV.", one.values)
    whole_points = joined([one, lost, two])
    packed = decode(ChunkCodec(Shape((9,), (9,), 0), 3, ["long"]).encode(whole_points))
    assert packed.values["stance_angle"].shape == (
        9,
        3,
    )  # without the gait that none has
    values = whole_points.values
    assert len(whole_points) == 9
    assert values["status"][4:6].tolist() == [[4] * 4] * 2
    assert (
        np.isnan(values["stance_angle"][4:6]).all()
        and (values["branch"][4:6] == -1).all()
    )
    assert (
        np.isnan(values["stance_angle"][:4, 2]).all()
        and not np.isnan(values["stance_angle"][6:, :3]).any()
    )
    said = {
        whole_points.sentences[int(number)] for number in np.unique(values["reason"])
    }
    assert said == {"It converged.", "None.", "The worker died of SIGSEGV.", "Another."}
    some = whole_points.take(np.array([8, 0]))
    np.testing.assert_array_equal(
        some.values["stance_angle"], values["stance_angle"][[8, 0]]
    )


def test_joined_points_have_the_record_of_points_computed_together():
    own, _ = points(1, 20)
    parts = [own.take(np.arange(a, b)) for a, b in ((0, 3), (3, 11), (11, 20))]
    codec = ChunkCodec(Shape((20,), (20,), 0), 3, ["long"])
    assert codec.encode(joined(parts)) == codec.encode(own)


@pytest.mark.parametrize(
    "wrong", [{"stance_angle": np.zeros((3, 4))}, {"branch": np.zeros((4, 3))}]
)
def test_a_result_of_another_shape_is_refused(wrong):
    _, result = points(1, 4)
    with pytest.raises(ValueError, match="has shape"):
        Points.of_task(
            {**result, **wrong}, {"want": tuple(wrong), "slope": np.empty(4)}
        )


def test_a_gait_that_no_point_has_found_keeps_its_branch():
    _, result = points(1, 4)
    result["status"][2, 2], result["branch"][2, 2] = 2, 7  # it has not converged
    own = Points.of_task(
        result, {"want": ("stance_angle", "branch"), "slope": np.empty(4)}
    )
    kept = decode(ChunkCodec(Shape((4,), (4,), 0), 3, ["long"]).encode(own))
    assert kept.values["branch"].shape == (4, 3) and kept.values["branch"][2, 2] == 7


def test_a_result_is_refused_that_is_not_of_all_points():
    _, result = points(1, 4)
    params = {"want": ("stance_angle",), "slope": np.empty(4), "lines": [{}, {}]}
    assert (
        len(Points.of_task([({}, result)] * 2, params))
        == len(Points.of_task([({}, points(2, 4)[1])], params))
        == 8
    )
    with pytest.raises(ValueError, match="4 points are returned of 8"):
        Points.of_task([({}, result)], params)


def test_sentences_have_numbers_of_their_own():
    assert (
        sentence_number("It converged.")
        == sentence_number("It converged.")
        != sentence_number("None.")
    )


def test_points_are_counted_by_a_failure_or_their_best_answer():
    rows = {(0, 1): 3, (1, 1): 2, (0, 4): 1, (3, 1): 5, (8, 2): 1, (0, 77): 2}
    outcomes = {
        "converged": 3,
        "no_gait": 2,
        "worker_died": 1,
        "fell": 5,
        "raised": 1,
        "77": 2,
    }
    assert count(rows, STATUS_NAMES) == outcomes
    assert (
        count_rows(np.repeat(np.array([*rows], np.int8), [*rows.values()], axis=0))
        == rows
    )
    assert count_rows(np.empty((0, 2), np.int8)) == {}
