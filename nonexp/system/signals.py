"""Ending a run by Ctrl-C or SIGTERM between two passes."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

from .terminal import note

__all__ = ["Stop", "Stopped", "sigint_ignored", "stop_signals"]


class Stopped(BaseException):
    """The run was asked to end; the message says by what, ``exit_code`` is 130 or 143."""

    def __init__(self, number: int) -> None:
        super().__init__("interrupted" if number == signal.SIGINT else "terminated")
        self.exit_code = 128 + number


class Stop:
    """Whether the run was asked to end."""

    def __init__(self) -> None:
        self.number: int | None = None

    def check(self) -> None:
        """Raise :class:`Stopped` if it was."""
        if self.number is not None:
            raise Stopped(self.number)


@contextlib.contextmanager
def stop_signals(immediately: bool = False) -> Iterator[Stop]:
    """Within the block SIGINT and SIGTERM are recorded, for :meth:`Stop.check` to raise later.

    A second signal, or the first if ``immediately``, raises at once. (An exception while Dr.Jit
    records a kernel would surface as another one.) Signals that the process ignores stay ignored.
    """
    stop = Stop()

    def handle(number: int, frame: FrameType | None) -> None:
        again = stop.number is not None
        stop.number = number
        if again or immediately:
            raise Stopped(number)
        note("ending after this pass (once more: at once)")

    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, handle)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def sigint_ignored() -> Iterator[None]:
    """Processes started within the block ignore Ctrl-C, which is meant for this one."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
