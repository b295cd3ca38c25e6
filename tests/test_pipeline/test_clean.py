"""`gaitsweep clean` frees what finished studies leave, and nothing that a run goes on
from; commands take studies, archives and folders of either.
"""

import fcntl
import json
import shutil
import signal

import pytest

from conftest import STUDY
from gaitsweep.pipeline.companions import Companions
from processes import companions, wait_for_points

SLOW = {"TOY_SECONDS": "0.02"}
WALKER = '[walker]\nbase = "A"\n'


def test_an_archive_is_one_file_and_its_companions_are_out_of_sight(toy):
    toy("run", "toy.toml")
    folder = toy.folder / "data" / "archive"
    assert {path.name for path in folder.iterdir()} == {"toy.nc", ".gaitsweep"}
    assert {path.name for path in (folder / ".gaitsweep").iterdir()} == {
        "README",
        "toy.journal",
        "toy.lock",
        "toy.events.jsonl",
        "toy.run.json",
    }


def test_companions_may_be_deleted_when_no_run_is_in_flight(toy, whole):
    toy("run", "toy.toml")
    shutil.rmtree(companions(toy).folder)
    toy("verify", "data/archive/toy.nc")
    toy("run", "toy.toml")
    assert toy.bytes() == whole


def test_the_journal_of_a_finished_study_is_removed_and_its_size_said(toy, whole):
    toy("run", "toy.toml")
    size = companions(toy).journal.stat().st_size

    said = toy("clean").stdout

    freed = f"{size / 1e3:,.1f} kB" if size < 1e5 else f"{size / 1e6:,.1f} MB"
    assert said.splitlines() == [
        f"data/archive/toy.nc: journal removed, {freed}.",
        f"Journals: 1 removed, {freed} freed.",
    ]
    assert not list(companions(toy).folder.glob("*.journal*"))
    assert companions(toy).record.exists() and toy.bytes() == whole
    assert "finished" in toy("status").stdout

    assert toy("clean").stdout == "Journals: none removed.\n"
    toy("run", "toy.toml")
    assert toy.bytes() == whole


def test_an_unfinished_study_keeps_its_journal_and_is_named(toy, whole):
    """Also if an archive of an earlier run of it is complete."""
    toy.write(STUDY.replace("n = 200", "n = 20"))
    toy("run", "toy.toml")
    toy.write(STUDY)
    process = toy.start("run", "toy.toml", "--chunk", "10", **SLOW)
    wait_for_points(toy, 3)
    process.send_signal(signal.SIGKILL)
    process.wait()

    (said, total) = toy("clean").stdout.splitlines()

    assert said.startswith("data/archive/toy.nc: journal kept: its study is not finish")
    assert total == "Journals: none removed; 1 kept."
    kept = companions(toy).events.read_text().count('"chunk"')
    toy("run", "toy.toml", "--chunk", "10")
    again = companions(toy).events.read_text().count('"chunk"') - kept
    assert 0 < again < 20 and toy.bytes() == whole


