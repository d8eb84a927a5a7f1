"""Error, bias, slope and efficiency, from independent passes and a reference.

Notation: ``x_k`` (k = 1 ... N) are the images of independent passes, ``r`` the reference with
known standard error per pixel. All errors are averaged over pixels and channels with weights ``w``
(1 for the MSE, 1/(r^2 + (0.1 mean r)^2) for the relMSE). With ``G_kl = mean w (x_k - r)(x_l - r)``

* ``D``, the mean of ``G_kk``, estimates variance + bias^2 + variance of the reference,
* ``O``, the mean of ``G_kl`` over k != l, estimates bias^2 + variance of the reference.

Both are unbiased, so that the error of the mean of n passes, corrected for the reference, is
``MSE(n) = (D - O) / n + (O - mean w stderr_r^2)``: the second term is what does not go away.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats

from ..images.moments import Array

__all__ = [
    "Bias",
    "Estimate",
    "Figures",
    "Point",
    "Reference",
    "analyse",
    "bootstrapped",
    "fit_slope",
]

FALSE_ALARM = 1e-4
"""Chance that a competitor without bias is called biased: 1 % over a run of 100."""

TILES = 6
"""The image is tested for bias as a whole, and in TILES x TILES tiles."""

ROUNDING = 1e-6
"""Of single precision, relative to the mean of an image: passes that differ by less are equal."""

LEVEL = 0.95
"""Of all intervals."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The right image: ``mean`` and ``stderr`` have shape (height, width, 3), ``grey_stderr``
    (height, width) is the standard error of the mean over channels. Zero where it is exact."""

    mean: Array
    stderr: Array
    grey_stderr: Array
    origin: str

    @staticmethod
    def exact(value: float, size: tuple[int, int], origin: str) -> Reference:
        """The same radiance in all pixels of an image of ``size`` = (width, height)."""
        shape = (size[1], size[0], 3)
        return Reference(np.full(shape, value), np.zeros(shape), np.zeros(shape[:2]), origin)


@dataclass(frozen=True)
class Estimate:
    """A value with its interval at 95 %."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Point:
    """Errors of the mean of ``passes`` passes, which takes ``seconds``.

    ``mse`` and ``relmse`` are means over disjoint groups of passes, ``low`` and ``high`` the 16th
    and 84th percentile of the groups' MSE (equal to it for one group). Corrected for the
    reference's variance, they may come out negative where they are below its noise.
    """

    passes: int
    seconds: float
    mse: float
    low: float
    high: float
    relmse: float


@dataclass(frozen=True)
class Bias:
    """Difference to the reference, relative to the mean of the reference.

    ``mean`` with its standard error ``stderr`` (passes and reference) is that of the whole image.
    ``floor`` is the root mean square over tiles, free of noise, ``floor_high`` its upper bound at
    95 %. ``p`` is the probability of tiles as far off without any bias, ``found`` says p < 1e-4.
    """

    mean: float
    stderr: float
    floor: float
    floor_high: float
    p: float
    found: bool


@dataclass(frozen=True)
class Figures:
    """Results of the passes: seconds per pass (quartiles), error over time, and so on.

    ``variance`` is the MSE of a single pass without bias; ``efficiency`` is 1/(variance * median
    time) in 1/s, ``slope`` the exponent of the MSE over the number of passes: -1 without bias.
    Where all passes are equal variance is 0, efficiency infinite, and there is no slope (nan).
    """

    seconds: tuple[float, float, float]
    variance: float
    curve: list[Point]
    bias: Bias
    slope: Estimate
    efficiency: Estimate


def analyse(passes: Array, seconds: Array, reference: Reference, seed: int = 0) -> Figures:
    """Figures of N >= 4 passes, shape (N, height, width, 3), that took ``seconds``, shape (N,)."""
    count = len(passes)
    if count < 4 or passes.shape[1:] != reference.mean.shape:
        raise ValueError(
            f"passes have shape {passes.shape}: there must be at least 4 of {reference.mean.shape}"
        )
    difference = (passes - reference.mean).astype(np.float64)
    gram, noise, noise_stderr = _gram(difference, np.ones_like(reference.mean), reference)
    softened = reference.mean**2 + (0.1 * reference.mean.mean()) ** 2
    relative_gram, relative_noise, _ = _gram(difference, 1 / softened, reference)
    quartiles = np.quantile(seconds, [0.25, 0.5, 0.75])
    curve = []
    for n in _powers_of_two(count):
        errors = _group_errors(gram, n) - noise
        low, high = np.quantile(errors, [0.16, 0.84])
        relative = float(np.mean(_group_errors(relative_gram, n) - relative_noise))
        time = float(n * quartiles[1])
        curve.append(Point(n, time, float(errors.mean()), float(low), float(high), relative))
    spread = np.diag(gram) - 2 * gram.mean(axis=1) + gram.mean()
    slope = fit_slope(gram, noise, noise_stderr)
    if spread.max() <= (ROUNDING * reference.mean.mean()) ** 2:
        spread, slope = np.zeros(count), Estimate(math.nan, math.nan, math.nan)
    return Figures(
        seconds=(float(quartiles[0]), float(quartiles[1]), float(quartiles[2])),
        variance=float(spread.sum() / (count - 1)),
        curve=curve,
        bias=_bias(difference, reference),
        slope=slope,
        efficiency=_efficiency(spread * count / (count - 1), seconds, seed),
    )


# --------------------------------------------------------------------- error and slope


