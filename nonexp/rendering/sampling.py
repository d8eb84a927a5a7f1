"""Which sampler a render takes, and which of its numbers a pass gets.

With ``nonexp_sobol`` passes belong in turn to a few replicates, which are scrambled independently;
the passes of one replicate continue its sequence. The spread of the replicates is the noise.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from typing import Any

import mitsuba as mi

from ..images.moments import Moments, Replicates
from ..system import insides, machine

__all__ = ["SAMPLERS", "SOBOL", "View", "replicates", "sampler_of", "state"]

SAMPLERS = {"sobol": "nonexp_sobol", "independent": "independent"}
"""What can be asked for, and the plugin that it is."""

SOBOL = "nonexp_sobol"

_REPLICATES, _FEW_REPLICATES, _MANY_SAMPLES = 8, 4, 256


def replicates(sampler: str, spp: int | None) -> int | None:
    """Number of replicates for ``spp`` samples per pixel, None where that is not known beforehand.

    More make the standard error more certain, fewer leave longer sequences, which gain more. None
    for a sampler whose passes are all independent.
    """
    if sampler != SOBOL:
        return None
    return _FEW_REPLICATES if spp is not None and spp < _MANY_SAMPLES else _REPLICATES


def state(count: int | None) -> Moments | Replicates:
    """The state of a render with so many replicates that has no pass yet."""
    return Moments() if count is None else Replicates(count)


def sampler_of(camera: Any, wanted: str | None = None) -> str:
    """Plugin name of the sampler that a render with this sensor takes.

    By default ``nonexp_sobol`` in the place of ``independent``, which is what a sensor has if none
    is named, and any other as it is. A ``batch`` of sensors keeps its own. Raises ``ValueError``
    for another one there, and unless ``wanted`` is one of :data:`SAMPLERS`.
    """
    own = own_sampler(camera)
    # A stand-in would be among the sensors that a batch calls.
    fixed = camera.class_name() == "BatchSensor" or not machine.supported(mi.variant())
    if wanted is None:
        return SOBOL if own == "independent" and not fixed else own
    if wanted not in SAMPLERS:
        raise ValueError(f"sampler is {wanted!r}: it must be {' or '.join(SAMPLERS)}")
    if fixed and SAMPLERS[wanted] != own:
        what = "a batch of sensors" if machine.supported(mi.variant()) else mi.variant()
        raise ValueError(f"sampler is {wanted!r}: {what} renders with the scene's own, {own}")
    return SAMPLERS[wanted]


def own_sampler(camera: Any) -> str:
    """Plugin name of the sampler that a sensor has."""
    sampler = camera.sampler()
    if type(sampler).__name__ == "NonexpSobol":
        return SOBOL
    return str(sampler.class_name()).removesuffix("Sampler").lower()


class View:
    """A sensor as a render sees it: with another sampler, where that is not its own.

    Mitsuba cannot give a sensor another sampler. So a sensor that does what the first one does is
    rendered in its place, and the scene stays as it is.
    """

    def __init__(self, camera: Any, sampler: str, pass_spp: int) -> None:
        self.sensor, used = camera, camera.sampler()
        if sampler != own_sampler(camera):
            seed = insides.base_seed(used)
            used = mi.load_dict({"type": sampler, "sample_count": pass_spp, "seed": seed})
            self.sensor = _stand_in(camera, used)
        self._sequence = used if sampler == SOBOL else None

    @contextlib.contextmanager
    def beginning_at(self, sample: int) -> Iterator[None]:
        """What is rendered within begins with this sample of its sequence."""
        if self._sequence is None:
            yield
            return
        self._sequence.first = sample
        try:
            yield
        finally:
            self._sequence.first = 0


_FORWARDED = (
    "sample_ray",
    "sample_ray_differential",
    "sample_direction",
    "pdf_direction",
    "eval_direction",
    "sample_position",
    "pdf_position",
    "eval",
    "sample_wavelengths",
    "bbox",
    "to_string",
)
"""All that a sensor does, in Mitsuba 3.9."""


@functools.cache
def _stand_in_class(variant: str) -> Any:
    """A kind of sensor that does what its ``camera`` does: one for each variant."""

    def forwarded(name: str) -> Any:
        return lambda self, *given, **named: getattr(self.camera, name)(*given, **named)

    base: Any = mi.Sensor
    return type("StandIn", (base,), {name: forwarded(name) for name in _FORWARDED})


def _stand_in(camera: Any, sampler: mi.Sampler) -> Any:
    """A sensor with another sampler that does what ``camera`` does."""
    props = mi.Properties()
    props["film"], props["sampler"] = camera.film(), sampler
    props["shutter_open"] = camera.shutter_open()
    props["shutter_close"] = camera.shutter_open() + camera.shutter_open_time()
    if camera.get_medium() is not None:
        props["medium"] = camera.get_medium()
    sensor = _stand_in_class(mi.variant())(props)
    sensor.camera = camera
    sensor.m_needs_sample_2 = camera.m_needs_sample_2
    sensor.m_needs_sample_3 = camera.m_needs_sample_3
    return sensor
