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
import hashlib
import itertools
import json
import math
import re
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from . import checkpoint as checkpoints
from . import sceneid
from .moments import Accumulator, Array, Moments, Noise
from .targets import Progress, Run, Targets

__all__ = [
    "Accumulator",
    "Array",
    "Image",
    "Plan",
    "Progress",
    "Source",
    "identity_of",
    "pass_seed",
    "passes",
    "plan",
    "planned",
    "render",
]

MIN_PASSES = 8
"""Fewest passes, where the number of samples allows: below, the standard error is a guess."""

MAX_PASS_SAMPLES = 1 << 22
"""Most samples of one pass over all pixels: bounds memory, and the wait between two passes."""

# Dr.Jit adds samples to pixels in parallel. The sum is the same in every run if no two threads
# share a pixel: with passes of a power of two that is so for large passes (the work is split in
# multiples of 2^14 samples from 2^15 per thread on) and for at most two SIMD packets per pixel.
# The bounds hold for up to 64 threads and packets of 8 or more.
_LARGE_PASS = 1 << 21
_TWO_PACKETS = 16


# --------------------------------------------------------------------- plan


@dataclass(frozen=True)
class Plan:
    """How the samples of a pixel are divided: ``passes`` passes of ``pass_spp`` each.

    ``passes`` is None where time or noise decides.
    """

    passes: int | None
    pass_spp: int

    @property
    def spp(self) -> int | None:
        """Samples per pixel in total."""
        return None if self.passes is None else self.passes * self.pass_spp


