"""What a run does at a signal."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

from pipeline.errors import StoppedError
from pipeline.execution import worker_process


class Signals:
    """Stop a run at INT, TERM or HUP, but never while a result is written; a second signal kills.

    Signals that were ignored at the start, as under `nohup`, stay ignored.
    """

    def __init__(self) -> None:
        self.postponed, self.received = False, 0

    @contextlib.contextmanager
    def handle(self) -> Iterator[None]:
        """Handle signals inside; only the main thread can.

        Inside a callback of the interpreter, as while a module is imported, no error can be raised. Its worker
        processes being gone, the run then ends by the error that follows.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        handlers = {
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
            for signum, handler in handlers.items():
                signal.signal(signum, handler)

    def _receive(self, signum: int, frame: FrameType | None) -> None:
        worker_process.stop()
        if self.received:
            os._exit(128 + signum)
        self.received = signum
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
