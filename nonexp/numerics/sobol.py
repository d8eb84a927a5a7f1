"""Sobol's sequence, scrambled by hashes: numbers that fill the unit cube more evenly than chance.

Points are integers, the fractions of 2^32 that their coordinates are, with their bits reversed: the
first bit of a coordinate is the lowest of the integer. :func:`scrambled` then is Owen's scrambling,
which keeps each point uniformly distributed and a net a net.
"""

from __future__ import annotations

import functools
import threading
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["DIMENSIONS", "mixed", "points", "scrambled"]

DIMENSIONS = 32
"""Coordinates of a point."""

_AT_ONCE = 1 << 14  # points that scipy computes at a time, as doubles
_OF_BYTE = np.packbits(
    np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1), axis=1, bitorder="little"
).ravel()

_lock = threading.Lock()
_engine: Any = None


@functools.lru_cache(maxsize=4)
def points(first: int, count: int) -> npt.NDArray[np.uint32]:
    """Points ``first`` to ``first + count - 1`` of the sequence, shape (DIMENSIONS, count).

    In the order of scipy (Gray code), with direction numbers of Joe and Kuo. For a power of two
    the points from a multiple of it on are a net. Raises ``ValueError`` beyond 2^32 points.
    """
    if first + count > 1 << 32:
        raise ValueError(f"there are 2^32 points, not the {first + count} that are asked for")
    found = np.empty((DIMENSIONS, count), dtype=np.uint32)
    with _lock:
        engine = _advanced(first)
        done = 0
        while done < count:
            # A first call for a number that is no power of two would warn.
            some = min(count - done, _AT_ONCE) if engine.num_generated else 1
            found[:, done : done + some] = (engine.random(some) * 2.0**32).T
            done += some
    return _OF_BYTE[found.view(np.uint8)].view(np.uint32).byteswap()


def _advanced(first: int) -> Any:
    """scipy's sequence, before point number ``first``: it can only go on, or begin again."""
    from scipy.stats import qmc  # slow to load

    global _engine
    if _engine is None or _engine.num_generated > first:
        _engine = qmc.Sobol(DIMENSIONS, scramble=False, bits=32)
    if ahead := first - _engine.num_generated:
        _engine.fast_forward(ahead)
    return _engine


# --------------------------------------------------------------------- on arrays of a kernel


def mixed(x: Any) -> Any:
    """A hash of 32-bit integers that is one-to-one (constants of Wellons's ``lowbias32``)."""
    x = (x ^ (x >> 16)) * 0x7FEB352D
    x = (x ^ (x >> 15)) * 0x846CA68B
    return x ^ (x >> 16)


def scrambled(x: Any, seed: Any) -> Any:
    """Owen scrambling of reversed integers: a bit is flipped or not by a hash of all lower ones.

    Laine and Karras, *Stratified sampling for stochastic transparency* (2011): no step carries
    from high bits to low ones. As in Burley, *Practical hash-based Owen scrambling* (2020), with
    the steps and constants that Vegdahl found to come closer to independent flips. Different
    seeds, well mixed, are independent scramblings.
    """
    x = x ^ (x * 0x3D20ADEA)
    x = (x + seed) * ((seed >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)
