"""Worker processes, which end with the ``with`` block that started them."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Callable
from typing import Any

from ..system.signals import sigint_ignored

__all__ = ["Worker", "WorkerError"]


class WorkerError(RuntimeError):
    """A failure in a worker process; the message is one sentence."""


class Worker:
    """A process that runs ``serve(pipe, *arguments)`` during a ``with`` block.

    If ``serve`` raises an exception or ends, :meth:`receive` raises :class:`WorkerError`.
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
        """Send a message; if the process has ended, :meth:`receive` will raise the error."""
        with contextlib.suppress(OSError):
            self._pipe.send(message)

    def receive(self) -> Any:
        """Wait for the answer."""
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
    except Exception as error:  # is raised by receive()
        with contextlib.suppress(OSError):
            pipe.send(WorkerError(explain(error)))
