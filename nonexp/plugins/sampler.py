"""The plugin ``nonexp_sobol``: scrambled Sobol points as a sampler of Mitsuba.

:mod:`nonexp.plugins` reloads this module for each variant.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from nonexp.numerics.sobol import DIMENSIONS, mixed, points, scrambled

_AS_BEFORE = 2**32 - 1  # Mitsuba's default for the size of a wavefront
_STEP = 0x9E3779B9  # odd: its multiples differ


class NonexpSobol(mi.Sampler):
    """Plugin ``nonexp_sobol``: Sobol points with Owen scrambling (randomised quasi-Monte Carlo).

    The random numbers of a pixel's samples fill their space evenly: less noise than with as many
    samples of the ``independent`` sampler. Parameters:

    ``sample_count`` (integer > 0, default 4)
        Samples per pixel. Any number is right; a power of two leaves the least noise, because
        only then the points are a net.
    ``seed`` (integer >= 0, default 0)
        Added to the seed of each render.

    Every pixel, dimension and seed has its own scrambling, by a hash. Each number is uniformly
    distributed, so that means have no bias, and pixels are independent of each other. The first 32
    numbers of a path are from the sequence, all others independent. For any integrator of
    Mitsuba's. :func:`nonexp.render` uses this sampler on its own account (see
    ``docs/sampling.md``).
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if self.sample_count() < 1:
            raise ValueError("sample_count is 0: it must be a whole number >= 1")
        self.first = 0
        """number of the point with which the sequences begin"""
        self._offset = props.get("seed", 0)
        self._together: int | None = None  # samples of a pixel in a wavefront, if that was said
        self._block: _Block | None = None
        self._wavefront: _Wavefront | None = None
        self._dimension = mi.UInt32(0)  # all that changes in a loop

    def fork(self) -> NonexpSobol:
        props = mi.Properties("nonexp_sobol")
        props["sample_count"], props["seed"] = self.sample_count(), self._offset
        twin = type(self)(props)
        twin.first, twin._together, twin._block = self.first, self._together, self._block
        return twin

    def clone(self) -> NonexpSobol:
        twin = self.fork()
        twin._wavefront, twin._dimension = self._wavefront, mi.UInt32(self._dimension)
        return twin

    def set_sample_count(self, spp: int) -> None:
        super().set_sample_count(spp)
        self._together = None

    def set_samples_per_wavefront(self, samples_per_wavefront: int) -> None:
        super().set_samples_per_wavefront(samples_per_wavefront)
        self._together = samples_per_wavefront

    def wavefront_size(self) -> int:
        return 0 if self._wavefront is None else self._wavefront.size

    def seed(self, seed: Any, wavefront_size: int = _AS_BEFORE) -> None:
        size = self.wavefront_size() if wavefront_size == _AS_BEFORE else wavefront_size
        if not size:
            raise ValueError(
                "wavefront_size is not given, as it must be at the first call of seed()"
            )
        key = mi.UInt32(seed) + self._offset
        dr.make_opaque(key)
        # Mitsuba's own integrators do not say how many samples of a pixel a wavefront holds: all,
        # unless they split them. Then pixels share a sequence, each with points of its own.
        together = self._together or self.sample_count()
        if self._block is None or not self._block.holds(self.first, together):
            self._block = _Block(self.first, together)
        self._wavefront = _Wavefront(self._block, key, size)
        self._dimension = mi.UInt32(0)

    def advance(self) -> None:
        now = self._seeded()
        self._wavefront = _Wavefront(now.block.next(), now.key, now.size)
        self._dimension = mi.UInt32(0)

    def schedule_state(self) -> None:
        dr.schedule(self._dimension)

    def next_1d(self, active: Any = True) -> mi.Float:
        # Masked or not, so that a dimension means the same for all samples.
        number = self._dimension
        self._dimension = number + 1
        bits = self._seeded().bits(number)
        if dr.type_v(mi.Float) == dr.VarType.Float64:
            return mi.Float(bits) * 2.0**-32
        return mi.Float(mi.Int32(bits >> 8)) * 2.0**-24

    def next_2d(self, active: Any = True) -> mi.Point2f:
        x = self.next_1d(active)
        return mi.Point2f(x, self.next_1d(active))

    def to_string(self) -> str:
        return (
            f"NonexpSobol[\n  base_seed = {self._offset},\n  first = {self.first},\n"
            f"  sample_count = {self.sample_count()}\n]"
        )

    def _seeded(self) -> _Wavefront:
        if self._wavefront is None:
            raise RuntimeError("nonexp_sobol has no numbers before its first call of seed()")
        return self._wavefront


# Neither of these is a dataclass: Dr.Jit would take them for the state of loops, which it would
# then record twice. What differs between passes is opaque: one kernel serves all of them.


class _Block:
    """Points of the sequence that the samples of a pixel get: kept from pass to pass."""

    def __init__(self, first: int, count: int) -> None:
        self._range = (first, count)
        self.points = mi.UInt32(points(first, count).ravel())
        self.first, self.count = dr.opaque(mi.UInt32, first), dr.opaque(mi.UInt32, count)
        self._whole = count & (count - 1) == 0  # a power of two
        self._shift = dr.opaque(mi.UInt32, count.bit_length() - 1) if self._whole else None

    def holds(self, first: int, count: int) -> bool:
        """Whether it is this block."""
        return self._range == (first, count)

    def next(self) -> _Block:
        """The block after it."""
        first, count = self._range
        return _Block(first + count, count)

    def divide(self, lane: Any) -> tuple[Any, Any]:
        """Pixel, and place of its sample in the block."""
        if self._whole:
            return lane >> self._shift, lane & (self.count - 1)
        pixel = lane // self.count
        return pixel, lane - pixel * self.count


class _Wavefront:
    """Where the numbers of a wavefront come from: the same in all turns of a loop."""

    def __init__(self, block: _Block, key: Any, size: int) -> None:
        self.block, self.key, self.size = block, key, size
        pixel, self._place = block.divide(dr.arange(mi.UInt32, size))
        self._of_pixel = mixed(mixed(key) + pixel * _STEP)
        number = self._place + block.first
        self._of_sample = mixed(self._of_pixel ^ (number * 0x85EBCA6B + 0x7F4A7C15))

    def bits(self, dimension: Any) -> Any:
        """The numbers in a dimension, in fractions of 2^32."""
        planned = dimension < DIMENSIONS
        place = dimension * self.block.count + self._place
        x = dr.gather(mi.UInt32, self.block.points, place, planned)
        seed = mixed(dr.select(planned, self._of_pixel, self._of_sample) + dimension * _STEP)
        return dr.select(planned, dr.brev(scrambled(x, seed)), seed)
