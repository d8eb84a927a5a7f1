"""Rendering on many machines with Dask distributed (the extra ``cluster``).

Passes are tasks. A worker gets the scene as an archive of its files, unpacks it once into a folder
named by its checksum, and renders pass k with the seed of pass k. The images are summed in the
order of the passes, so the result is that of one machine, bit for bit, if all have the same type
of processor. When a worker is lost, Dask gives its tasks to another; a pass counts once.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import io
import itertools
import logging
import os
import platform
import re
import shutil
import tempfile
import threading
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..images.moments import Array
from ..scene.identity import versions
from ..scene.load import load
from ..system.signals import sigint_ignored
from .job import RenderJob
from .passes import Plan, render_passes

__all__ = ["Cluster", "connect", "require"]

_TIMEOUT = 10  # seconds until a scheduler must have answered
_ENDLESS = 2**62
_THREADS = "NONEXP_THREADS"  # environment variable: threads that a worker may use


def require() -> None:
    """Raise ``ImportError``, in one sentence, where Dask distributed is missing."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise ImportError(
            "--cluster needs Dask distributed, which is not installed: "
            "pip install 'nonexp[cluster]'"
        ) from None


# --------------------------------------------------------------------- on a worker


_lock = threading.Lock()  # Dr.Jit uses all cores for one pass
_loaded: dict[str, Any] = {}


def render_pass(archive: bytes, root: str, job: RenderJob, number: int) -> Any:
    """Render pass ``number`` of the scene file ``root`` in an archive; runs on a worker."""
    with _lock:
        mi.set_variant(job.variant)
        if _THREADS in os.environ:
            dr.set_thread_count(int(os.environ[_THREADS]))
        mine, wanted = versions(), job.identity["versions"]
        differ = [name for name, value in wanted.items() if mine.get(name) != value]
        if differ:
            here, there = (", ".join(f"{k} {v.get(k)}" for k in differ) for v in (mine, wanted))
            raise ValueError(
                f"a worker on {platform.node()} has {here} instead of {there}: "
                "all machines must have the same versions"
            )
        todo = Plan(number + 1, job.plan.pass_spp)
        scene = _scene(archive, root, job)
        (image,) = render_passes(
            scene,
            todo,
            job.seed,
            sensor=job.sensor,
            start=number,
            sampler=job.sampler,
            count=job.replicates,
        )
        single = "double" not in job.variant
        return image.astype(np.float32) if single else image  # half the traffic, the same bits


def _scene(archive: bytes, root: str, job: RenderJob) -> Any:
    """The scene, from memory where this process has it already."""
    name = hashlib.blake2b(archive, digest_size=16).hexdigest()
    key = f"{name} {root} {sorted(job.parameters.items())} {job.size} {job.variant}"
    if key not in _loaded:
        folder = _unpack(archive, name)
        mi.set_log_level(mi.LogLevel.Error)
        _loaded.clear()  # one scene at a time is enough
        _loaded[key] = load(folder / root, job.parameters, job.size).scene
    return _loaded[key]


def _unpack(archive: bytes, name: str) -> Path:
    """Folder with the files of an archive, which may be there already."""
    user = re.sub(r"\W", "_", os.environ.get("USER") or str(os.getpid()))
    above = Path(tempfile.gettempdir()) / f"nonexp-{user}"
    folder = above / name
    if not folder.is_dir():
        above.mkdir(mode=0o700, exist_ok=True)
        aside = Path(tempfile.mkdtemp(dir=above))
        with zipfile.ZipFile(io.BytesIO(archive)) as files:
            files.extractall(aside)
        try:
            aside.rename(folder)
        except OSError:  # another process was first
            shutil.rmtree(aside)
    return folder


# --------------------------------------------------------------------- where the image is made