def _gram(difference: Array, weight: Array, reference: Reference) -> tuple[Array, float, float]:
    """G, the part of it that is the reference's variance, and the standard error of that part.

    The channels of a pixel are taken as fully correlated, which is the worst case; the standard
    error includes the cross term of the reference's noise with that of all passes.
    """
    count, values = len(difference), weight.size
    weighted = (difference * np.sqrt(weight)).reshape(count, values)
    gram = weighted @ weighted.T / values
    variance = weight * reference.stderr**2
    of_mean = weight * difference.var(axis=0, ddof=1) / count
    per_pixel = 2 * variance.sum(axis=2) ** 2
    per_pixel += 4 * (np.sqrt(variance * of_mean)).sum(axis=2) ** 2
    return gram, float(variance.mean()), float(np.sqrt(per_pixel.sum()) / values)


def _powers_of_two(limit: int) -> list[int]:
    return [1 << i for i in range(limit.bit_length())]


def _group_errors(gram: Array, n: int) -> Array:
    """Raw error of the mean of each of the disjoint groups of ``n`` successive passes."""
    groups = len(gram) // n
    square = gram[: groups * n, : groups * n].reshape(groups, n, groups, n)
    errors: Array = np.einsum("aiaj->a", square) / n**2
    return errors


def fit_slope(gram: Array, noise: float = 0.0, noise_stderr: float = 0.0) -> Estimate:
    """Slope of log MSE(n) over log n for n = 1, 2, 4 ... N, by least squares.

    The interval is that of the jackknife over passes, widened by the effect of the reference's own
    noise. MSE(n) is the unbiased estimate over all groups of n passes.
    """
    count = len(gram)
    total, diagonal, rows = gram.sum(), np.diag(gram), gram.sum(axis=1)
    sizes = np.array(_powers_of_two(count), dtype=float)

    def slope(diag: float, rest: float, correction: float) -> float:
        errors = (diag - rest) / sizes + (rest - correction)
        kept = errors > 0
        if kept.sum() < 2:
            return math.nan
        return float(np.polyfit(np.log(sizes[kept]), np.log(errors[kept]), 1)[0])

    trace = diagonal.sum()
    whole = trace / count, (total - trace) / (count * (count - 1))
    left_out = [
        slope(
            (trace - own) / (count - 1),
            (total - trace - 2 * (row - own)) / ((count - 1) * (count - 2)),
            noise,
        )
        for own, row in zip(diagonal, rows, strict=True)
    ]
    value = slope(*whole, noise)
    jackknife = math.sqrt((count - 1) * np.var(left_out))
    reference = abs(slope(*whole, noise + noise_stderr) - slope(*whole, noise - noise_stderr)) / 2
    margin = stats.t.ppf(0.5 + LEVEL / 2, count - 1) * math.hypot(jackknife, reference)
    return Estimate(value, float(value - margin), float(value + margin))


def _efficiency(squares: Array, seconds: Array, seed: int) -> Estimate:
    """1/(variance * median time), with its bootstrap interval over passes."""
    if not np.any(squares > 0):
        return Estimate(math.inf, math.inf, math.inf)

    def efficiency(squares: Array, seconds: Array, axis: int = -1) -> Array:
        return 1 / (squares.mean(axis) * np.median(seconds, axis))

    return bootstrapped((squares, seconds), efficiency, seed)


def bootstrapped(
    samples: tuple[Array, ...], statistic: Callable[..., Array], seed: int
) -> Estimate:
    """A statistic of paired samples, with its bootstrap interval over passes."""
    low, high = stats.bootstrap(
        samples,
        statistic,
        paired=True,
        n_resamples=2000,
        confidence_level=LEVEL,
        method="percentile",
        random_state=np.random.default_rng(seed),
    ).confidence_interval
    return Estimate(float(statistic(*samples)), float(low), float(high))


# --------------------------------------------------------------------- bias


def _bias(difference: Array, reference: Reference) -> Bias:
    grey = difference.mean(axis=3)
    count, scale = len(grey), float(reference.mean.mean())
    rounding = ROUNDING * scale
    parts = [grey, *_tiles(grey)]
    noises = [reference.grey_stderr, *_tiles(reference.grey_stderr)]
    mean = np.array([part.mean() for part in parts])
    sem = np.array([stats.sem(part.mean(axis=(1, 2))) for part in parts])
    # Pixels of a reference are independent: its paths belong to one pixel each.
    known = np.array([np.sqrt(np.sum(noise**2)) / noise.size for noise in noises])
    error = np.sqrt(sem**2 + known**2 + rounding**2)
    freedom = (count - 1) * np.maximum(error**4, 1e-300) / np.maximum(sem**4, 1e-300)  # Welch's
    p = min(1.0, 2 * len(parts) * float(stats.t.sf(np.abs(mean) / error, freedom).min()))
    squares = mean[1:] ** 2 - error[1:] ** 2
    spread = float(stats.sem(squares)) if len(squares) > 1 else math.sqrt(2) * error[0] ** 2
    floor, high = squares.mean(), squares.mean() + stats.norm.ppf(LEVEL) * spread
    return Bias(
        mean=float(mean[0]) / scale,
        stderr=float(error[0]) / scale,
        floor=math.sqrt(max(floor, 0)) / scale,
        floor_high=math.sqrt(max(high, 0)) / scale,
        p=p,
        found=p < FALSE_ALARM,
    )


def _tiles(values: Array) -> list[Array]:
    """Up to TILES x TILES tiles of images whose last two axes are height and width."""
    height, width = values.shape[-2:]
    rows = np.array_split(values, min(TILES, height), axis=-2)
    return [tile for row in rows for tile in np.array_split(row, min(TILES, width), axis=-1)]