def test_a_journal_whose_archive_is_gone_or_damaged_is_kept(toy):
    toy("run", "toy.toml")
    data = companions(toy).archive.read_bytes()
    for content in (None, data[: len(data) // 2]):
        if content is None:
            companions(toy).archive.unlink()
        else:
            companions(toy).archive.write_bytes(content)
        assert "its archive is missing or not complete" in toy("clean").stdout
        assert companions(toy).journal.exists()


def test_a_journal_that_a_run_holds_is_kept_and_who_holds_it_named(toy):
    toy("run", "toy.toml")
    with companions(toy).lock.open("r+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        said = toy("clean", "toy.toml").stdout
    assert "toy.nc: journal kept: data/archive/toy.nc is held by another run" in said
    assert companions(toy).journal.exists()
    toy("clean", "toy.toml")
    assert not companions(toy).journal.exists()


def test_clean_answers_machines_and_goes_on_after_what_is_wrong(toy):
    text = STUDY.replace("n = 200", "n = 20")
    for name in ("a", "b", "c"):
        toy.write(text.replace('"toy"', f'"{name}"'), f"{name}.toml")
    toy("run", "a.toml", "b.toml", "c.toml")
    archives = toy.folder / "data" / "archive"
    foreign = Companions(archives / "b.nc").journal
    foreign.write_text("mine")

    done = toy("clean", "--json", "none.toml", "data/archive", expect=2)

    assert [line["archive"] for line in json.loads(done.stdout)] == [
        "data/archive/a.nc",
        "data/archive/c.nc",
    ]
    assert all(
        line["freed"] > 0 and not line["kept"] for line in json.loads(done.stdout)
    )
    assert "There is no file none.toml" in done.stderr
    assert "b.journal is not a journal" in done.stderr
    assert foreign.read_text() == "mine"


def test_states_are_those_of_studies_archives_and_folders(toy):
    (toy.folder / "studies").mkdir()
    toy.write(STUDY, "studies/toy.toml")
    toy.write(WALKER, "studies/walker.toml")
    toy("run", "toy.toml")
    finished = toy("status", "data/archive/toy.nc").stdout
    assert finished.startswith("data/archive/toy.nc: finished: ")
    for name in ("toy.toml", "studies", "data/archive"):
        assert toy("status", name).stdout == finished
    assert toy("status", "studies", "toy.toml", "data/archive").stdout == finished

    (toy.folder / "empty").mkdir()
    done = toy("status", "empty", "data/archive", expect=2)
    assert done.stdout == finished
    assert "no study (*.toml) in the folder empty" in done.stderr


@pytest.mark.parametrize(("command", "others"), [("status", 1), ("clean", 0)])
def test_an_archive_that_is_not_there_is_an_error(toy, command, others):
    (toy.folder / "a.nc").touch()
    for name in ("none.nc", "none/none.nc", f"{'n' * 300}.nc"):
        done = toy(command, name, expect=2)

        assert done.stdout == ""
        (line,) = done.stderr.splitlines()
        assert line.startswith(f"gaitsweep: There is no archive {name[:100]}")
        assert line.endswith(", and no record of its run.")

    done = toy(command, "none.nc", "a.nc", expect=2)
    assert len(done.stdout.splitlines()) == others
    assert "There is no archive none.nc" in done.stderr


def test_a_run_that_has_no_archive_yet_has_a_state(toy):
    process = toy.start("run", "toy.toml", "--archive", "out/x.nc", **SLOW)
    log = Companions(toy.folder / "out" / "x.nc").events
    while process.poll() is None and not (log.exists() and log.read_text()):
        pass
    assert "out/x.nc: running as process" in toy("status", "out").stdout
    process.send_signal(signal.SIGTERM)
    process.wait()


def test_a_walker_among_studies_is_passed_over_with_a_line(toy, whole):
    (toy.folder / "studies").mkdir()
    toy.write(STUDY, "studies/toy.toml")
    toy.write(WALKER, "studies/walker.toml")
    skipped = "studies/walker.toml holds a walker and no study; it is skipped.\n"

    done = toy("plan", "studies")
    assert done.stderr == skipped and done.stdout.startswith("toy: ")
    done = toy("run", "studies")
    assert done.stderr.startswith(skipped) and "not run to the end" not in done.stderr
    assert toy.bytes() == whole

    toy.write(WALKER, "studies/toy.toml")
    for command in ("plan", "run"):
        assert "none a study" in toy(command, "studies", expect=2).stderr
        said = toy(command, "studies/walker.toml", expect=2).stderr
        assert "This file holds a walker and no study" in said


def test_a_wrong_study_does_not_keep_others_from_being_planned(toy):
    toy("run", "toy.toml")
    toy.write("nonsense = 1", "wrong.toml")
    toy.write(STUDY.replace('"toy"', '"foreign"'), "foreign.toml")
    Companions(toy.folder / "data" / "archive" / "foreign.nc").journal.write_text(
        "mine"
    )

    done = toy("plan", "wrong.toml", "foreign.toml", "toy.toml", expect=2)

    assert "Unknown key `nonsense`" in done.stderr
    assert "foreign.journal is not a journal" in done.stderr
    assert done.stdout.startswith("toy: ") and "nothing to do" in done.stdout
    (plan,) = json.loads(
        toy("plan", "--json", "wrong.toml", "toy.toml", expect=2).stdout
    )
    assert plan["study"] == "toy" and plan["cached"] == 400


def test_many_archives_are_verified_and_the_gravest_code_is_that_of_all(toy):
    toy("run", "toy.toml")
    archive = toy.folder / "data" / "archive" / "toy.nc"
    shutil.copy(archive, toy.folder / "whole.nc")
    (toy.folder / "cut.nc").write_bytes(archive.read_bytes()[:-1000])

    both = toy("verify", "whole.nc", "data/archive/toy.nc").stdout.splitlines()
    assert [line.split()[0] for line in both] == ["whole.nc", "data/archive/toy.nc"]
    done = toy("verify", "cut.nc", "whole.nc", expect=1).stdout
    assert "cut.nc" in done and "whole.nc is intact" in done
    done = toy("verify", "none.nc", "cut.nc", "whole.nc", expect=2)
    assert (
        "There is no archive none.nc" in done.stderr
        and "whole.nc is int" in done.stdout
    )

    found = json.loads(toy("verify", "--json", "cut.nc", "whole.nc", expect=1).stdout)
    assert [(each["archive"], each["valid"]) for each in found] == [
        ("cut.nc", False),
        ("whole.nc", True),
    ]
    assert json.loads(toy("verify", "--json", "whole.nc").stdout) == found[1]
