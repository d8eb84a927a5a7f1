"""Rendering passes of all competitors in turn.

Each competitor runs in its own process, which holds only its scene: anything else in the process
changes the kernels that Dr.Jit compiles, and their speed. Only one process works at a time. Passes
take turns in random order, so that a change of the machine's speed affects all alike.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..images.moments import Array
from ..rendering.passes import pass_seed
from ..rendering.sampling import View
from . import statistics
from .competitors import Competitor
from .results import Row
from .scenes import SCENES, Case
from .statistics import Reference
from .worker import Worker, WorkerError

__all__ = ["Budget", "Job", "Pass", "empty_kernel_cache", "render_timed", "run_case"]


@dataclass(frozen=True)
class Budget:
    """Seconds per competitor, the smallest and largest number of passes of each, and a divisor of
    the samples of a pass."""

    seconds: float
    least: int
    most: int
    divide: int = 1


FULL = Budget(15.0, 16, 256)
QUICK = Budget(1.0, 8, 32, divide=2)


@dataclass(frozen=True)
class Job:
    """What a process renders."""

    competitor: Competitor
    scene: str
    law: str
    size: tuple[int, int]
    spp: int
    variant: str

    @staticmethod
    def of(case: Case, competitor: Competitor, variant: str, divide: int = 1) -> Job:
        """The job of a competitor in a case."""
        scene = case.scene
        spp = max(scene.spp * competitor.samples // divide, 1)
        return Job(competitor, scene.name, case.law, scene.size, spp, variant)

    def seed(self, seed: int) -> int:
        """Seed of the competitor's run: no two competitors share random numbers."""
        name = f"{self.scene} {self.law} {self.competitor.name} {seed}"
        return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=4).digest(), "little")


@dataclass(frozen=True, eq=False)
class Pass:
    """An image, and the time it took.

    If requested, also the number of ``operations`` of the largest kernel, whether that kernel was
    ``cached``, and the peak ``memory`` in bytes that Dr.Jit allocated in addition.
    """

    image: Any
    seconds: float
    operations: int = 0
    cached: bool = False
    memory: int = 0


# --------------------------------------------------------------------- one run


def run_case(
    case: Case,
    competitors: Sequence[Competitor],
    reference: Reference,
    budget: Budget,
    *,
    variant: str = "llvm_ad_rgb",
    seed: int = 0,
    on_pass: Callable[[str], Any] = lambda text: None,
) -> list[Row]:
    """Render a case with all competitors in turn, and compute the figures of each.

    The number of passes follows from one timed pass of each competitor, and is the same for all. A
    competitor that fails gets a row with the reason. ``on_pass`` is called with a line of progress.
    """
    jobs = [Job.of(case, competitor, variant, budget.divide) for competitor in competitors]
    with contextlib.ExitStack() as stack:
        runs = [stack.enter_context(_Run(job, job.seed(seed))) for job in jobs]
        for run in runs:
            run.wait()
        for run in runs:
            run.compile()
            on_pass(f"{case.name}: {run.job.competitor.name} compiled")
        for run in runs:
            run.warm_up()
            on_pass(f"{case.name}: {run.job.competitor.name} warmed up")
        # The warm-up pass determines the number of passes, and is not counted itself.
        working = [run for run in runs if run.error is None]
        each = sum(run.looked.seconds for run in working if run.looked)
        rounds = int(budget.seconds * len(working) / each) if working else 0
        rounds = min(max(rounds, budget.least), budget.most)
        order = np.random.default_rng(seed)
        for number in range(rounds):
            for i in order.permutation(len(working)):
                working[i].render()
            on_pass(f"{case.name}: round {number + 1} of {rounds}")
        return [run.row(reference) for run in runs]


