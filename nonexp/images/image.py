"""A rendered image, with its standard error."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .moments import Array
from .png import encode, tone_map

__all__ = ["Image"]


@dataclass(frozen=True, eq=False, repr=False)
class Image:
    """A rendered image.

    ``mean`` and ``stderr`` (its standard error, NaN after a single pass) have shape (height,
    width, 3) and linear RGB values; ``spp`` samples per pixel were taken in ``passes`` passes,
    seeded by ``seed``; ``seconds`` is the time it took. Jupyter shows it tone-mapped.
    """

    mean: Array
    stderr: Array
    spp: int
    passes: int
    seed: int
    seconds: float
    error: float = math.nan
    """relative standard error of the image, see :class:`nonexp.images.moments.Noise`; NaN after
    a single pass, and for an image that is black everywhere"""
    stopped: str = "spp"
    """target that was reached: spp, time or error"""
    independent: int | None = None
    """number of independent images that ``stderr`` was estimated from; None: all passes are"""

    @property
    def pass_spp(self) -> int:
        """Samples per pixel of a pass."""
        return self.spp // self.passes

    @property
    def black(self) -> bool:
        """The image is black everywhere."""
        return not self.mean.any()

    def __repr__(self) -> str:
        height, width = self.mean.shape[:2]
        error = "unknown" if math.isnan(self.error) else f"{self.error:.2%}"
        return (
            f"Image({width}x{height}, spp={self.spp}, passes={self.passes}, seed={self.seed}, "
            f"seconds={self.seconds:.3g}, error={error}, stopped={self.stopped!r})"
        )

    def _repr_png_(self) -> bytes:
        return encode(tone_map(self.mean))
