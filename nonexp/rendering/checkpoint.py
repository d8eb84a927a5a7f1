"""Checkpoints: the state of a render on disk, from which it goes on as if never interrupted.

A checkpoint is one file: a line that names the format, a line of JSON (what is rendered, how far
it is), arrays of 64-bit floats, and a checksum over all of this (BLAKE2b). The arrays are the sum
of the passes of each replicate, or the mean and the squared deviations of passes that are all
independent. The one before it is kept beside it, with ``.old`` added to the name. Files get their
names when they are complete and on disk, so that one of the two is whole at any moment.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from ..images.moments import Moments, Replicates
from ..system.files import replacing
from .job import RenderJob

__all__ = ["Checkpoint", "Keeper", "newest", "older", "read", "write"]

_MAGIC = b"nonexp checkpoint 1\n"
_DIGEST = 32  # bytes


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The state of a render."""

    identity: Mapping[str, Any]
    """what is rendered, as JSON: scene, parameters, seed, size, versions ..."""
    moments: Moments | Replicates
    seconds: float
    """time spent on it so far"""
    finished: bool = False
    """it has reached its target"""
    written: str = ""
    """date and time"""


def older(path: Path) -> Path:
    """Name of the checkpoint before the one at ``path``."""
    return path.with_name(path.name + ".old")


def write(path: Path, checkpoint: Checkpoint, *, keep: bool = True) -> None:
    """Write a checkpoint; with ``keep`` the present file becomes :func:`older`, else it goes."""
    moments = checkpoint.moments
    count = moments.count if isinstance(moments, Replicates) else None
    arrays = moments.sums if isinstance(moments, Replicates) else (moments.mean, moments.squares)
    about = {
        "identity": checkpoint.identity,
        "passes": moments.passes,
        "replicates": count,
        "shape": arrays[0].shape if arrays else (),
        "seconds": checkpoint.seconds,
        "finished": checkpoint.finished,
        "written": datetime.now().isoformat(" ", "seconds"),
    }
    parts: tuple[Any, ...] = (
        _MAGIC,
        json.dumps(about).encode() + b"\n",
        *(np.ascontiguousarray(array, "<f8") for array in arrays),
    )
    digest = hashlib.blake2b(digest_size=_DIGEST)
    with replacing(path, backup=older(path) if keep else None) as (aside,):
        with open(aside, "wb") as file:
            for part in parts:
                digest.update(part)
                file.write(part)
            file.write(digest.digest())


def read(path: Path) -> Checkpoint:
    """Read a checkpoint. Raises ``OSError``, or ``ValueError`` for a file that is damaged."""
    data = path.read_bytes()
    body, digest = memoryview(data)[:-_DIGEST], data[-_DIGEST:]
    if hashlib.blake2b(body, digest_size=_DIGEST).digest() != digest:
        raise ValueError(f"checkpoint {str(path)!r} is damaged: its checksum does not match")
    if not data.startswith(_MAGIC):
        raise ValueError(f"{str(path)!r} is not a checkpoint of this version of nonexp")
    start = data.index(b"\n", len(_MAGIC)) + 1
    about = json.loads(data[len(_MAGIC) : start])
    values = np.frombuffer(body[start:], "<f8").astype(np.float64)
    moments: Moments | Replicates
    if (count := about.get("replicates")) is None:
        moments = Moments(about["passes"], *values.reshape(2, *about["shape"]))
    else:
        sums = values.reshape(min(about["passes"], count), *about["shape"])
        moments = Replicates(count, about["passes"], tuple(sums))
    return Checkpoint(
        about["identity"], moments, about["seconds"], about["finished"], about["written"]
    )


def newest(path: Path) -> tuple[Checkpoint, str] | None:
    """The newest checkpoint that is whole, and what is wrong with a newer one; None without any.

    Raises ``ValueError`` where there are files, but none that is whole.
    """
    wrong = ""
    for candidate in (path, older(path)):
        try:
            return read(candidate), wrong
        except FileNotFoundError:
            continue
        except ValueError as error:
            wrong = wrong or str(error)
    if wrong:
        raise ValueError(f"{wrong}, and there is no older one: delete it to start over")
    return None


# --------------------------------------------------------------------- while rendering


class Keeper:
    """Writes a render's state from time to time, on a thread of its own.

    At most one file per ``job.interval`` seconds, and one at the end. A write failure is reported
    once, to ``warn``; rendering goes on.
    """

    def __init__(self, job: RenderJob, *, keep_present: bool, warn: Callable[[str], Any]) -> None:
        assert job.checkpoint is not None
        self._path, self._interval = job.checkpoint, job.interval
        self._identity = job.state_identity
        self._keep, self._warn = keep_present, warn
        self._last = perf_counter()
        self._thread: threading.Thread | None = None
        self._failure: OSError | None = None
        self._warned = False

    def offer(self, moments: Moments | Replicates, seconds: float) -> None:
        """Start to write if it is time, and nothing is being written."""
        busy = self._thread is not None and self._thread.is_alive()
        if busy or perf_counter() - self._last < self._interval:
            return
        self._report()
        self._last = perf_counter()
        state = Checkpoint(self._identity, moments, seconds)
        self._thread = threading.Thread(target=self._try_to_write, args=(state,))
        self._thread.start()

    def close(self, moments: Moments | Replicates, seconds: float, finished: bool) -> bool:
        """Write the last state; returns whether that succeeded."""
        if self._thread is not None:
            self._thread.join()
        self._failure = None
        self._try_to_write(Checkpoint(self._identity, moments, seconds, finished))
        self._report()
        return self._failure is None

    def _try_to_write(self, state: Checkpoint) -> None:
        try:
            write(self._path, state, keep=self._keep)
            self._keep = True
        except OSError as error:
            self._failure = error

    def _report(self) -> None:
        if self._failure is not None and not self._warned:
            self._warned = True
            why = self._failure.strerror or self._failure
            self._warn(f"checkpoint {str(self._path)!r} cannot be written ({why})")
