"""Rendering in passes: the mean of independent images, and its standard error.

Mitsuba renders an image in one uninterruptible call. Here it is the mean of passes: images of few
samples per pixel with independent random numbers. Between passes there is progress to report, a
target to compare with and a checkpoint to write, and their spread says how noisy the mean is.
Works for any scene and integrator of Mitsuba.

>>> import mitsuba as mi, nonexp
>>> mi.set_variant("llvm_ad_rgb")
>>> image = nonexp.render(mi.load_file("scenes/dragon.xml"), spp=64)    # doctest: +SKIP
>>> image.mean.shape, image.stderr.shape                                # doctest: +SKIP
((360, 480, 3), (360, 480, 3))
"""

from __future__ import annotations

import contextlib
import json
import math
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..images.image import Image
from ..images.moments import Array, Moments, Noise
from ..scene import identity as sceneid
from . import checkpoint as checkpoints
from .passes import Plan, plan_for, render_passes, sampler_of
from .targets import Progress, Run, Targets

__all__ = ["Source", "identity_of", "render"]

Source = Callable[[Plan, int, int], Iterator[Array]]
"""Who renders: (plan, seed, number of the first pass) -> images of the passes, in order."""


def render(
    scene: mi.Scene,
    *,
    spp: int | None = None,
    time: float | None = None,
    error: float | None = None,
    seed: int = 0,
    sensor: int = 0,
    pass_spp: int | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = True,
    interval: float = 60,
    on_progress: Callable[[Progress], Any] | None = None,
    identity: Mapping[str, Any] | None = None,
    source: Source | None = None,
) -> Image:
    """Render a scene in passes, until the first target is reached.

    Targets: ``spp`` samples per pixel, rounded up to whole passes (see :func:`plan`); ``time`` in
    seconds; ``error``, the relative standard error of the image, such as 0.01, with 95 %
    confidence (:class:`nonexp.images.moments.Noise` defines it). By default the samples of the
    scene's sampler. ``seed`` is a whole number >= 0. ``on_progress`` is called after each pass, and
    may raise to stop the run. ``pass_spp`` chooses the samples per pixel of a pass.

    ``checkpoint`` names a file that receives the state every ``interval`` seconds, at the end, and
    when the run is broken off; where it exists the run goes on from there, unless ``resume`` is
    false, and ``ValueError`` says so if it is of another render. What counts as the same render
    is in ``identity``, by default :func:`nonexp.scene.identity.of_scene`. ``source`` renders the
    passes elsewhere.

    With a box filter and the ``independent`` sampler the same scene, seed, size and number of
    passes give the same image to the last bit on the same type of machine, however often the run
    was broken off; otherwise to about 1e-5 (sums are made in parallel).
    """
    _check(scene, time, error, seed, sensor, interval)
    if spp is None and time is None and error is None:
        spp = sampler_of(scene, sensor).sample_count()
    todo = plan_for(scene, spp, sensor, pass_spp)
    state, seconds, keeper, found = Moments(), 0.0, None, None
    if checkpoint is not None:
        path = Path(checkpoint)
        about = identity_of(scene, sensor, seed, identity)
        found, wrong = (checkpoints.load(path) if resume else None) or (None, "")
        if wrong:
            warnings.warn(f"{wrong}: the one before it is used", stacklevel=2)
        if found is not None:
            todo = _go_on(found, about, todo, spp, pass_spp, path)
            state, seconds = found.moments, found.seconds
        keeper = checkpoints.Keeper(
            path,
            {**about, "pass_spp": todo.pass_spp},
            interval,
            keep_present=found is not None and not wrong,
            warn=lambda text: warnings.warn(text, stacklevel=2),
        )
    source = source or partial(_passes_of, scene, sensor)
    run = Run(Targets(todo.passes, time, error), todo.pass_spp, state, seconds)
    sampler = sampler_of(scene, sensor)
    scene_spp = sampler.sample_count()
    try:
        _continue(run, source(todo, seed, state.passes), keeper, on_progress)
    finally:
        sampler.set_sample_count(scene_spp)
        reached = run.stopped is not None and found is not None and not found.finished
        if keeper is not None and (run.moments.passes > state.passes or reached):
            keeper.close(run.moments, run.seconds, run.stopped is not None)
    if unusable := np.count_nonzero(~np.isfinite(run.moments.mean).all(axis=-1)):
        warnings.warn(
            f"{unusable} of {run.moments.mean[..., 0].size} pixels are not finite numbers: "
            "they are in no error",
            stacklevel=2,
        )
    return Image(
        run.moments.mean,
        run.moments.stderr,
        run.moments.passes * todo.pass_spp,
        run.moments.passes,
        seed,
        run.seconds,
        Noise.of(run.moments).error,
        run.stopped or "spp",
    )


