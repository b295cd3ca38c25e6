"""Machine code is executed only from a folder that nobody else can change."""

import logging
import os
import shutil
import stat
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import heyoka
import pytest

from gaitsweep.tasks.mechanics import compile_cache, kernel
from gaitsweep.tasks.mechanics.lumped import structure_of
from gaitsweep.tasks.walkers.resolve import resolve

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
    """A cache in `home/cache` of this user."""
    folder = tmp_path / "home" / "cache"
    folder.mkdir(parents=True)
    monkeypatch.setenv("GAITSWEEP_CACHE", str(folder))
    return folder


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
def made(cache, monkeypatch):
    """What was compiled, not loaded, so far."""
    found = []
    monkeypatch.setattr(sys.modules[__name__], "MADE", found)
    monkeypatch.setattr(compile_cache, "_locks", [])
    compile_cache._origin_of.cache_clear()
    yield found
    compile_cache._origin_of.cache_clear()


MADE: list[tuple] = []


def compile_(*given):
    MADE.append(given)
    return [*given, "code"]


def another(*given):
    return compile_(*given)


def files(folder):
    return sorted(folder.glob("*.compiled"))


def test_what_was_compiled_is_loaded(cache, made):
    first = compile_cache.kept(compile_, 1, variant="8 lanes")
    again = compile_cache.kept(compile_, 1, variant="8 lanes")

    assert first == again == [1, "code"] and first is not again
    assert made == [(1,)]
    (file,) = files(cache)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


@pytest.mark.parametrize(
    ("function", "argument", "variant"),
    [(another, 1, ""), (compile_, 2, ""), (compile_, 1, "4 lanes")],
)
def test_other_code_is_kept_apart(cache, made, function, argument, variant):
    compile_cache.kept(compile_, 1)
    compile_cache.kept(function, argument, variant=variant)
    assert len(made) == len(files(cache)) == 2


def new_heyoka(monkeypatch, tmp_path):
    monkeypatch.setattr(heyoka, "__version__", "0.0.1")


def new_library(monkeypatch, tmp_path):
    (tmp_path / "library").touch()
    monkeypatch.setattr(heyoka._core, "__file__", str(tmp_path / "library"))


def new_processor(monkeypatch, tmp_path):
    monkeypatch.setattr(compile_cache, "_processor", lambda: ["flags: none"])


@pytest.mark.parametrize("change", [new_heyoka, new_library, new_processor])
def test_code_that_may_have_changed_is_compiled_anew(
    cache, made, change, monkeypatch, tmp_path
):
    compile_cache.kept(compile_, 1)
    change(monkeypatch, tmp_path)
    compile_cache._origin_of.cache_clear()

    compile_cache.kept(compile_, 1)

    assert len(made) == len(files(cache)) == 2


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """Copies of the folders with equations and of a module, as if this process had
    begun after they were made.
    """
    folders = []
    for folder in compile_cache._EQUATIONS:
        folders.append(shutil.copytree(folder, tmp_path / folder.name))
    monkeypatch.setattr(compile_cache, "_EQUATIONS", tuple(folders))
    monkeypatch.setattr(compile_cache, "_BEGUN", time.time() + 3600)
    compile_cache._origin_of.cache_clear()
    yield shutil.copy(__file__, tmp_path / "module.py")
    compile_cache._origin_of.cache_clear()


@pytest.mark.parametrize(
    "changed", ["module.py", "mechanics/equations.py", "step/symbols.py"]
)
def test_an_edit_of_equations_or_of_what_compiles_them_is_seen(copied, changed):
    before = compile_cache._origin(copied)
    assert before == compile_cache._origin(copied)

    with open(copied.parent / changed, "a") as file:
        file.write("# edited\n")
    compile_cache._origin_of.cache_clear()

    assert compile_cache._origin(copied) not in (None, before)


def test_modules_edited_while_they_run_keep_nothing(copied, monkeypatch):
    """What was compiled stood under the name of the edited equations."""
    assert compile_cache._origin(copied)
    monkeypatch.setattr(compile_cache, "_BEGUN", time.time() - 1)
    assert compile_cache._origin(copied) is None


