"""What was compiled is kept on disk: to load it takes milliseconds, to build its symbols anew tenths of a second."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import heyoka as hy

Built = TypeVar("Built")
# On a network disk this is slower than compiling; a local one may be named.
_named = os.environ.get("GAITSWEEP_CACHE")
_folder = Path(_named or os.path.join(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "gaitsweep"))
# Behind it, heyoka's own keeps the machine code of symbols that did not change with their source.
if _named:
    _folder.mkdir(parents=True, exist_ok=True)
    hy.llvm_state.set_diskcache_path(_named)
hy.llvm_state.set_diskcache_enabled(True)
hy.set_nthreads(1)


def kept(build: Callable[..., Built]) -> Callable[..., Built]:
    """The same function, each of whose results is built once a process, and once for all where its sources stay.

    Its arguments are positional, their `repr` tells them apart, and its results can be pickled.
    """
    @functools.lru_cache(maxsize=64)
    def load(*what: Any) -> Built:
        key = hashlib.sha256(repr((what, _origin(build.__code__.co_filename))).encode()).hexdigest()[:32]
        path = _folder / f"{build.__name__}-{key}.pickle"
        with contextlib.suppress(Exception):  # what cannot be read for any reason is built again
            return pickle.loads(path.read_bytes())
        found = build(*what)
        with contextlib.suppress(OSError):
            _folder.mkdir(parents=True, exist_ok=True)
            aside = path.with_suffix(f".{os.getpid()}")
            aside.write_bytes(pickle.dumps(found))
            aside.replace(path)
        return found
    return functools.wraps(build)(load)


@functools.cache
def _origin(source: str) -> tuple[str, ...]:
    """All that machine code depends on besides what it is asked for: its sources, heyoka and the processor."""
    sources = [*sorted(Path(__file__).parent.glob("*.py")), Path(source)]
    return (*(hashlib.sha256(path.read_bytes()).hexdigest() for path in sources), hy.__version__, _processor())


@functools.cache
def _processor() -> str:
    with contextlib.suppress(OSError):
        first = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
        return "\n".join(line for line in first if line.startswith(("model name", "flags", "Features", "CPU ")))
    return platform.platform() + platform.processor()
