"""The journal gives back what was written, or says that it is torn."""

import contextlib
import errno
import os
import random
import shutil
import sqlite3

import numpy as np
import pytest

from pipeline import serialize
from pipeline.errors import ArchiveError, DiskFullError
from pipeline.store import journal_file, lines
from pipeline.store.compact import compact
from pipeline.store.journal import Journal
from pipeline.store.journal_file import CorruptJournalError, forget, repair
from pipeline.store.rows import Result
from processes import damaged

WANT = lines.needed(["stance_angle"], ["long"])
PACKED = serialize.dump({"x": 1})


def row(slopes, value, status=0):
    n = len(slopes)
    states = {
        "status": np.full((n, 4), status, np.int8),
        "reason": np.zeros((n, 4), np.int16),
        "reasons": np.array([f"reason {value}"]),
    }
    return slopes.tobytes(), serialize.dump(states), serialize.dump({"stance_angle": np.full((n, 1), value)})


def reopened(path):
    """A journal as the next run has it."""
    try:
        return Journal(path)
    except CorruptJournalError:
        repair(path)
        return Journal(path)


@pytest.fixture
def journal(tmp_path):
    found = Journal(tmp_path / "j")
    yield found
    found.close()


def values(journal, slopes):
    status, _, _, sources = lines.states(journal, "L", WANT, slopes)
    return status[:, 0], lines.fill(journal, ["stance_angle"], sources, len(slopes), 3)["stance_angle"][:, 0]


def test_points_are_found_whatever_the_blocks_and_the_latest_counts(journal):
    slopes = np.linspace(0.1, 0.4, 7)
    journal.add_points("L", "k", WANT, row(slopes[[5, 1, 3]], 1.0), 0.1)
    journal.add_points("L", "k", WANT, row(slopes[3:4], 2.0), 0.1)
    journal.add_points("M", "k", WANT, row(slopes, 3.0), 0.1)
    journal.add_points("L", "k", ["stance_angle"], row(slopes, 4.0), 0.1)  # without the gait that is wanted
    assert lines.missing(journal, "L", WANT, slopes).tolist() == [0, 2, 4, 6]
    status, found = values(journal, slopes[::-1])
    np.testing.assert_array_equal(found, [np.nan, 1, np.nan, 2, np.nan, 1, np.nan])
    np.testing.assert_array_equal(status, [7, 0, 7, 0, 7, 0, 7])


def test_a_journal_is_forgotten_with_all_its_files_and_another_file_is_not(tmp_path):
    path, other = tmp_path / "j", tmp_path / "other"
    Journal(path).close()
    assert path.exists()
    forget(path)
    assert not list(tmp_path.iterdir())
    other.write_text("not ours")
    with pytest.raises(ArchiveError, match="move it away"):
        forget(other)
    assert other.read_text() == "not ours"


def test_a_line_without_blocks_has_no_ranges(journal):
    numbers, low, high = journal.ranges("none")
    assert numbers.dtype == int and len(numbers) == len(low) == len(high) == 0


def test_failed_points_are_missing_only_to_a_retry(journal):
    slopes = np.array([0.1, 0.2])
    journal.add_points("L", "k", WANT, row(slopes, 1.0, status=4), 0.1)
    assert lines.missing(journal, "L", WANT, slopes, ["long"]).tolist() == []
    assert lines.missing(journal, "L", WANT, slopes, ["long"], retry=True).tolist() == [0, 1]


def test_the_cost_of_a_point_is_the_mean_over_long_lines_once_enough_are_stored(journal):
    slopes = np.linspace(0.1, 0.3, 750)
    for line, seconds in (("L", 0.6), ("block-1", 90.0)):  # of short lines, whose atlases it includes
        assert journal.seconds_per_point() is None
        journal.add_points(line, "k", WANT, row(slopes, 1.0), seconds)
    assert journal.seconds_per_point() is None
    journal.add_points("M", "k", WANT, row(slopes[:250], 1.0), 0.4)
    assert journal.seconds_per_point() == pytest.approx(1e-3)


