"""Comparing two images of one scene: how much they differ, and whether that is more than noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from .exr import Picture, independent
from .moments import Array

__all__ = ["BlockTest", "Comparison", "compare", "picture"]

FALSE_ALARM = 0.01
"""Chance that images which differ by noise alone are found to differ."""

_BLOCK, _SMALL_BLOCK, _SMALL_IMAGE = 16, 8, 256
"""Width and height of a block; that in images smaller than so many pixels; pixels."""


@dataclass(frozen=True)
class BlockTest:
    """Block test: the differences of block means in units of their standard errors.

    A block is tested in each colour channel, and so is the whole image; the limit is that of a
    normal variable that all of them together exceed by chance in 1 of 100 comparisons, or as often
    as ``false_alarm`` says.
    """

    blocks: int
    """number of blocks that have noise"""
    worst: float
    """largest deviation of a block or of the whole, in standard errors"""
    place: tuple[int, int] | None
    """column and row of the middle of the block that has it; None: the whole image"""
    limit: float
    """deviation up to which all is noise"""
    chi2: float
    """mean of the squared deviations of the blocks: about 1 if the images differ by noise alone"""
    seen: float
    """relative bias of the whole image that would have been found in 9 of 10 comparisons"""

    @property
    def same(self) -> bool:
        """The images differ by noise alone, as far as this test can see."""
        return self.worst <= self.limit


@dataclass(frozen=True)
class Comparison:
    """Differences between image a and image b, which is taken as the reference."""

    mse: float
    """mean of (a - b)^2 over pixels and channels"""
    rel_mse: float
    """mean of (a - b)^2 / (b^2 + (M/10)^2), where M is the median of b's lit pixels"""
    noise: float | None
    """what the mean of (a - b)^2 would be by noise alone, from the standard errors"""
    bias: float
    """(mean of a - mean of b) / mean of b"""
    bias_error: float | None
    """its standard error"""
    test: BlockTest | None
    """None if an image has no standard error"""


def compare(a: Picture, b: Picture, false_alarm: float = FALSE_ALARM) -> Comparison:
    """Compare two images of equal size.

    ``false_alarm`` is the chance that images which differ by noise alone are found to differ.
    """
    if a.mean.shape != b.mean.shape:
        sizes = [f"{p.path} is {p.mean.shape[1]}x{p.mean.shape[0]}" for p in (a, b)]
        raise ValueError(f"the images differ in size: {' and '.join(sizes)} pixels")
    difference = a.mean - b.mean
    if not np.isfinite(difference).all():
        raise ValueError("there are pixels that are not finite numbers")
    squares = np.square(difference)
    brightness = np.abs(b.mean.mean(axis=2))
    lit = brightness[brightness > 0]
    floor = 0.1 * float(np.median(lit)) if lit.size else 1.0
    level = float(b.mean.mean())
    variance = _variance(a, b)
    return Comparison(
        mse=float(squares.mean()),
        rel_mse=float((squares / (np.square(b.mean) + floor**2)).mean()),
        noise=None if variance is None else float(variance.mean()),
        bias=float(difference.mean()) / level if level else math.nan,
        bias_error=_bias_error(variance, level),
        test=None if variance is None else _test(a, b, variance, abs(level), false_alarm),
    )


def picture(a: Picture, b: Picture) -> tuple[Array, float]:
    """The difference a - b in colours, values in [0, 1], and the difference of full colour.

    Red where a is brighter, blue where b is, white where they agree. Full colour is three times the
    root mean square of the noise or, where that is not known, the 99th percentile of |a - b|.
    """
    difference = (a.mean - b.mean).mean(axis=2)
    variance = _variance(a, b)
    noise = 0.0 if variance is None else 3 * float(np.sqrt(variance.mean()))
    scale = noise or float(np.percentile(np.abs(difference), 99)) or 1.0
    strength = np.clip(np.abs(difference) / scale, 0, 1)[:, :, None]
    red, blue = np.array([0.70, 0.09, 0.17]), np.array([0.13, 0.40, 0.67])
    colour = np.where(difference[:, :, None] > 0, red, blue)
    return 1 - strength * (1 - colour), scale


def _variance(a: Picture, b: Picture) -> Array | None:
    """Variance of a - b; None if an image has no standard error."""
    if a.stderr is None or b.stderr is None:
        return None
    variance = np.square(a.stderr) + np.square(b.stderr)
    return variance if np.isfinite(variance).all() else None


def _bias_error(variance: Array | None, level: float) -> float | None:
    """Standard error of the relative bias; channels count as wholly correlated."""
    if variance is None or not level:
        return None
    per_channel = np.sqrt(variance.sum(axis=(0, 1))) / (variance.shape[0] * variance.shape[1])
    return float(per_channel.mean()) / abs(level)


def _test(a: Picture, b: Picture, variance: Array, level: float, false_alarm: float) -> BlockTest:
    difference = a.mean - b.mean
    height, width, _ = difference.shape
    size = _BLOCK if max(height, width) >= _SMALL_IMAGE else _SMALL_BLOCK
    rows, columns = (np.arange(0, extent, size) for extent in (height, width))

    def block_sums(values: Array) -> Array:
        sums = np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)
        return np.asarray(sums, dtype=np.float64)

    # Welch and Satterthwaite: the variance of each pixel was estimated from independent images.
    spread = np.zeros_like(variance)
    for image in (a, b):
        if image.stderr is not None:
            spread += image.stderr**4 / max(independent(image) - 1, 1)
    rounding = 1e-6 * (np.abs(a.mean) + np.abs(b.mean))
    blocks, whole = (
        _deviations(sums(difference), sums(variance), sums(rounding), sums(spread))
        for sums in (block_sums, lambda values: values.sum(axis=(0, 1)))
    )
    tested = block_sums(variance) > 0
    worst = max(float(blocks.max()), float(whole.max()))
    place = None
    if blocks.max() > whole.max():
        row, column, _ = np.unravel_index(int(blocks.argmax()), blocks.shape)
        place = (
            min(int(columns[column]) + size // 2, width - 1),
            min(int(rows[row]) + size // 2, height - 1),
        )
    limit = float(stats.norm.isf(false_alarm / 2 / (blocks.size + whole.size)))
    seen = (limit + 1.28) * float(np.sqrt(variance.sum(axis=(0, 1))).mean())
    return BlockTest(
        blocks=int(tested.any(axis=2).sum()),
        worst=worst,
        place=place,
        limit=limit,
        chi2=float(np.square(blocks[tested]).mean()) if tested.any() else 0.0,
        seen=seen / (height * width * level) if level else math.nan,
    )


def _deviations(difference: Array, variance: Array, rounding: Array, spread: Array) -> Array:
    """|difference| in standard errors; converted to normal variables of the same probability."""
    raw = np.abs(difference) / np.maximum(np.sqrt(variance + np.square(rounding)), 1e-300)
    known = spread == 0  # not estimated from passes: there is no noise
    freedom = np.where(known, 1e9, np.square(variance) / np.where(known, 1, spread))
    p = stats.t.sf(raw, np.clip(freedom, 1, 1e9))
    return np.where(p > 1e-300, stats.norm.isf(np.maximum(p, 1e-300)), raw)
