"""Machine code is executed only from a folder that nobody else can change."""

import logging
import os
import sqlite3
import stat
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
    compile_cache.usable_folder.cache_clear()
    yield folder
    compile_cache.usable_folder.cache_clear()


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
    compile_cache.usable_folder.cache_clear()
    mask = os.umask(0)
    try:
        assert compile_cache.usable_folder() == tmp_path / "new"
    finally:
        os.umask(mask)
        compile_cache.usable_folder.cache_clear()
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o700


def test_a_database_of_another_program_is_left_alone(cache, monkeypatch):
    """Its name is that of heyoka's cache."""
    with sqlite3.connect(cache / "cache.db") as db:
        db.execute("CREATE TABLE mine (x)")
    before = (cache / "cache.db").read_bytes()
    heyoka = pytest.importorskip("heyoka").llvm_state
    monkeypatch.setattr(
        heyoka,
        "set_diskcache_enabled",
        lambda is_enabled: pytest.fail("used") if is_enabled else None,
        raising=False,
    )
    (cache / "checksums.db").unlink(missing_ok=True)
    compile_cache.use()
    assert (cache / "cache.db").read_bytes() == before


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