def _passes_of(scene: mi.Scene, sensor: int, plan: Plan, seed: int, start: int) -> Iterator[Array]:
    return render_passes(scene, plan, seed, sensor=sensor, start=start)


def _continue(
    run: Run,
    images: Iterator[Array],
    keeper: checkpoints.Keeper | None,
    on_progress: Callable[[Progress], Any] | None,
) -> None:
    """Take images until a target is reached."""
    with contextlib.ExitStack() as stack:
        if isinstance(images, Generator):
            stack.callback(images.close)
        while run.stopped is None and (image := next(images, None)) is not None:
            run.take(image)
            if on_progress is not None:
                on_progress(run.progress())
            if keeper is not None and run.stopped is None:
                keeper.offer(run.moments, run.seconds)


def _check(
    scene: mi.Scene,
    time: float | None,
    error: float | None,
    seed: int,
    sensor: int,
    interval: float,
) -> None:
    if not isinstance(seed, int) or seed < 0:
        raise ValueError(f"seed is {seed}: it must be a whole number >= 0")
    if not 0 <= sensor < len(scene.sensors()):
        raise ValueError(f"sensor is {sensor}: the scene has {len(scene.sensors())} of them")
    if scene.sensors()[sensor].film().class_name() == "SpecFilm":
        raise ValueError("the film is a specfilm: it must be an hdrfilm, whose image is RGB")
    if time is not None and not 0 < time < math.inf:
        raise ValueError(f"time is {time}: it must be a number of seconds > 0")
    if error is not None and not 0 < error < 1:
        raise ValueError(f"error is {error}: it must lie between 0 and 1, as in 0.01 for 1 %")
    if not 0 <= interval < math.inf:
        raise ValueError(f"interval is {interval}: it must be a number of seconds >= 0")


# --------------------------------------------------------------------- resumption


def identity_of(
    scene: mi.Scene, sensor: int, seed: int, identity: Mapping[str, Any] | None
) -> dict[str, Any]:
    """What has to be the same for a render to go on: the scene's, and what it is rendered with."""
    film = scene.sensors()[sensor].film()
    own = sceneid.of_scene(scene) if identity is None else identity
    try:
        own = json.loads(json.dumps(own))  # as it will be read again
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"identity is {identity!r}: it must be what JSON can hold ({error})"
        ) from None
    size, crop, offset = (list(v) for v in (film.size(), film.crop_size(), film.crop_offset()))
    window = {} if crop == size else {"crop": f"{crop[0]}x{crop[1]} at {offset[0]}, {offset[1]}"}
    return {
        **own,
        **window,
        "variant": mi.variant(),
        "size": size,
        "sensor": sensor,
        "seed": seed,
        "versions": sceneid.versions(),
    }


def _go_on(
    found: checkpoints.Checkpoint,
    identity: Mapping[str, Any],
    plan: Plan,
    spp: int | None,
    pass_spp: int | None,
    path: Path,
) -> Plan:
    """The plan by which the render of a checkpoint goes on: with the pass size that it has.

    Raises ``ValueError`` if the checkpoint is of another render.
    """
    size = found.identity["pass_spp"]
    wanted = {**identity, "pass_spp": size if pass_spp is None else plan.pass_spp}
    if differ := sceneid.differences(found.identity, wanted):
        raise ValueError(
            f"checkpoint {str(path)!r} is of another render: {'; '.join(differ)} "
            "(undo that to go on, or delete the file to start over)"
        )
    return Plan(None if spp is None else -(-spp // size), size)
