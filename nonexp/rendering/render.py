"""Rendering in passes: an image as the mean of many, and its standard error.

Mitsuba renders an image in one uninterruptible call. Here it is the mean of passes: images of few
samples per pixel. Between passes there is progress to report, a target to compare with and a
checkpoint to write; their spread says how noisy the mean is (:mod:`.sampling`: how passes depend on
each other). Works for any scene and integrator of Mitsuba.

>>> import mitsuba as mi, nonexp
>>> mi.set_variant("llvm_ad_rgb")
>>> image = nonexp.render(mi.load_file("scenes/dragon.xml"), spp=64)    # doctest: +SKIP
>>> image.mean.shape, image.stderr.shape                                # doctest: +SKIP
((360, 480, 3), (360, 480, 3))
"""

from __future__ import annotations

import contextlib
import math
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..images.image import Image
from ..images.moments import Array, Noise
from ..scene.load import load
from .checkpoint import Keeper, newest
from .job import RenderJob
from .passes import render_passes
from .progress import bar
from .sampling import state as without_passes
from .targets import BLACK, Progress, Run

__all__ = ["Source", "render", "run"]

Source = Callable[[RenderJob, int], Iterator[Array]]
"""Who renders: (job, number of the first pass) -> images of the passes, in order."""

_lock = threading.RLock()  # Dr.Jit records one kernel at a time, whatever the number of threads


def render(
    scene: mi.Scene | str | Path,
    *,
    spp: int | None = None,
    time: float | str | None = None,
    error: float | str | None = None,
    seed: int = 0,
    sensor: int | str | mi.Sensor = 0,
    pass_spp: int | None = None,
    sampler: str | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = True,
    interval: float = 60,
    progress: bool = False,
    on_progress: Callable[[Progress], Any] | None = None,
    identity: Mapping[str, Any] | None = None,
    source: Source | None = None,
) -> Image:
    """Render a scene in passes, until the first target is reached.

    ``scene`` is a Mitsuba scene, or the name of a scene file to load in the present variant.
    Targets: ``spp`` samples per pixel, rounded up to whole passes (see :func:`plan`); ``time`` in
    seconds, or text such as ``"2h30m"``; ``error``, the relative standard error of the image, such
    as 0.01 or ``"1%"``, with 95 % confidence (:class:`nonexp.images.moments.Noise` defines it). By
    default the samples of the scene's sampler. ``seed`` is a whole number >= 0. ``sensor`` is a
    sensor of the scene, its number or its id. ``pass_spp`` chooses the samples per pixel of a pass.
    ``sampler`` is ``sobol`` or ``independent``, by default the scene's own sampler, but ``sobol``
    in place of ``independent``: the plugin ``nonexp_sobol``, less noise from as many samples.
    ``progress=True`` shows a progress bar on a terminal or in Jupyter; ``on_progress`` is called
    after each pass, and may raise to stop the run.

    ``checkpoint`` names a file that receives the state every ``interval`` seconds, at the end, and
    when the run is interrupted; where it exists the run goes on from there, unless ``resume`` is
    false, and ``ValueError`` says so if it is of another render. ``identity`` says what counts as
    the same render, by default the scene's files, or :func:`nonexp.scene.identity.of_scene` for
    a scene in memory. ``source`` renders the passes elsewhere.

    With a box filter and one of these two samplers the same scene, seed, size and number of passes
    give the same image to the last bit on the same type of machine, however often the run was
    interrupted; otherwise to about 1e-5 (sums are made in parallel). Threads that call this
    function render one after the other.

    Raises ``ValueError`` for an argument that is not allowed, for a scene file that cannot be
    loaded, and where ``error`` is the only target and the image stays black; ``OSError`` where the
    checkpoint cannot be written. Warns about an image that is black everywhere.
    """
    if mi.variant() is None:
        raise ValueError("no variant is set: call mitsuba.set_variant('llvm_ad_rgb') first")
    asked: dict[str, Any] = {
        "spp": spp,
        "time": time,
        "error": error,
        "seed": seed,
        "sensor": sensor,
        "pass_spp": pass_spp,
        "sampler": sampler,
        "checkpoint": checkpoint,
        "resume": resume,
        "interval": interval,
    }
    if identity is not None:
        asked["identity"] = identity
    with _lock:
        if isinstance(scene, str | Path):
            loaded = load(Path(scene), {})
            job = RenderJob.of_file(loaded, Path(scene), {}, **asked)
            scene, name = loaded.scene, Path(scene).name
        else:
            job, name = RenderJob.of_scene(scene, **asked), "render"
        return run(job, scene, name if progress else None, on_progress, source)


def run(
    job: RenderJob,
    scene: mi.Scene,
    name: str | None = None,
    on_progress: Callable[[Progress], Any] | None = None,
    source: Source | None = None,
) -> Image:
    """Do a job, with ``scene`` or with the passes that ``source`` renders, as :func:`render` says.

    With a ``name`` a progress bar shows it.
    """
    found, seconds, keeper, unfinished = None, 0.0, None, False
    if job.checkpoint is not None:
        found, wrong = (newest(job.checkpoint) if job.resume else None) or (None, "")
        if wrong:
            _warn(f"{wrong}: the one before it is used")
        if found is not None:
            job = job.going_on(found.identity)
            seconds, unfinished = found.seconds, not found.finished
        keeper = Keeper(job, keep_present=found is not None and not wrong, warn=_warn)
    state = without_passes(job.replicates) if found is None else found.moments
    passes = source or partial(_render_passes, scene)
    progress = Run(job.targets, job.plan.pass_spp, state, seconds)
    camera: Any = scene.sensors()[job.sensor]
    sampler, pixels = camera.sampler(), math.prod(camera.film().crop_size())
    scene_spp = sampler.sample_count()
    try:
        with _lock, contextlib.ExitStack() as stack:
            calls = [] if on_progress is None else [on_progress]
            if name is not None:
                calls.insert(0, stack.enter_context(bar(name, pixels, job.error)))
            images = passes(job, state.passes)
            if isinstance(images, Generator):
                stack.callback(images.close)
            while progress.stopped is None and (image := next(images, None)) is not None:
                progress.take(image)
                for call in calls:
                    call(progress.progress())
                if keeper is not None and progress.stopped is None:
                    keeper.offer(progress.moments, progress.seconds)
    finally:
        sampler.set_sample_count(scene_spp)
        reached = progress.stopped is not None and unfinished
        if keeper is not None and (progress.moments.passes > state.passes or reached):
            keeper.close(progress.moments, progress.seconds, progress.stopped is not None)
    done = _image(job, progress)
    if unusable := np.count_nonzero(~np.isfinite(done.mean).all(axis=-1)):
        _warn(
            f"{unusable} of {done.mean[..., 0].size} pixels are not finite numbers: "
            "they are in no error"
        )
    if done.black:
        _warn(BLACK)
    return done


def _render_passes(scene: mi.Scene, job: RenderJob, start: int) -> Iterator[Array]:
    return render_passes(
        scene,
        job.plan,
        job.seed,
        sensor=job.sensor,
        start=start,
        sampler=job.sampler,
        count=job.replicates,
    )


def _image(job: RenderJob, done: Run) -> Image:
    moments = done.moments
    return Image(
        mean=moments.mean,
        stderr=moments.stderr,
        spp=moments.passes * job.plan.pass_spp,
        passes=moments.passes,
        independent=moments.independent,
        seed=job.seed,
        seconds=done.seconds,
        error=Noise.of(moments).error,
        stopped=done.stopped or "spp",
    )


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=4)  # from the caller of render