def test_results_are_kept_by_key_and_kin(journal):
    journal.add_result("a-1", "a", Result("ok", "", 0, PACKED), 0.1)
    journal.add_result("a-1", "a", Result("raised", "It raised.", 3, b""), 0.1)
    assert journal.result("a-1") == Result("raised", "It raised.", 3, b"")
    journal.add_result("c-1", "c", Result("ok", "", 0, b"no packed result"), 0.1)
    with pytest.raises(CorruptJournalError):
        journal.result("c-1")
    assert journal.outcome("a-1") == ("raised", "It raised.", 3)
    assert journal.knows("a") and not journal.knows("b") and journal.result("b") is None


def test_a_result_is_outdated_by_later_ones_that_it_needs(journal):
    for key in ("atlas-1", "landmarks-1", "trace-1"):
        journal.add_result(key, key, Result("ok", "", 0, PACKED), 0.1)
    assert not journal.is_outdated("landmarks-1", ["atlas"]) and journal.is_outdated("atlas-1", ["atlas", "trace"])
    journal.add_result("atlas-1", "atlas", Result("ok", "", 0, PACKED), 0.1)
    assert journal.is_outdated("landmarks-1", ["atlas"]) and not journal.is_outdated("trace-1", ["points"])


def test_a_flipped_byte_is_seen_and_mended(tmp_path):
    slopes = np.linspace(0.1, 0.4, 4000)
    journal = Journal(tmp_path / "j")
    for k in range(4):
        journal.add_points("L", "k", WANT, row(slopes[k::4], float(k)), 0.1)
    journal.close()
    data = bytearray((tmp_path / "j").read_bytes())
    at = data.index(np.full(99, 2.0).tobytes())
    data[at] ^= 1
    (tmp_path / "j").write_bytes(data)
    journal = Journal(tmp_path / "j")
    with pytest.raises(CorruptJournalError):
        values(journal, slopes)
    journal.close()
    repair(tmp_path / "j")
    journal = Journal(tmp_path / "j")
    assert lines.missing(journal, "L", WANT, slopes).tolist() == list(range(2, 4000, 4))
    journal.close()


@pytest.mark.parametrize("part", np.linspace(0, 1, 12))
def test_a_journal_cut_anywhere_keeps_its_beginning(tmp_path, part):
    slopes = np.linspace(0.1, 0.4, 20000)
    journal = Journal(tmp_path / "j")
    for k in range(40):
        journal.add_points("L", "k", WANT, row(slopes[500 * k : 500 * (k + 1)], float(k)), 0.1)
    journal.close()
    size = os.path.getsize(tmp_path / "j")
    os.truncate(tmp_path / "j", int(part * size))
    journal = reopened(tmp_path / "j")
    kept = 20000 - len(lines.missing(journal, "L", WANT, slopes))
    assert kept >= 20000 * part - 2500
    journal.close()


def test_whole_numbers_keep_what_stands_for_no_gait_when_blocks_are_put_together(journal):
    slopes = np.linspace(0.1, 0.4, 300)
    want = lines.needed(["branch"], ["long"])
    for k in range(300):
        # Some blocks have one gait, some two, and one was lost with its worker.
        data = serialize.dump({"branch": np.zeros((1, 1 + k % 2), np.int16)} if k != 5 else {})
        journal.add_points("L", "k", want, (*row(slopes[k : k + 1], 0.0)[:2], data), 0.1)
    expected = np.full((300, 3), -1)
    expected[:, 0], expected[1::2, 1], expected[5] = 0, 0, -1
    for _ in range(2):
        sources = lines.states(journal, "L", want, slopes)[3]
        np.testing.assert_array_equal(lines.fill(journal, ["branch"], sources, 300, 3, gaits=3)["branch"], expected)
        compact(journal)
    assert len(list(journal.blocks("L"))) == 1


def sql(path, *statements):
    """What somebody else does to a journal."""
    with contextlib.closing(sqlite3.connect(path)) as db:
        for statement in statements:
            db.execute(statement)
        db.commit()