def plan(spp: int | None, pixels: int) -> Plan:
    """Divide ``spp`` samples per pixel into passes, for an image of ``pixels`` pixels.

    A pass has a power of two of samples per pixel, no more than an eighth of ``spp`` and no more
    than 2^22 in the whole image; ``spp`` is rounded up to whole passes. Small images get passes
    of at most 16, which repeat to the last bit; so do all whose ``spp`` is None, not known. The
    plan depends on nothing else, so that it is the same on every machine.

    >>> plan(64, 480 * 360), plan(1000, 480 * 360).spp
    (Plan(passes=8, pass_spp=8), 1008)
    """
    if spp is None:
        return Plan(None, _power_of_two(min(_TWO_PACKETS, MAX_PASS_SAMPLES // pixels)))
    if not isinstance(spp, int) or spp < 1:
        raise ValueError(f"spp is {spp}: it must be a whole number >= 1")
    pass_spp = _power_of_two(min(spp // MIN_PASSES, MAX_PASS_SAMPLES // pixels))
    if pixels * pass_spp < _LARGE_PASS:
        pass_spp = min(pass_spp, _TWO_PACKETS)
    return Plan(-(-spp // pass_spp), pass_spp)


def planned(
    scene: mi.Scene, spp: int | None = None, sensor: int = 0, *, pass_spp: int | None = None
) -> Plan:
    """The plan by which :func:`render` renders ``spp`` samples per pixel, or the scene's own.

    A sampler that rounds its number of samples, such as ``stratified``, changes the pass size.
    ``pass_spp`` chooses it.
    """
    return _planned(scene, spp or _sampler(scene, sensor).sample_count(), sensor, pass_spp)


def _planned(scene: mi.Scene, spp: int | None, sensor: int, pass_spp: int | None) -> Plan:
    width, height = scene.sensors()[sensor].film().crop_size()
    wanted = plan(spp, width * height)
    if pass_spp is not None:
        if not isinstance(pass_spp, int) or pass_spp < 1:
            raise ValueError(f"pass_spp is {pass_spp}: it must be a whole number >= 1")
        wanted = Plan(None if spp is None else -(-spp // pass_spp), pass_spp)
    sampler = _sampler(scene, sensor)
    before = sampler.sample_count()
    sampler.set_sample_count(wanted.pass_spp)
    size = sampler.sample_count()
    sampler.set_sample_count(before)
    return Plan(wanted.passes, size)


def _sampler(scene: mi.Scene, sensor: int) -> Any:
    return scene.sensors()[sensor].sampler()


def _power_of_two(limit: int) -> int:
    """Largest power of two up to ``limit``; at least 1."""
    return 1 << max(limit, 1).bit_length() - 1


def pass_seed(seed: int, number: int) -> int:
    """Seed (32 bits) that Mitsuba gets for pass ``number`` of a run: a hash of both.

    Runs with neighbouring seeds therefore share no pass, as they would with ``seed + number``.
    """
    digest = hashlib.blake2b(f"{seed} {number}".encode(), digest_size=4).digest()
    return int.from_bytes(digest, "little")


# --------------------------------------------------------------------- passes


def passes(
    scene: mi.Scene,
    plan: Plan,
    seed: int = 0,
    *,
    sensor: int = 0,
    integrator: Any = None,
    start: int = 0,
) -> Iterator[Array]:
    """Render the passes of a plan one after the other, from number ``start`` on.

    Yields one image per pass, shape (height, width, 3): red, green and blue, equal in monochrome
    variants. Alpha and other channels of the film are dropped. ``integrator`` is by default the
    scene's.
    """
    camera = scene.sensors()[sensor]
    integrator = scene.integrator() if integrator is None else integrator
    film = camera.film()
    colours = film.base_channels_count()
    of_xyz = _xyz_to_rgb() if re.search(r"pixel_format = xyz", str(film)) else None
    for number in itertools.count(start) if plan.passes is None else range(start, plan.passes):
        with dr.suspend_grad():
            image = integrator.render(
                scene, sensor=camera, seed=pass_seed(seed, number), spp=plan.pass_spp
            )
        values = _rgb(np.array(image, dtype=np.float64), colours)
        yield values if of_xyz is None else values @ of_xyz


def _rgb(image: Array, base_channels: int) -> Array:
    """The colour of a developed film, whose channels are Y, YA, RGB or RGBA, then others."""
    if base_channels >= 3:
        return image[:, :, :3]
    return np.repeat(image[:, :, :1], 3, axis=2)


def _xyz_to_rgb() -> Array:
    """The matrix from CIE XYZ to linear RGB, for rows."""
    rows = [np.array(mi.xyz_to_srgb(mi.Color3f(unit))) for unit in np.eye(3).tolist()]
    return np.array(rows, dtype=np.float64).reshape(3, 3)


# --------------------------------------------------------------------- render


@dataclass(frozen=True, eq=False)
class Image:
    """A rendered image.

    ``mean`` and ``stderr`` (its standard error, NaN after a single pass) have shape (height,
    width, 3) and linear RGB values; ``spp`` samples per pixel were taken in ``passes`` independent
    passes, seeded by ``seed``; ``seconds`` is the time it took.
    """

    mean: Array
    stderr: Array
    spp: int
    passes: int
    seed: int
    seconds: float
    error: float = math.nan
    """relative standard error of the image, see :class:`nonexp.moments.Noise`"""
    stopped: str = "spp"
    """target that was reached: spp, time or error"""

    @property
    def pass_spp(self) -> int:
        """Samples per pixel of a pass."""
        return self.spp // self.passes


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
    confidence (:class:`nonexp.moments.Noise` defines it). By default the samples of the scene's
    sampler. ``seed`` is a whole number >= 0. ``on_progress`` is called after each pass, and may
    raise to stop the run. ``pass_spp`` chooses the samples per pixel of a pass.

    ``checkpoint`` names a file that receives the state every ``interval`` seconds, at the end, and
    when the run is broken off; where it exists the run goes on from there, unless ``resume`` is
    false, and ``ValueError`` says so if it is of another render. What counts as the same render
    is in ``identity``, by default :func:`nonexp.sceneid.of_scene`. ``source`` renders the passes
    elsewhere.

    With a box filter and the ``independent`` sampler the same scene, seed, size and number of
    passes give the same image to the last bit on the same type of machine, however often the run
    was broken off; otherwise to about 1e-5 (sums are made in parallel).
    """
    _check(scene, time, error, seed, sensor, interval)
    if spp is None and time is None and error is None:
        spp = _sampler(scene, sensor).sample_count()
    todo = _planned(scene, spp, sensor, pass_spp)
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
    source = source or partial(_here, scene, sensor)
    run = Run(Targets(todo.passes, time, error), todo.pass_spp, state, seconds)
    sampler = _sampler(scene, sensor)
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


def _here(scene: mi.Scene, sensor: int, plan: Plan, seed: int, start: int) -> Iterator[Array]:
    return passes(scene, plan, seed, sensor=sensor, start=start)


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
    if differ := checkpoints.differences(found.identity, wanted):
        raise ValueError(
            f"checkpoint {str(path)!r} is of another render: {'; '.join(differ)} "
            "(undo that to go on, or delete the file to start over)"
        )
    return Plan(None if spp is None else -(-spp // size), size)