class _Run:
    """A process that renders one job, and its passes so far."""

    def __init__(self, job: Job, seed: int) -> None:
        self.job, self.seed = job, seed
        self.error: str | None = None
        self.compiled: Pass | None = None
        self.compile_seconds = 0.0
        self.looked: Pass | None = None
        self.passes: list[Pass] = []
        self._rendered = 0

    def __enter__(self) -> _Run:
        self._worker = Worker(_serve, self.job)
        self._worker.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._worker.__exit__(*exception)

    def wait(self) -> None:
        """Wait until the scene is loaded."""
        self._receive()

    def compile(self) -> None:
        """Render one sample per pixel twice: the first time includes compilation."""
        self.compiled, again = self._pass(1, look=True), self._pass(1)
        if self.compiled is not None and again is not None:
            self.compile_seconds = max(self.compiled.seconds - again.seconds, 0.0)

    def warm_up(self) -> None:
        """A pass whose kernels and memory are recorded, but which does not count."""
        self.looked = self._pass(self.job.spp, look=True)

    def render(self) -> None:
        """Render one more pass, unless one has failed."""
        done = self._pass(self.job.spp)
        if done is not None:
            self.passes.append(done)

    def _pass(self, spp: int, look: bool = False) -> Pass | None:
        if self.error is not None:
            return None
        self._worker.send((pass_seed(self.seed, self._rendered), spp, look))
        self._rendered += 1
        done = self._receive()
        if done is not None and not np.all(np.isfinite(done.image)):
            self.error = "the image holds values that are not finite"
        return done

    def _receive(self) -> Pass | None:
        try:
            answer: Pass | None = self._worker.receive()
        except WorkerError as error:
            self.error = str(error)
            return None
        return answer

    def row(self, reference: Reference) -> Row:
        """All figures of the passes so far."""
        competitor = self.job.competitor
        row = Row(
            competitor.name,
            competitor.plugin,
            dict(competitor.properties),
            None if competitor.medium is None else dict(competitor.medium),
            self.job.spp,
            error=self.error,
        )
        if self.error is None and self.compiled is not None and self.looked is not None:
            images: Array = np.stack([done.image for done in self.passes])
            seconds: Array = np.array([done.seconds for done in self.passes])
            row.passes = len(images)
            row.figures = statistics.analyse(images, seconds, reference)
            row.operations, row.memory = self.looked.operations, self.looked.memory
            row.compile_seconds = self.compile_seconds
            row.compile_cached = self.compiled.cached
        return row


# --------------------------------------------------------------------- in the process


def _serve(pipe: Any, job: Job) -> None:
    """Load a scene, then render a pass for each (seed, spp, look) received."""
    mi.set_variant(job.variant)
    mi.set_log_level(mi.LogLevel.Error)
    if job.competitor.module:
        importlib.import_module(job.competitor.module)
    case = Case(next(scene for scene in SCENES if scene.name == job.scene), job.law)
    scene = case.scene.build(job.competitor.filling(case), job.size)
    integrator = job.competitor.integrator(case.scene)
    sensor = View(scene.sensors()[0], job.competitor.sampler, job.spp).sensor
    pipe.send(None)
    while True:
        seed, spp, look = pipe.recv()
        pipe.send(render_timed(scene, integrator, seed, spp, look, sensor))


def render_timed(
    scene: Any, integrator: Any, seed: int, spp: int, look: bool = False, sensor: Any = 0
) -> Pass:
    """One image, timed from the call to the end of the last kernel; ``look`` records kernels and
    memory."""
    backend = dr.JitBackend.CUDA if "cuda" in (mi.variant() or "") else dr.JitBackend.LLVM
    dr.sync_thread()
    if look:
        dr.flush_malloc_cache()  # reused memory would not be counted
    dr.detail.malloc_clear_statistics()
    held = dr.detail.malloc_watermark(backend)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, look):
        started = time.perf_counter()
        image = integrator.render(scene, sensor, seed=seed, spp=spp)
        dr.eval(image)
        dr.sync_thread()
        seconds = time.perf_counter() - started
        kernels = [entry for entry in dr.kernel_history() if "operation_count" in entry]
    done = Pass(np.array(image, dtype=np.float32)[:, :, :3], seconds)
    if not look:
        return done
    largest = max(kernels, key=lambda entry: entry["operation_count"])
    return replace(
        done,
        operations=largest["operation_count"],
        cached=bool(largest["cache_hit"]),
        memory=dr.detail.malloc_watermark(backend) - held,
    )


@contextlib.contextmanager
def empty_kernel_cache() -> Iterator[None]:
    """Processes started inside begin with an empty kernel cache on disk, and share it."""
    before = os.environ.get("DRJIT_CACHE_DIR")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        os.environ["DRJIT_CACHE_DIR"] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ["DRJIT_CACHE_DIR"]
            else:
                os.environ["DRJIT_CACHE_DIR"] = before