#: How the columns of a row may be damaged; what a row holds beside its checksums.
OTHER = {
    "id": "id + 40",
    "n": "n + 1",
    "seen": "9",
    "low": "low / 2",
    "high": "'x'",
    "seconds": "seconds + 1",
    "kin": "'other'",
    "line": "'M'",
    "key": "'other'",
    "variables": "CAST(x'ff' AS TEXT)",
    "outcome": "'raised'",
    "reason": "CAST(x'c328' AS TEXT)",
    "slopes": "zeroblob(length(slopes))",
    "states": "x'00'",
    "data": "NULL",
    "sum": "sum + 1",
    "data_sum": "NULL",
}


@pytest.mark.parametrize(
    ("table", "column"),
    [
        *(
            ("points", c)
            for c in (
                "id",
                "line",
                "kin",
                "variables",
                "low",
                "high",
                "n",
                "seconds",
                "data_sum",
                "sum",
                "slopes",
                "states",
                "data",
            )
        ),
        *(("results", c) for c in ("key", "kin", "outcome", "reason", "seen", "seconds", "data_sum", "sum", "data")),
    ],
)
def test_whatever_is_damaged_in_a_row_costs_that_row_alone(tmp_path, table, column):
    slopes = np.linspace(0.1, 0.4, 9)
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        for k in range(3):
            journal.add_points("L", "k", WANT, row(slopes[k::3], float(k)), 0.1)
            journal.add_result(f"r{k}", "r", Result("ok", "none", k, PACKED), 0.1)
    sql(tmp_path / "j", f"UPDATE {table} SET {column} = {OTHER[column]} WHERE id = 2")

    def read(journal):
        found = values(journal, slopes)[1], [journal.result(f"r{k}") for k in range(3)]
        return found[0][[0, 2]].tolist(), np.isnan(found[0][1::3]).all(), found[1]

    if (table, column) not in (("points", "line"), ("results", "key")):  # which are not found, and so not read
        with pytest.raises(CorruptJournalError), contextlib.closing(Journal(tmp_path / "j")) as journal:
            read(journal)
    repair(tmp_path / "j")
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        rest, lost, results = read(journal)
    assert rest == [0, 2] and lost == (table == "points")
    assert results == [Result("ok", "none", k, PACKED) if k != 1 or table == "points" else None for k in range(3)]


def test_mending_keeps_every_whole_row_whatever_gaps_there_are(tmp_path):
    slopes = np.linspace(0.1, 0.4, 5200)
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        for k in range(5200):
            journal.add_points("L", "k", WANT, row(slopes[k : k + 1], float(k)), 0.1)
        journal.add_result("a", "a", Result("ok", "", 0, PACKED), 0.1)
        compact(journal)
        assert journal.last_block("L") == 5200
    sql(tmp_path / "j", "UPDATE results SET data = x'00'")
    repair(tmp_path / "j")
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        np.testing.assert_array_equal(values(journal, slopes)[1], np.arange(5200))
        assert journal.result("a") is None and journal.last_block("L") == 5200


@pytest.mark.parametrize("where", [slice(0, 16), slice(16, 100), slice(100, 4096)])
def test_a_damaged_first_page_costs_no_row(tmp_path, where):
    slopes = np.linspace(0.1, 0.4, 200)
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        for k in range(50):
            journal.add_points("L", "k", WANT, row(slopes[k::50], float(k)), 0.1)
    data = bytearray((tmp_path / "j").read_bytes())
    data[where] = bytes(len(data[where]))
    (tmp_path / "j").write_bytes(data)
    with contextlib.closing(reopened(tmp_path / "j")) as journal:
        assert not len(lines.missing(journal, "L", WANT, slopes))


