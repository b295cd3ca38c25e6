"""What a run does at a signal."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any

from pipeline.errors import StoppedError
from pipeline.execution import worker_process

_ONE = 1.0  # signals within this time count once: `timeout` sends it to its command and again to the group [s]


class Signals:
    """Stop a run at INT, TERM or HUP, but never while a result is written; a second signal, a second later, kills.

    Signals that were ignored at the start, as under `nohup`, stay ignored.
    """

    def __init__(self) -> None:
        self.postponed, self.received, self._when = False, 0, 0.0
        self._handlers: dict[int, Any] = {}

    @contextlib.contextmanager
    def handle(self) -> Iterator[None]:
        """Handle signals inside, and after one until `restore`; only the main thread can.

        Inside a callback of the interpreter, as while a module is imported, no error can be raised. Its worker
        processes being gone, the run then ends by the error that follows.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        self._handlers = {
            s: signal.signal(s, self._receive)
            for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
            if signal.getsignal(s) not in (signal.SIG_IGN, None)
        }
        hook = sys.unraisablehook
        sys.unraisablehook = lambda error: None if isinstance(error.exc_value, StoppedError) else hook(error)
        try:
            yield
        except StoppedError:
            raise
        except Exception:
            if self.received:  # an error of a library that was interrupted
                self._stop()
            raise
        finally:
            sys.unraisablehook = hook
            if not self.received:  # a repeat must not keep the run from reporting how it ended
                self.restore()

    def restore(self) -> None:
        """Leave signals to their earlier handlers."""
        for signum, handler in self._handlers.items():
            signal.signal(signum, handler)

    def _receive(self, signum: int, frame: FrameType | None) -> None:
        if self.received:
            if time.monotonic() - self._when > _ONE:
                worker_process.stop()
                os._exit(128 + signum)
            return
        self.received, self._when = signum, time.monotonic()
        worker_process.stop()
        if not self.postponed:
            self._stop()

    def _stop(self) -> None:
        name = signal.Signals(self.received).name
        raise StoppedError(self.received, f"Stopped by {name}; finished results are kept.") from None

    def __enter__(self) -> None:
        self.postponed = True

    def __exit__(self, *_: object) -> None:
        self.postponed = False
        if self.received:
            self._stop()
