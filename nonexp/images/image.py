"""A rendered image, with its standard error."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .moments import Array

__all__ = ["Image"]


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
    """relative standard error of the image, see :class:`nonexp.images.moments.Noise`"""
    stopped: str = "spp"
    """target that was reached: spp, time or error"""

    @property
    def pass_spp(self) -> int:
        """Samples per pixel of a pass."""
        return self.spp // self.passes
