"""Processes of their own, which end with the block that started them."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Callable
from typing import Any

from ..system.signals import sigint_ignored

__all__ = ["Worker", "WorkerError"]


class WorkerError(RuntimeError):
    """What went wrong in a process; the message is one sentence."""


class Worker:
    """A process that runs ``serve(pipe, *arguments)``, to talk to inside a ``with`` block.

    What ``serve`` raises reaches :meth:`receive` as a :class:`WorkerError`, as does its end.
    """

    def __init__(self, serve: Callable[..., None], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, self._theirs = context.Pipe()
        self._process = context.Process(
            target=_run, args=(serve, self._theirs, arguments), daemon=True
        )

    def __enter__(self) -> Worker:
        with sigint_ignored():
            self._process.start()
        self._theirs.close()
        return self

    def __exit__(self, *_: object) -> None:
        self._pipe.close()
        self._process.terminate()
        self._process.join()

    def send(self, message: Any) -> None:
        """Hand over a message; that the process has ended is told by :meth:`receive`."""
        with contextlib.suppress(OSError):
            self._pipe.send(message)

    def receive(self) -> Any:
        """Wait for an answer."""
        try:
            answer = self._pipe.recv()
        except (EOFError, OSError):
            raise WorkerError("the process ended") from None
        if isinstance(answer, WorkerError):
            raise answer
        return answer


def _run(serve: Callable[..., None], pipe: Any, arguments: tuple[Any, ...]) -> None:
    from ..scene.messages import explain

    try:
        serve(pipe, *arguments)
    except EOFError:
        pass
    except Exception as error:  # goes to whoever asked
        with contextlib.suppress(OSError):
            pipe.send(WorkerError(explain(error)))
