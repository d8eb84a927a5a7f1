"""Running mean and standard error of images, and how noisy an image is as a whole."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "Moments", "Noise", "Replicates"]

Array = npt.NDArray[np.float64]

_CONFIDENCE = 1.645  # standard deviations of a normal variable: 95 % lie below
_DARK = 0.1


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean of ``passes`` independent images, and their squared deviations from it.

    Immutable: :meth:`plus` makes a new one, so that a checkpoint being written never changes.
    Welford's method, in double precision: stable over any number of passes. These three fields are
    all the state of a render with independent passes.
    """

    passes: int = 0
    mean: Array = field(default_factory=lambda: np.zeros(()))
    squares: Array = field(default_factory=lambda: np.zeros(()))
    """sum over the images of (image - mean)^2"""

    def plus(self, image: Array) -> Moments:
        """These images and one more."""
        passes = self.passes + 1
        with np.errstate(invalid="ignore"):  # infinite values: the pixel becomes NaN
            delta = image - self.mean
            mean = self.mean + delta / passes
            return Moments(passes, mean, self.squares + delta * (image - mean))

    @property
    def independent(self) -> int:
        """Number of independent images."""
        return self.passes

    @property
    def stderr(self) -> Array:
        """Standard error of the mean, from the spread of the images; NaN for fewer than 2."""
        if self.passes < 2:
            return np.full_like(self.mean, np.nan)
        stderr: Array = np.sqrt(self.squares / (self.passes - 1) / self.passes)
        return stderr

    @property
    def lit(self) -> bool:
        """Whether anything is there but zeros and what is no number."""
        return _lit(self.mean)


@dataclass(frozen=True, eq=False)
class Replicates:
    """Mean of ``passes`` images that belong to ``count`` independent replicates in turn.

    Image number k belongs to replicate ``k % count``. The images of one replicate depend on each
    other, so that the spread of the replicates says how noisy the mean is. Immutable. These three
    fields are all the state of a render that continues its sequences from pass to pass.
    """

    count: int
    passes: int = 0
    sums: tuple[Array, ...] = ()
    """sum of the images of each replicate that has one"""

    def plus(self, image: Array) -> Replicates:
        """These images and one more."""
        sums, place = list(self.sums), self.passes % self.count
        if place == len(sums):
            sums.append(np.array(image, dtype=np.float64))
        else:
            sums[place] = sums[place] + image
        return replace(self, passes=self.passes + 1, sums=tuple(sums))

    @property
    def independent(self) -> int:
        """Number of independent images: of replicates that have begun."""
        return len(self.sums)

    @cached_property
    def mean(self) -> Array:
        """Mean of all images."""
        total = sum(self.sums, start=np.zeros(()))
        return total / max(self.passes, 1)

    @property
    def stderr(self) -> Array:
        """Standard error of the mean, from the spread of the replicates; NaN for fewer than 2.

        With w of n passes in each of R replicates, it is the root of sum(w (m - mean)^2) /
        (n (R - 1)), where m is the mean of a replicate: right if all have as many passes, or if
        variance falls as 1 / w, and too large rather than too small if it falls faster.
        """
        mean = self.mean
        if self.independent < 2:
            return np.full_like(mean, np.nan)
        squares = np.zeros_like(mean)
        with np.errstate(invalid="ignore"):  # infinite values: the pixel becomes NaN
            for place, one in enumerate(self.sums):
                weight = -(-(self.passes - place) // self.count)
                term = one / weight
                term -= mean
                term *= term
                term *= weight
                squares += term
        squares /= self.passes * (self.independent - 1)
        return np.sqrt(squares, out=squares)

    @property
    def lit(self) -> bool:
        """Whether anything is there but zeros and what is no number."""
        return any(_lit(one) for one in self.sums)


def _lit(values: Array) -> bool:
    return bool(np.nan_to_num(values).any())


@dataclass(frozen=True)
class Noise:
    """How noisy an image is as a whole: its relative standard error.

    Let L be the brightness of a pixel (mean over its channels), s its standard error (root mean
    square over its channels), and M the median of L over all pixels that are not black. Then

        error = root mean square of s / max(L, M / 10) over all pixels that are not black.

    Each pixel counts by its relative error, so that a light in the picture does not hide the noise
    of the rest; dark pixels are held to a tenth of the median instead of to nothing; black
    background does not dilute; no pixel counts for more than 1.8. NaN, unknown, after a single pass
    and for an image that is black everywhere: nothing says how far it is from the true one.
    """

    error: float
    """expected root mean square of the relative deviation from the true image"""
    bound: float
    """the actual one lies below this in 95 of 100 renders"""

    @staticmethod
    def of(moments: Moments | Replicates) -> Noise:
        """Noise of the mean of images of shape (height, width, channels)."""
        return Noise.between(moments.mean, moments.stderr, moments.independent)

    @staticmethod
    def between(mean: Array, stderr: Array, independent: int) -> Noise:
        """Noise of an image with this standard error, estimated from so many independent ones."""
        if independent < 2:
            return Noise(math.nan, math.nan)
        brightness = np.abs(mean.mean(axis=2))
        lit = brightness > 0
        if not lit.any():
            return Noise(math.nan, math.nan)
        brightness = brightness[lit]
        floor = _DARK * np.median(brightness)
        squares = np.square(stderr).mean(axis=2)[lit] / np.square(np.maximum(brightness, floor))
        total = squares.sum()
        if total == 0:
            return Noise(0.0, 0.0)
        # Relative variance of the sum of squares: 2 per pixel if normal, by its share of the sum;
        # once for the image at hand, and 1/(n - 1) for the estimate from n independent ones.
        variance = 2 * np.square(squares / total).sum() * independent / (independent - 1)
        error = math.sqrt(total / squares.size)
        return Noise(error, error * math.sqrt(1 + _CONFIDENCE * math.sqrt(variance)))