class Cluster:
    """A connection to a scheduler; ``dashboard`` is the address of Dask's page about it."""

    def __init__(self, client: Any, note: Callable[[str], Any] = lambda text: None) -> None:
        self._client = client
        self._note = note
        self.dashboard = str(client.dashboard_link or "")

    def workers(self) -> int:
        """Number of workers at present."""
        found = self._client.scheduler_info(n_workers=-1)  # empty when the scheduler has gone
        return len(found.get("workers", ()))

    def passes(self, job: RenderJob, start: int = 0) -> Iterator[Array]:
        """Render the passes of a job from a file, from number ``start`` on; yields them in order.

        Not more than twice as many passes as there are workers, and two, are under way, so that
        memory stays flat. Raises ``RuntimeError`` where a pass fails or ends the workers that
        try it.
        """
        from distributed import CancelledError
        from distributed.comm.core import CommClosedError

        files, job = job.files, replace(job, files=None)
        if files is None:
            raise ValueError("a scene in memory has no files to send to a cluster")
        files.check_movable()
        root = files.root.relative_to(files.folder).as_posix()
        numbers = range(start, _ENDLESS if job.plan.passes is None else job.plan.passes)
        run = os.urandom(8).hex()
        under_way: dict[int, Any] = {}
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            archive = self._client.submit(_same, files.pack(), key=f"nonexp-scene-{run}")
        todo = iter(numbers)
        try:
            for number in numbers:
                for ahead in itertools.islice(todo, self._room(under_way)):
                    under_way[ahead] = self._client.submit(
                        render_pass,
                        archive,
                        root,
                        job,
                        ahead,
                        key=f"nonexp-{run}-{ahead}",
                        pure=False,
                    )
                yield np.asarray(self._result(under_way.pop(number)), dtype=np.float64)
        except (CancelledError, CommClosedError):  # the client cancels what it cannot ask about
            raise RuntimeError("the scheduler cannot be reached any more") from None
        finally:
            with contextlib.suppress(Exception):
                self._client.cancel([*under_way.values(), archive])

    def _room(self, under_way: Mapping[int, Any]) -> int:
        return max(0, 2 * self.workers() + 2 - len(under_way))

    def _result(self, future: Any) -> Any:
        """The result of a task, however long it takes; notes once if there are no workers."""
        from distributed import KilledWorker, TimeoutError

        noted = False
        while True:
            try:
                return future.result(timeout=2)
            except TimeoutError:
                if self._client.status not in ("running", "connecting"):
                    raise RuntimeError("the scheduler cannot be reached any more") from None
                if not noted and not self.workers():
                    noted = True
                    self._note("there are no workers: waiting for one to join")
            except KilledWorker as error:
                raise RuntimeError(
                    "a pass ended every worker that tried it (too little memory?)"
                ) from error


def _same(archive: bytes) -> bytes:
    """The archive as the result of a task, which Dask can repeat when a worker is lost."""
    return archive


@contextlib.contextmanager
def connect(where: str, note: Callable[[str], Any] = lambda text: None) -> Iterator[Cluster]:
    """Connect to a scheduler by its address, such as tcp://host:8786.

    ``local`` starts one with two workers on this machine, ``local:N`` with N, which share its
    cores. Raises ``ImportError`` without Dask, ``OSError`` if there is no scheduler.
    """
    require()
    distributed: Any = importlib.import_module("distributed")  # whose functions have no types
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # the error below is enough
    match = re.fullmatch(r"local(?::([1-9]\d{0,2}))?", where)
    with contextlib.ExitStack() as stack:
        address: Any = where
        if match:
            number = int(match[1] or 2)
            threads = max(1, (os.cpu_count() or 1) // number)
            with sigint_ignored():
                local = distributed.LocalCluster(
                    n_workers=number,
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                    env={_THREADS: str(threads)},
                )
            address = stack.enter_context(local)
        try:
            client = stack.enter_context(
                distributed.Client(address, timeout=_TIMEOUT, set_as_default=False)
            )
        except (OSError, ValueError) as error:
            raise OSError(
                f"--cluster is {where!r}: no scheduler answers there "
                "(it must be local, local:N, or an address such as tcp://host:8786)"
            ) from error
        yield Cluster(client, note)
