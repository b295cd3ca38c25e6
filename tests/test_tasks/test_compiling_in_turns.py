"""Processes that share a compile cache: one compiles what the others load."""

import os
import subprocess
import sys
import threading
import zlib
from unittest.mock import Mock

import pytest

from gaitsweep.tasks.mechanics import compile_cache, kernel
from gaitsweep.tasks.mechanics.lumped import structure_of
from gaitsweep.tasks.walkers.resolve import resolve

HOLD = (
    "import fcntl, sys; file = open(sys.argv[1], 'r+b'); fcntl.lockf(file, fcntl.LOCK_EX, 1, int(sys.argv[2]));"
    "print(flush=True); sys.stdin.read()"
)


@pytest.fixture
def another(tmp_path, monkeypatch):
    """Another process that has the turn of a name until its input is closed."""
    file = tmp_path / "locks"
    file.touch()
    monkeypatch.setattr(
        compile_cache, "_locks", [os.open(file, os.O_RDWR)], raising=False
    )

    def begin(name):
        command = [
            sys.executable,
            "-S",
            "-c",
            HOLD,
            file,
            str(zlib.crc32(name.encode())),
        ]
        holder = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        holder.stdout.readline()
        return holder

    return begin


def test_a_worker_compiles_the_other_flow_while_one_is_compiled_elsewhere(
    another, monkeypatch
):
    """Both workers compiled every flow of an empty cache."""
    structure, compiled = structure_of(resolve("D", {})), []
    with another(repr((structure, 2, False, False, False, False))) as holder:

        def compile_(*key):
            compiled.append(key[1:3])
            if key[2]:
                holder.communicate()  # the other worker is done, and its turn over
            return Mock()

        monkeypatch.setattr(kernel, "prepare_compiler", lambda structure: None)
        monkeypatch.setattr(kernel, "FLOWS", {})
        monkeypatch.setattr(kernel, "Flow", compile_)
        kernel.flow(structure, 2, False)
    assert compiled == [(3, True), (2, False)]


def test_a_cache_that_another_process_is_making_is_not_taken_for_damaged(
    another, monkeypatch, tmp_path
):
    """It was removed, and each process kept what it compiled in a file that the others
    did not see.
    """
    monkeypatch.setitem(sys.modules, "heyoka", Mock())
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path))
    looked = threading.Event()
    monkeypatch.setattr(
        compile_cache, "_is_intact", lambda folder: looked.set() or True
    )
    compile_cache.use("code")
    (folder,) = (each for each in tmp_path.iterdir() if each.is_dir())
    looked.clear()
    monkeypatch.setattr(compile_cache, "_checked", set())
    with another(folder.name) as maker:
        opens = threading.Thread(target=compile_cache.use, args=["code"])
        opens.start()
        assert not looked.wait(0.2)
        maker.communicate()
        opens.join()
    assert looked.is_set()
