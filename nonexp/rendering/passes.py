"""The passes of a render: how samples are divided, seeds, and rendering them one by one."""

from __future__ import annotations

import hashlib
import itertools
import operator
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..images.moments import Array
from ..system import insides
from .sampling import View, own_sampler, replicates, sampler_of

__all__ = [
    "MAX_PASS_SAMPLES",
    "MIN_PASSES",
    "Plan",
    "pass_seed",
    "plan",
    "planned",
    "render_passes",
]

MIN_PASSES = 8
"""Fewest passes, where the number of samples allows: below, the standard error is a guess."""

MAX_PASS_SAMPLES = 1 << 22
"""Most samples of a pass over all pixels: bounds memory, and the time between two passes."""

_OPEN_ENDED = 16
"""Samples per pixel of a pass, at most, where time or noise decides when a render ends."""

# Dr.Jit adds samples to pixels in parallel. The sum is the same in every run if no two threads
# share a pixel: with passes of a power of two that is so for large passes (the work is split in
# multiples of 2^14 samples from 2^15 per thread on) and for one SIMD packet per pixel (two do not
# repeat). The bounds hold for up to 64 threads and packets of 8 or more.
_LARGE_PASS = 1 << 21
_ONE_PACKET = 8


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

    def for_spp(self, spp: int | None) -> Plan:
        """Passes of this size for ``spp`` samples per pixel, rounded up to whole passes."""
        return Plan(None if spp is None else -(-spp // self.pass_spp), self.pass_spp)


def plan(spp: int | None, pixels: int) -> Plan:
    """Divide ``spp`` samples per pixel into passes, for an image of ``pixels`` pixels.

    A pass has a power of two of samples per pixel, no more than an eighth of ``spp`` and no more
    than 2^22 in the whole image; ``spp`` is rounded up to whole passes. Passes of fewer than 2^21
    samples in the whole image get at most 8 per pixel: then they repeat to the last bit. Where
    ``spp`` is None, not known, a pass has at most 16. The plan depends on nothing else, so that it
    is the same on every machine.

    >>> plan(64, 480 * 360), plan(1000, 480 * 360).spp
    (Plan(passes=8, pass_spp=8), 1008)
    """
    if spp is None:
        return Plan(None, _pass_spp(_OPEN_ENDED, pixels))
    spp = whole("spp", spp, 1)
    pass_spp = _pass_spp(spp // MIN_PASSES, pixels)
    return Plan(-(-spp // pass_spp), pass_spp)


def _pass_spp(most: int, pixels: int) -> int:
    wanted = _power_of_two(min(most, MAX_PASS_SAMPLES // pixels))
    return wanted if pixels * wanted >= _LARGE_PASS else min(wanted, _ONE_PACKET)


def planned(
    scene: mi.Scene,
    spp: int | None = None,
    sensor: int | str | mi.Sensor = 0,
    *,
    pass_spp: int | None = None,
    sampler: str | None = None,
) -> Plan:
    """The plan by which :func:`render` renders ``spp`` samples per pixel, or the scene's own.

    A sampler that rounds its number of samples, such as ``stratified``, changes the pass size.
    ``pass_spp`` chooses it, ``sampler`` another sampler, as for :func:`render`.
    """
    camera = scene.sensors()[sensor_number(scene, sensor)]
    spp = camera.sampler().sample_count() if spp is None else spp
    return plan_for(camera, spp, pass_spp, sampler_of(camera, sampler))


def plan_for(camera: Any, spp: int | None, pass_spp: int | None, sampler: str) -> Plan:
    """The plan for a sensor and a sampler, with ``spp`` None where time or noise decides."""
    width, height = camera.film().crop_size()
    wanted = plan(spp, width * height)
    if pass_spp is not None:
        wanted = Plan(None, whole("pass_spp", pass_spp, 1)).for_spp(spp)
    if sampler != own_sampler(camera):
        return wanted  # those that can be asked for do not round
    own = camera.sampler()
    before = own.sample_count()
    own.set_sample_count(wanted.pass_spp)
    size = own.sample_count()
    own.set_sample_count(before)
    return Plan(wanted.passes, size)


def whole(name: str, value: Any, low: int) -> int:
    """A whole number, NumPy's among them; raises ``ValueError`` unless it is at least ``low``."""
    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1
    if number < low:
        raise ValueError(f"{name} is {value}: it must be a whole number >= {low}")
    return number


def sensor_number(scene: mi.Scene, sensor: int | str | mi.Sensor) -> int:
    """The number of a sensor that is given by its number, its id or itself."""
    sensors: list[Any] = scene.sensors()
    ids = [one.id() for one in sensors]
    if isinstance(sensor, mi.Sensor):
        found = [number for number, one in enumerate(sensors) if one is sensor]
    elif sensor and sensor in ids:
        found = [ids.index(sensor)]
    else:
        try:
            number = int(sensor) if isinstance(sensor, str) else operator.index(sensor)
        except (TypeError, ValueError):
            number = -1
        found = [number] if 0 <= number < len(sensors) else []
    if not found:
        named = ", ".join(f"{n} ({name})" if name else f"{n}" for n, name in enumerate(ids))
        said = sensor.id() if isinstance(sensor, mi.Sensor) else sensor
        raise ValueError(
            f"sensor is {said!r}: it must be one of the scene's: {named or 'it has none'}"
        )
    return found[0]


def _power_of_two(limit: int) -> int:
    """Largest power of two up to ``limit``; at least 1."""
    return 1 << max(limit, 1).bit_length() - 1


def pass_seed(seed: int, number: int) -> int:
    """Seed (32 bits) that Mitsuba gets for independent pass or replicate ``number`` of a run.

    A hash of both: runs with neighbouring seeds share no pass, as with ``seed + number``.
    """
    digest = hashlib.blake2b(f"{seed} {number}".encode(), digest_size=4).digest()
    return int.from_bytes(digest, "little")


# --------------------------------------------------------------------- passes


def render_passes(
    scene: mi.Scene,
    plan: Plan,
    seed: int = 0,
    *,
    sensor: int | str | mi.Sensor = 0,
    integrator: Any = None,
    start: int = 0,
    sampler: str | None = None,
    count: int | None = None,
) -> Iterator[Array]:
    """Render the passes of a plan one after the other, from number ``start`` on.

    Yields one image per pass, shape (height, width, 3): red, green and blue, equal in monochrome
    variants. Alpha and other channels of the film are dropped. ``integrator`` is by default the
    scene's, ``sampler`` as for :func:`render`. With ``nonexp_sobol`` pass k belongs to replicate
    ``k % count`` (by default 8, or 4 for a plan of less than 256 samples per pixel): passes of one
    replicate continue its sequence and depend on each other. With other samplers all passes are
    independent.
    """
    camera = scene.sensors()[sensor_number(scene, sensor)]
    plugin = sampler_of(camera, sampler)
    count = replicates(plugin, plan.spp) if count is None else count
    view = View(camera, plugin, plan.pass_spp)
    integrator = scene.integrator() if integrator is None else integrator
    film = camera.film()
    colours = film.base_channels_count()
    of_xyz = _xyz_to_rgb() if insides.is_xyz(film) else None
    for number in itertools.count(start) if plan.passes is None else range(start, plan.passes):
        turn, sequence = (0, number) if count is None else divmod(number, count)
        with dr.suspend_grad(), view.beginning_at(turn * plan.pass_spp):
            image = integrator.render(
                scene, sensor=view.sensor, seed=pass_seed(seed, sequence), spp=plan.pass_spp
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
