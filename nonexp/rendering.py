"""Rendering in passes: the mean of independent images, and its standard error.

Mitsuba renders an image in one uninterruptible call. Here it is the mean of passes: images of few
samples per pixel with independent random numbers. Between passes there is progress to report, and
their spread says how noisy the mean is. Works for any scene and integrator of Mitsuba.

>>> import mitsuba as mi, nonexp
>>> mi.set_variant("llvm_ad_rgb")
>>> image = nonexp.render(mi.load_file("scenes/dragon.xml"), spp=64)    # doctest: +SKIP
>>> image.mean.shape, image.stderr.shape                                # doctest: +SKIP
((360, 480, 3), (360, 480, 3))
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

__all__ = [
    "Accumulator",
    "Image",
    "Plan",
    "Progress",
    "pass_seed",
    "passes",
    "plan",
    "planned",
    "render",
]

Array = npt.NDArray[np.float64]

MIN_PASSES = 8
"""Fewest passes, where the number of samples allows: below, the standard error is a guess."""

MAX_PASS_SAMPLES = 1 << 22
"""Most samples of one pass over all pixels: bounds memory, and the wait between two passes."""

# Dr.Jit adds samples to pixels in parallel. The sum is the same in every run if no two threads
# share a pixel: with passes of a power of two that is so for large passes (the work is split in
# multiples of 2^14 samples once there are more than 2^15 per thread) and for at most two SIMD
# packets per pixel. The bounds hold for up to 64 threads and packets of 8 or more.
_LARGE_PASS = 1 << 21
_TWO_PACKETS = 16


# --------------------------------------------------------------------- plan


@dataclass(frozen=True)
class Plan:
    """How the samples of a pixel are divided: ``passes`` passes of ``pass_spp`` each."""

    passes: int
    pass_spp: int

    @property
    def spp(self) -> int:
        """Samples per pixel in total."""
        return self.passes * self.pass_spp


def plan(spp: int, pixels: int) -> Plan:
    """Divide ``spp`` samples per pixel into passes, for an image of ``pixels`` pixels.

    A pass has a power of two of samples per pixel, no more than an eighth of ``spp`` and no more
    than 2^22 in the whole image; ``spp`` is rounded up to whole passes. Small images get passes
    of at most 16, which repeat to the last bit. The plan depends on nothing else, so that it is
    the same on every machine.

    >>> plan(64, 480 * 360), plan(1000, 480 * 360).spp
    (Plan(passes=8, pass_spp=8), 1024)
    """
    if not isinstance(spp, int) or spp < 1:
        raise ValueError(f"spp is {spp}: it must be a whole number >= 1")
    pass_spp = _power_of_two(min(spp // MIN_PASSES, MAX_PASS_SAMPLES // pixels))
    if pixels * pass_spp <= _LARGE_PASS:
        pass_spp = min(pass_spp, _TWO_PACKETS)
    return Plan(-(-spp // pass_spp), pass_spp)


def planned(scene: mi.Scene, spp: int | None = None, sensor: int = 0) -> Plan:
    """The plan by which :func:`render` renders a scene; by default with the scene's own spp.

    A sampler that rounds its number of samples, such as ``stratified``, changes the pass size.
    """
    camera = scene.sensors()[sensor]
    sampler = camera.sampler()
    width, height = camera.film().crop_size()
    scene_spp = sampler.sample_count()
    wanted = plan(scene_spp if spp is None else spp, width * height)
    sampler.set_sample_count(wanted.pass_spp)
    pass_spp = sampler.sample_count()
    sampler.set_sample_count(scene_spp)
    return Plan(wanted.passes, pass_spp)


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
    colours = camera.film().base_channels_count()
    for number in range(start, plan.passes):
        with dr.suspend_grad():
            image = integrator.render(
                scene, sensor=camera, seed=pass_seed(seed, number), spp=plan.pass_spp
            )
        yield _rgb(np.array(image, dtype=np.float64), colours)


def _rgb(image: Array, base_channels: int) -> Array:
    """The colour of a developed film, whose channels are Y, YA, RGB or RGBA, then others."""
    if base_channels >= 3:
        return image[:, :, :3]
    return np.repeat(image[:, :, :1], 3, axis=2)


class Accumulator:
    """Running mean and standard error of images (Welford's method, in double precision)."""

    def __init__(self) -> None:
        self.passes = 0
        self._mean: Array = np.zeros(())
        self._squares: Array = np.zeros(())

    def add(self, image: Array) -> None:
        """Take one more independent image."""
        self.passes += 1
        delta = image - self._mean
        self._mean = self._mean + delta / self.passes
        self._squares = self._squares + delta * (image - self._mean)

    @property
    def mean(self) -> Array:
        """Mean of the images so far."""
        return self._mean

    @property
    def stderr(self) -> Array:
        """Standard error of :attr:`mean`, from the spread of the images; NaN for fewer than 2."""
        if self.passes < 2:
            return np.full_like(self._mean, np.nan)
        stderr: Array = np.sqrt(self._squares / (self.passes - 1) / self.passes)
        return stderr


# --------------------------------------------------------------------- render


@dataclass(frozen=True)
class Progress:
    """State of a run after a pass: ``done`` of ``passes`` passes, after ``seconds``."""

    done: int
    passes: int
    seconds: float


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


def render(
    scene: mi.Scene,
    *,
    spp: int | None = None,
    seed: int = 0,
    sensor: int = 0,
    on_progress: Callable[[Progress], Any] | None = None,
) -> Image:
    """Render a scene in passes.

    ``spp`` is the number of samples per pixel, rounded up to whole passes (see :func:`plan`); by
    default, that of the scene's sampler. ``seed`` is a whole number >= 0. ``on_progress`` is
    called after each pass, and may raise to stop the run.

    With a box filter and the ``independent`` sampler the same scene, spp and seed give the same
    image to the last bit on the same machine; otherwise to about 1e-5 (sums are made in parallel).
    """
    if not isinstance(seed, int) or seed < 0:
        raise ValueError(f"seed is {seed}: it must be a whole number >= 0")
    if not 0 <= sensor < len(scene.sensors()):
        raise ValueError(f"sensor is {sensor}: the scene has {len(scene.sensors())} of them")
    todo = planned(scene, spp, sensor)
    sampler = scene.sensors()[sensor].sampler()
    scene_spp = sampler.sample_count()

    started = time.perf_counter()
    total = Accumulator()
    try:
        for image in passes(scene, todo, seed, sensor=sensor):
            total.add(image)
            if on_progress is not None:
                on_progress(Progress(total.passes, todo.passes, time.perf_counter() - started))
    finally:
        sampler.set_sample_count(scene_spp)
    seconds = time.perf_counter() - started
    return Image(total.mean, total.stderr, todo.spp, total.passes, seed, seconds)