def test_an_index_that_hides_rows_is_seen_before_anything_is_computed(tmp_path):
    slopes = np.linspace(0.1, 0.4, 40)
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        for k in range(20):
            journal.add_points("the line", "k", WANT, row(slopes[k::20], float(k)), 0.1)
    data = (tmp_path / "j").read_bytes()
    pages = [data[k : k + 4096] for k in range(0, len(data), 4096)]
    (index,) = (k for k, page in enumerate(pages) if page[0] == 10 and b"the line" in page)
    pages[index] = pages[index].replace(b"the line", b"the lime", 12)
    (tmp_path / "j").write_bytes(b"".join(pages))
    with pytest.raises(CorruptJournalError):
        Journal(tmp_path / "j")
    repair(tmp_path / "j")
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        assert not len(lines.missing(journal, "the line", WANT, slopes))


@pytest.mark.parametrize("seed", range(4))
def test_what_a_damaged_journal_gives_is_what_was_written(tmp_path, seed):
    """At a random place, in the file or the log beside it, before and after rows were put together."""
    dice, slopes, lost = random.Random(seed), np.linspace(0.1, 0.4, 600), 0
    journal = Journal(tmp_path / "whole")
    for k in range(300):
        journal.add_points("L", "k", WANT, row(slopes[2 * k : 2 * k + 2], float(k)), 0.1)
        if k == 200 and seed % 2:
            compact(journal)
    files = {suffix: (tmp_path / f"whole{suffix}").read_bytes() for suffix in ("", "-wal")}
    journal.close()
    if seed < 2:
        files = {"": (tmp_path / "whole").read_bytes()}
    for _ in range(15):
        hurt = dice.choice([suffix for suffix in files if files[suffix]])
        for suffix, data in files.items():
            (tmp_path / f"j{suffix}").write_bytes(damaged(data, dice) if suffix == hurt else data)
        try:
            with contextlib.closing(Journal(tmp_path / "j")) as journal:
                found = values(journal, slopes)[1]
        except CorruptJournalError:
            repair(tmp_path / "j")
            with contextlib.closing(Journal(tmp_path / "j")) as journal:
                found = values(journal, slopes)[1]
        there = ~np.isnan(found)
        np.testing.assert_array_equal(found[there], np.arange(600)[there] // 2)
        lost += np.count_nonzero(~there)
        for file in tmp_path.glob("j*"):
            file.unlink()
    assert lost < 15 * 600 * (1 if seed < 2 else 2) / 3  # SQLite reads a log up to where it is torn


def test_a_repaired_journal_is_not_overwritten_by_the_log_of_the_damaged_one(tmp_path):
    """As a crash leaves it: what is in the log is in the repaired journal, and the log itself is gone."""
    slopes, crashed = np.linspace(0.1, 0.4, 9), tmp_path / "crashed"
    crashed.mkdir()
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        journal.add_points("L", "k", WANT, row(slopes, 1.0), 0.1)
        for file in tmp_path.glob("j*"):
            shutil.copy(file, crashed)
    assert (crashed / "j-wal").stat().st_size
    repair(crashed / "j")
    assert [f.name for f in crashed.iterdir()] == ["j"]
    with contextlib.closing(Journal(crashed / "j")) as journal:
        np.testing.assert_array_equal(values(journal, slopes), (np.zeros(9), np.ones(9)))


def test_a_disk_too_full_to_mend_on_is_said_and_nothing_lost(tmp_path, monkeypatch):
    slopes = np.linspace(0.1, 0.4, 9)
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        journal.add_points("L", "k", WANT, row(slopes, 1.0), 0.1)

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch, pytest.raises(DiskFullError, match="The disk is full"):
        patch.setattr(os, "replace", full)
        repair(tmp_path / "j")
    assert [f.name for f in tmp_path.iterdir()] == ["j"]
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        assert not len(lines.missing(journal, "L", WANT, slopes))


@pytest.mark.parametrize(("full", "error"), [(False, ArchiveError), (True, DiskFullError)])
def test_a_log_that_cannot_be_written_is_a_full_disk_only_if_it_is_one(tmp_path, monkeypatch, full, error):
    """A folder that came into its place, say."""
    (tmp_path / "j-wal").mkdir()
    monkeypatch.setattr(journal_file, "is_ours", lambda path: False)
    monkeypatch.setattr(journal_file, "shortage", lambda *_: OSError(errno.ENOSPC, "full") if full else None)
    with pytest.raises((ArchiveError, DiskFullError)) as raised:
        Journal(tmp_path / "j")
    assert raised.type is error


def test_a_file_of_somebody_else_is_told_and_not_touched(tmp_path):
    """An earlier version's journal, too."""
    sql(
        tmp_path / "j",
        "CREATE TABLE points (id INTEGER PRIMARY KEY AUTOINCREMENT, line TEXT)",
        "CREATE TABLE notes (key TEXT PRIMARY KEY, value TEXT)",
        "INSERT INTO notes VALUES ('a', 'b')",
    )
    before = (tmp_path / "j").read_bytes()
    for write in (True, False):
        with pytest.raises(ArchiveError, match="not a journal of this version of gaitsweep; move it away"):
            Journal(tmp_path / "j", write)
    assert (tmp_path / "j").read_bytes() == before and [f.name for f in tmp_path.iterdir()] == ["j"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
def test_somebody_else_reads_a_journal_while_it_is_written(tmp_path):
    """Of a folder where they may not write: what is in the log counts, and nothing is called damaged."""
    slopes, folder = np.linspace(0.1, 0.4, 400), tmp_path / "archive"
    folder.mkdir()
    for parent in (folder, *folder.parents):
        if parent.stat().st_uid == os.geteuid() and "pytest-of-" in str(parent):
            parent.chmod(0o755)
    with contextlib.closing(Journal(folder / "j")) as journal:
        for k in range(40):
            journal.add_points("L", "k", WANT, row(slopes[10 * k : 10 * k + 10], float(k)), 0.1)
            if k % 10:
                continue
            if not (child := os.fork()):
                try:
                    os.setuid(65534)
                    with contextlib.closing(Journal(folder / "j", write=False)) as other:
                        known = 400 - len(lines.missing(other, "L", WANT, slopes))
                    os._exit(0 if known == 10 * k + 10 else 1)
                except BaseException:
                    os._exit(2)
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
@pytest.mark.parametrize("write", [False, True], ids=["plan", "run"])
def test_who_may_not_write_a_journal_leaves_nothing_in_the_way_of_who_may(tmp_path, write):
    """In a folder where both may write; SQLite left a lock file that only the other could have written."""
    folder = tmp_path / "archive"
    folder.mkdir()
    for parent in (folder, *folder.parents):
        if parent.stat().st_uid == os.geteuid() and "pytest-of-" in str(parent):
            parent.chmod(0o755 if parent != folder else 0o777)
    with contextlib.closing(Journal(folder / "j")) as journal:
        journal.add_points("L", "k", WANT, row(np.array([0.1]), 0.0), 0.1)
    if not (child := os.fork()):
        try:
            os.setuid(65534)
            Journal(folder / "j", write).close()
            os._exit(0)
        except ArchiveError:
            os._exit(1)
        except BaseException:
            os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == write
    assert [file.name for file in folder.iterdir()] == ["j"]


def test_reading_a_journal_that_is_not_there_makes_none(tmp_path):
    journal = Journal(tmp_path / "j", write=False)
    assert journal.empty()
    journal.close()
    assert not (tmp_path / "j").exists()


def test_small_blocks_are_put_together_and_nothing_changes(journal):
    slopes = np.linspace(0.1, 0.4, 300)
    for k in range(300):
        journal.add_points("L", "k", WANT, row(slopes[k : k + 1], float(k), status=0 if k % 7 else 4), 0.1)
    journal.add_points("L", "k", WANT, row(slopes[7:8], -7.0), 0.1)
    before, last = values(journal, slopes), journal.last_block("L")
    compact(journal)
    assert len(list(journal.blocks("L"))) == 1 and journal.last_block("L") == last
    for one, two in zip(before, values(journal, slopes), strict=True):
        np.testing.assert_array_equal(one, two)
    _, reason, sentences, _ = lines.states(journal, "L", WANT, slopes)
    assert [sentences[r] for r in reason[[6, 7, 8], 0]] == ["reason 6.0", "reason -7.0", "reason 8.0"]