def test_lanes_and_tolerances_tell_flows_apart(monkeypatch):
    names = []

    def kept(make, *given, variant, meanwhile):
        names.append((make, *map(repr, given), variant))
        return make(*given)

    monkeypatch.setattr(compile_cache, "kept", kept)
    structure = structure_of(resolve("D", {}))
    kernel.Flow(structure, 0, False, coarse=True)
    monkeypatch.setattr(kernel, "_COARSE", 1e-6)
    kernel.Flow(structure, 0, False, coarse=True)
    monkeypatch.setattr(kernel, "LANES", 1)
    kernel.Flow(structure, 0, False, coarse=True)
    assert len(set(names)) == 3


@pytest.mark.parametrize("fails", ["_write", "_make_room"])
def test_what_cannot_be_kept_is_there_all_the_same(cache, made, fails, monkeypatch):
    monkeypatch.setattr(compile_cache, fails, Mock(side_effect=MemoryError))
    assert compile_cache.kept(compile_, 1) == [1, "code"]


def test_where_the_processor_is_not_told_nothing_is_kept(cache, made, monkeypatch):
    def none():
        raise FileNotFoundError

    monkeypatch.setattr(compile_cache, "_processor", none)
    assert compile_cache.kept(compile_, 1) == [1, "code"]
    assert made and not files(cache)


def bit_flipped(file):
    data = file.read_bytes()
    file.write_bytes(data.replace(b"code", b"cod%c" % (ord("e") ^ 4)))


def link(file):
    file.rename(file.parent / "elsewhere")
    file.symlink_to(file.parent / "elsewhere")


def pipe(file):
    file.unlink()
    os.mkfifo(file)


@pytest.mark.parametrize(
    "damage",
    [
        bit_flipped,
        link,
        pipe,
        lambda file: file.write_bytes(file.read_bytes()[:-1]),
        lambda file: file.write_bytes(b""),
        lambda file: file.write_bytes(
            compile_cache._checksum(b"no pickle") + b"no pickle"
        ),
        lambda file: file.chmod(0o666),
    ],
)
def test_a_file_that_is_damaged_or_not_only_ours_is_made_anew(cache, made, damage):
    compile_cache.kept(compile_, 1)
    (file,) = files(cache)
    damage(file)

    assert compile_cache.kept(compile_, 1) == [1, "code"]
    assert len(made) == 2

    compile_cache.kept(compile_, 1)
    assert len(made) == 2
    assert files(cache) == [file]


def test_a_folder_in_the_place_of_a_file_is_left(cache, made):
    compile_cache.kept(compile_, 1)
    (file,) = files(cache)
    file.unlink()
    file.mkdir()

    for _ in range(2):
        assert compile_cache.kept(compile_, 1) == [1, "code"]
    assert len(made) == 3 and files(cache) == [file]


def test_files_used_longest_ago_make_room(cache, made, monkeypatch):
    monkeypatch.setattr(compile_cache, "_LIMIT", 250_000)
    for argument in "abc":
        before = files(cache)
        compile_cache.kept(compile_, argument * 100_000)
        (new,) = set(files(cache)) - set(before)
        os.utime(new, (1e9 + len(before),) * 2)
        if argument == "b":  # the first is used again
            compile_cache.kept(compile_, "a" * 100_000)
    other = cache / "of another program"
    other.write_bytes(bytes(300_000))

    assert len(made) == 3 and len(files(cache)) == 2
    compile_cache.kept(compile_, "a" * 100_000)
    assert len(made) == 3 and other.exists()


def test_what_is_larger_than_all_room_is_kept_alone(cache, made, monkeypatch):
    monkeypatch.setattr(compile_cache, "_LIMIT", 50_000)
    for argument in "ab":
        compile_cache.kept(compile_, argument * 100_000)
    compile_cache.kept(compile_, "b" * 100_000)
    assert len(made) == 2 and len(files(cache)) == 1


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
