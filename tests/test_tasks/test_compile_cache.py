"""Machine code is executed only from a folder that nobody else can change."""

import contextlib
import logging
import os
import sqlite3
import stat
import sys
import types
from pathlib import Path

import pytest

from gaitsweep.tasks.mechanics import compile_cache

ME, OTHER = os.geteuid(), 54321


def found(mode, owner=ME, group=OTHER):
    return os.stat_result((mode, 0, 0, 1, owner, group, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("status", "is_shared"),
    [
        (found(stat.S_IFDIR | 0o700), False),
        (found(stat.S_IFDIR | 0o755), False),
        (found(stat.S_IFREG | 0o644, owner=0), False),  # root may do anything anyhow
        (found(stat.S_IFREG | 0o600, owner=OTHER), True),
        (found(stat.S_IFDIR | 0o775), True),
        (found(stat.S_IFDIR | 0o757), True),
        (found(stat.S_IFREG | 0o666), True),
        (found(stat.S_IFLNK | 0o777), True),
    ],
)
def test_who_else_may_change_a_file_is_told_by_its_owner_and_mode(status, is_shared):
    assert compile_cache.is_shared(status) == is_shared


@pytest.mark.parametrize(
    ("name", "members", "is_shared"),
    [("me", ["me"], False), ("me", ["x"], True), ("x", [], True)],
)
def test_a_group_of_the_user_alone_is_the_user(monkeypatch, name, members, is_shared):
    monkeypatch.setattr(
        compile_cache.grp,
        "getgrgid",
        lambda number: compile_cache.grp.struct_group((name, "", 7, members)),
    )
    me = compile_cache.pwd.struct_passwd(("me", "", ME, 7, "", "", ""))
    monkeypatch.setattr(compile_cache.pwd, "getpwuid", lambda number: me)
    assert compile_cache.is_shared(found(stat.S_IFDIR | 0o775, group=7)) == is_shared
    assert compile_cache.is_shared(found(stat.S_IFDIR | 0o777, group=7))


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache in `home/cache` of this user, with a file in it."""
    folder = tmp_path / "home" / "cache"
    folder.mkdir(parents=True)
    (folder / "cache.db").touch()
    monkeypatch.setenv("GAITSWEEP_CACHE", str(folder))
    return folder


def in_the_place(path, make):
    path.unlink()
    make(path)


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        (lambda c: None, ""),
        (
            lambda c: c.parent.chmod(0o1777),
            "",
        ),  # as in /tmp, where nobody else can replace the folder
        (lambda c: c.parent.chmod(0o777), "home"),
        (lambda c: c.chmod(0o1777), "home/cache"),
        (lambda c: (c / "cache.db").chmod(0o666), "home/cache/cache.db"),
        (lambda c: in_the_place(c / "cache.db", os.mkfifo), "home/cache/cache.db"),
        (
            lambda c: in_the_place(c / "cache.db", lambda p: p.symlink_to(c / "other")),
            "home/cache/cache.db",
        ),
        (lambda c: (c / "checksums.db-wal").mkdir(), "home/cache/checksums.db-wal"),
    ],
)
def test_a_cache_that_others_may_change_is_not_used_and_named_once(
    tmp_path, cache, caplog, change, culprit
):
    change(cache)
    with caplog.at_level(logging.WARNING):
        assert (
            compile_cache.usable_folder()
            == compile_cache.usable_folder()
            == (None if culprit else cache)
        )
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == bool(culprit) and all(
        f"not used: {tmp_path / culprit} is" in line for line in said
    )


def test_a_cache_of_another_user_is_not_used(cache, monkeypatch):
    if ME == 0:
        os.chown(cache, OTHER, OTHER)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: ME + 1)
    assert compile_cache.usable_folder() is None


def test_links_to_a_cache_are_followed_once(cache, tmp_path, monkeypatch):
    """What is checked is what is used, wherever a link points later."""
    (tmp_path / "link").symlink_to(cache)
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path / "link"))
    assert compile_cache.usable_folder() == cache


def test_a_new_cache_is_its_users_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path / "new"))
    mask = os.umask(0)
    try:
        assert compile_cache.usable_folder() == tmp_path / "new"
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o700


@pytest.fixture
def heyoka(monkeypatch):
    """heyoka's cache, without a setting that outlives the test: the folder that is used,
    None where none is.
    """
    state = types.SimpleNamespace(path=None, is_enabled=False)
    for name in ("set_diskcache_limit", "get_diskcache_size"):
        setattr(state, name, lambda *_: None)
    state.set_diskcache_path = lambda path: setattr(state, "path", Path(path))
    state.set_diskcache_enabled = lambda enabled: setattr(state, "is_enabled", enabled)
    found = types.SimpleNamespace(llvm_state=state, set_logger_level_error=lambda: None)
    monkeypatch.setitem(sys.modules, "heyoka", found)
    return state


def entries(folder, count=1, size=10):
    """Make the database that heyoka keeps in a folder."""
    columns = "hash, env_fingerprint, comp_flag, bitcode, obj"
    with contextlib.closing(sqlite3.connect(folder / "cache.db")) as db:
        db.execute(f"CREATE TABLE cache ({columns})")
        row = ("environment", 0, b"bitcode", bytes(size))
        rows = [(number, *row) for number in range(count)]
        db.executemany("INSERT INTO cache VALUES (?, ?, ?, ?, ?)", rows)
        db.commit()


def test_what_is_compiled_under_a_name_has_a_folder_of_its_own(cache, heyoka):
    compile_cache.use("one")
    one = heyoka.path
    compile_cache.use("other")
    other = heyoka.path
    compile_cache.use("one")

    assert heyoka.is_enabled
    assert heyoka.path == one != other
    assert one.parent == other.parent == cache


def test_an_entry_that_has_changed_is_removed_with_its_folders_only(
    cache, heyoka, monkeypatch
):
    folders = []
    for name in ("one", "other"):
        compile_cache.use(name)
        folders.append(heyoka.path)
        entries(heyoka.path)
    monkeypatch.setattr(compile_cache, "_checked", set())
    compile_cache.use("one")  # notes the checksum
    with contextlib.closing(sqlite3.connect(folders[0] / "cache.db")) as db:
        db.execute("UPDATE cache SET obj = ?", (b"other code",))
        db.commit()
    monkeypatch.setattr(compile_cache, "_checked", set())

    compile_cache.use("one")

    assert heyoka.is_enabled
    assert not (folders[0] / "cache.db").exists()
    assert (folders[1] / "cache.db").exists()


def test_folders_used_longest_ago_make_room(cache, heyoka, monkeypatch):
    monkeypatch.setattr(compile_cache, "_LIMIT", 200_000)
    folders = []
    for age, name in enumerate(["new", "older", "oldest"]):
        compile_cache.use(name)
        folders.append(heyoka.path)
        entries(heyoka.path, size=80_000)
        for file in heyoka.path.iterdir():
            os.utime(file, (1e9 - age, 1e9 - age))
    other = cache / "of another program"
    other.mkdir()
    entries(other, size=80_000)
    os.utime(other / "cache.db", (1e8, 1e8))

    compile_cache.use("another")

    are_kept = [(folder / "cache.db").exists() for folder in folders]
    assert are_kept == [True, True, False]
    assert (other / "cache.db").exists()
    assert heyoka.is_enabled


def test_a_folder_that_is_wanted_is_kept_however_long_ago_it_was_used(
    cache, heyoka, monkeypatch
):
    folders = []
    for age, name in enumerate(["new", "old"]):
        compile_cache.use(name)
        folders.append(heyoka.path)
        entries(heyoka.path, size=80_000)
        for file in heyoka.path.iterdir():
            os.utime(file, (1e9 - age, 1e9 - age))
    monkeypatch.setattr(compile_cache, "_LIMIT", 100_000)
    compile_cache._make_room.cache_clear()

    compile_cache.use("old")

    are_kept = [(folder / "cache.db").exists() for folder in folders]
    assert are_kept == [False, True]


def test_a_database_of_another_program_is_left_alone(cache, heyoka):
    """Its name is that of heyoka's cache."""
    compile_cache.use("code")
    folder = heyoka.path
    heyoka.is_enabled = False
    compile_cache._checked.clear()
    (folder / "checksums.db").unlink()
    with sqlite3.connect(folder / "cache.db") as db:
        db.execute("CREATE TABLE mine (x)")
    before = (folder / "cache.db").read_bytes()

    compile_cache.use("code")

    assert not heyoka.is_enabled
    assert (folder / "cache.db").read_bytes() == before


@pytest.mark.parametrize(
    ("base", "folder"),
    [
        ("/somewhere", "/somewhere/gaitsweep"),
        ("relative", "~/.cache/gaitsweep"),
        ("", "~/.cache/gaitsweep"),
    ],
)
def test_a_relative_base_of_caches_is_ignored(monkeypatch, base, folder):
    """As the XDG specification has it."""
    monkeypatch.delenv("GAITSWEEP_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", base)
    assert compile_cache.cache_folder() == Path(folder).expanduser()
