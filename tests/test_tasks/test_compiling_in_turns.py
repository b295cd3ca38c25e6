"""Processes that share a compile cache: one compiles what the others load."""

import functools
import os
import subprocess
import sys
import zlib

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
    another, monkeypatch, tmp_path
):
    """Both workers compiled every flow of an empty cache."""
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path))
    monkeypatch.setattr(kernel, "FLOWS", {})
    names, made = [], []
    turn = compile_cache.turn

    def noted(name, meanwhile):
        names.append(name)
        return turn(name, meanwhile)

    monkeypatch.setattr(compile_cache, "turn", noted)
    structure = structure_of(resolve("D", {}))
    kernel.flow(structure, 2, False)
    (first,) = names
    (tmp_path / first).unlink()
    kernel.FLOWS.clear()

    with another(first) as holder:

        def compile_(*given):
            made.append(given[2:4])
            if given[3]:
                holder.communicate()  # the other worker is done, and its turn over
            return compiled_flow(*given)

        compiled_flow = kernel._compiled_flow
        functools.update_wrapper(compile_, compiled_flow)
        monkeypatch.setattr(kernel, "_compiled_flow", compile_)
        kernel.flow(structure, 2, False)

    assert made == [(3, True), (2, False)]


CALLS = []


def doubled(x):
    CALLS.append(x)
    return 2 * x


def test_who_waited_for_a_compiler_loads_what_it_made(another, monkeypatch, tmp_path):
    """Each of several processes compiled all that they need."""
    monkeypatch.setenv("GAITSWEEP_CACHE", str(tmp_path))
    monkeypatch.setattr(sys.modules[__name__], "CALLS", [])
    compile_cache.kept(doubled, 1)
    (file,) = tmp_path.glob("*.compiled")
    elsewhere = file.rename(tmp_path / "elsewhere")

    with another(file.name) as holder:

        def meanwhile():
            elsewhere.rename(file)
            holder.communicate()

        assert compile_cache.kept(doubled, 1, meanwhile=meanwhile) == 2
    assert CALLS == [1]
