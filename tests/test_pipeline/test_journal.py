"""The journal gives back what was written, or says that it is torn."""

import os
import sqlite3

import numpy as np
import pytest

from pipeline import gather, pack
from pipeline.compact import compact
from pipeline.errors import ArchiveError
from pipeline.journal import Journal, Result, TornError, mend

WANT = gather.needed(["stance_angle"], ["long"])


def row(slopes, value, status=0):
    n = len(slopes)
    states = {"status": np.full((n, 4), status, np.int8), "reason": np.zeros((n, 4), np.int16),
              "reasons": np.array([f"reason {value}"])}
    return slopes.tobytes(), pack.dump(states), pack.dump({"stance_angle": np.full((n, 1), value)})


def reopened(path):
    """A journal as the next run has it."""
    try:
        return Journal(path)
    except TornError:
        mend(path)
        return Journal(path)


@pytest.fixture
def journal(tmp_path):
    found = Journal(tmp_path / "j")
    yield found
    found.close()


def values(journal, slopes):
    status, _, _, sources = gather.states(journal, "L", WANT, slopes)
    return status[:, 0], gather.fill(journal, ["stance_angle"], sources, len(slopes), 3)["stance_angle"][:, 0]


def test_points_are_found_whatever_the_blocks_and_the_latest_counts(journal):
    slopes = np.linspace(0.1, 0.4, 7)
    journal.add_points("L", "k", WANT, row(slopes[[5, 1, 3]], 1.0), 0.1)
    journal.add_points("L", "k", WANT, row(slopes[3:4], 2.0), 0.1)
    journal.add_points("M", "k", WANT, row(slopes, 3.0), 0.1)
    journal.add_points("L", "k", ["stance_angle"], row(slopes, 4.0), 0.1)  # without the gait that is wanted
    assert gather.missing(journal, "L", WANT, slopes).tolist() == [0, 2, 4, 6]
    status, found = values(journal, slopes[::-1])
    np.testing.assert_array_equal(found, [np.nan, 1, np.nan, 2, np.nan, 1, np.nan])
    np.testing.assert_array_equal(status, [7, 0, 7, 0, 7, 0, 7])


def test_failed_points_are_missing_only_to_a_retry(journal):
    slopes = np.array([0.1, 0.2])
    journal.add_points("L", "k", WANT, row(slopes, 1.0, status=4), 0.1)
    assert gather.missing(journal, "L", WANT, slopes, ["long"]).tolist() == []
    assert gather.missing(journal, "L", WANT, slopes, ["long"], retry=True).tolist() == [0, 1]


def test_results_are_kept_by_key_and_kin(journal):
    journal.add_result("a-1", "a", Result("ok", "", 0, b"x"), 0.1)
    journal.add_result("a-1", "a", Result("raised", "It raised.", 3, b""), 0.1)
    assert journal.result("a-1") == Result("raised", "It raised.", 3, b"")
    assert journal.outcome("a-1") == ("raised", "It raised.", 3)
    assert journal.knows("a") and not journal.knows("b") and journal.result("b") is None


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
    with pytest.raises(TornError):
        values(journal, slopes)
    journal.close()
    mend(tmp_path / "j")
    journal = Journal(tmp_path / "j")
    assert gather.missing(journal, "L", WANT, slopes).tolist() == list(range(2, 4000, 4))
    journal.close()


@pytest.mark.parametrize("part", np.linspace(0, 1, 12))
def test_a_journal_cut_anywhere_keeps_its_beginning(tmp_path, part):
    slopes = np.linspace(0.1, 0.4, 20000)
    journal = Journal(tmp_path / "j")
    for k in range(40):
        journal.add_points("L", "k", WANT, row(slopes[500 * k:500 * (k + 1)], float(k)), 0.1)
    journal.close()
    size = os.path.getsize(tmp_path / "j")
    os.truncate(tmp_path / "j", int(part * size))
    journal = reopened(tmp_path / "j")
    kept = 20000 - len(gather.missing(journal, "L", WANT, slopes))
    assert kept >= 20000 * part - 2500
    journal.close()


def test_a_database_with_other_tables_is_foreign(tmp_path):
    with sqlite3.connect(tmp_path / "j") as db:
        db.execute("CREATE TABLE points (id)")
    db.close()
    with pytest.raises(ArchiveError, match="not a journal of this version"):
        Journal(tmp_path / "j")


def test_reading_a_journal_that_is_not_there_makes_none(tmp_path):
    journal = Journal(tmp_path / "j", write=False)
    assert journal.empty()
    journal.close()
    assert not (tmp_path / "j").exists()


def test_small_blocks_are_put_together_and_nothing_changes(journal):
    slopes = np.linspace(0.1, 0.4, 300)
    for k in range(300):
        journal.add_points("L", "k", WANT, row(slopes[k:k + 1], float(k), status=0 if k % 7 else 4), 0.1)
    journal.add_points("L", "k", WANT, row(slopes[7:8], -7.0), 0.1)
    before, last = values(journal, slopes), journal.last_block("L")
    compact(journal)
    assert len(list(journal.blocks("L"))) == 1 and journal.last_block("L") == last
    for one, two in zip(before, values(journal, slopes), strict=True):
        np.testing.assert_array_equal(one, two)
    _, reason, sentences, _ = gather.states(journal, "L", WANT, slopes)
    assert [sentences[r] for r in reason[[6, 7, 8], 0]] == ["reason 6.0", "reason -7.0", "reason 8.0"]
