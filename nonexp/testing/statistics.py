"""Radiance samples of a scene, and the statistical tests on them.

:func:`radiance` calls an integrator's ``sample()`` once for many independent paths, so that one
kernel yields all passes and every single path can be looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy import stats

__all__ = [
    "FALSE_ALARM",
    "PASSES",
    "Agreement",
    "assert_same",
    "assert_share",
    "mean_is",
    "passes",
    "radiance",
    "reach",
    "sampled",
]

PASSES = 64
"""Independent passes that a block mean is averaged over (at least 32: heavy tails)."""

FALSE_ALARM = 1e-5
"""Chance that one comparison fails although nothing is wrong. A suite that makes fewer than 2000
comparisons cries wolf with a probability below 2 %."""

_FOUND = float(stats.norm.isf(0.1))
"""Standard errors beyond the limit of a test at which a bias is found in 9 of 10 runs."""


@dataclass(frozen=True)
class Agreement:
    """Two images, or an image and a number, that agree: how well, and how well that was tested."""

    difference: float
    """relative difference of the means, a over b less 1"""
    error: float
    """its standard error"""
    finds: float
    """relative bias of the whole that would have been found with a probability of 0.9"""
    finds_in_a_block: float
    """the same in a single block of the image, on average"""
    tests: int
    """number of tests, for which the limit is corrected"""

    def __str__(self) -> str:
        return (
            f"means agree within {self.error:.2%} (standard error); a bias of {self.finds:.2%} of "
            f"the whole, or of {self.finds_in_a_block:.2%} in one block, would have been found"
        )


# --------------------------------------------------------------------- samples


def radiance(scene: Any, count: int, seed: int, grid: int = 1, channels: bool = False) -> Any:
    """``count`` paths through each cell of a ``grid`` x ``grid`` film: (cells, count) means over
    channels, or with ``channels`` all of them, (channels, cells, count)."""
    sensor = scene.sensors()[0]
    cells = grid * grid
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, cells * count)
    cell = dr.arange(mi.UInt32, cells * count) // count
    corner = mi.Point2f(cell % grid, cell // grid)
    position = (corner + sampler.next_2d()) / grid
    ray, weight = sensor.sample_ray_differential(
        sampler.next_1d(), sampler.next_1d(), position, sampler.next_2d()
    )
    light, _, _ = scene.integrator().sample(scene, sampler, ray, sensor.get_medium(), True)
    light *= weight
    shape = (-1, cells, count) if channels else (cells, count)
    return np.array(light if channels else dr.mean(light), dtype=np.float64).reshape(shape)


def passes(scene: Any, count: int, seed: int, grid: int = 1, channels: bool = False) -> Any:
    """Block means of :data:`PASSES` independent passes: (cells, PASSES), or one for each of the
    ``channels``."""
    values = radiance(scene, count * PASSES, seed, grid, channels)
    return values.reshape(*values.shape[:-1], PASSES, count).mean(axis=-1)


# --------------------------------------------------------------------- tests


def assert_share(samples: Any, expected: float) -> None:
    """Samples are 0 or 1, and 1 with the ``expected`` probability p, by the exact binomial test.

    Finds, with a probability above 0.9, a share off by 5.7 (p (1 - p) / n) ** 0.5: with 2^15
    samples of p = 1/2 by 0.016, with 2^18 by 0.006.
    """
    assert set(np.unique(samples)) <= {0.0, 1.0}, "samples are not all 0 or 1"
    expected = min(expected, 1.0)
    found, count = int(np.sum(samples)), np.size(samples)
    p = stats.binomtest(found, count, expected).pvalue
    assert p > FALSE_ALARM, f"share {found / count:.6g}, expected {expected:.6g}: p = {p:.1e}"


def assert_same(a: Any, b: Any, within: float, *, comparisons: int = 1) -> Agreement:
    """Block means, shape (blocks, passes), agree: Welch's t-test per block and on the whole.

    The limit is corrected (Bonferroni) for the number of blocks, and of ``comparisons`` of which
    this is one. ``within`` states the power: the standard error of the difference of the whole
    means must be below a seventh of that fraction of the mean, so that a relative bias of
    ``within`` is found with a probability above 0.9 (critical value 5.4 for FALSE_ALARM over 37
    blocks of 64 passes; 7 - 5.4 = 1.6 sigma).
    """
    whole_a, whole_b = a.mean(axis=0), b.mean(axis=0)
    mean = 0.5 * (whole_a.mean() + whole_b.mean())
    rounding = 1e-5 * abs(mean)
    difference = (whole_a.mean() - whole_b.mean()) / whole_b.mean() if whole_b.mean() else 0.0
    if np.ptp(a) <= rounding and np.ptp(b) <= rounding:
        assert abs(whole_a.mean() - mean) <= rounding, _brighter(whole_a, whole_b, 0.0)
        return Agreement(difference, 0.0, 2e-5, 2e-5, 1)
    error = np.hypot(stats.sem(whole_a), stats.sem(whole_b))
    assert error <= within * abs(mean) / 7, (
        f"too weak: standard error {error / mean:.2%} of the mean, which finds a bias of "
        f"{7 * error / mean:.2%}, not of {within:.2%}"
    )
    if np.ptp(whole_a) <= rounding or np.ptp(whole_b) <= rounding:  # scipy warns of no variance
        whole = 2 * stats.norm.sf(abs(whole_a.mean() - whole_b.mean()) / max(error, rounding))
        assert len(a) == 1
        assert whole * comparisons > FALSE_ALARM, _brighter(whole_a, whole_b, error, p=whole)
        return _agreement(difference, error / mean, error / mean, comparisons, len(whole_a))
    whole = stats.ttest_ind(whole_a, whole_b, equal_var=False).pvalue
    varying = (np.ptp(a, axis=1) > rounding) | (np.ptp(b, axis=1) > rounding)
    block = stats.ttest_ind(a[varying], b[varying], axis=1, equal_var=False).pvalue
    tests = (len(block) + 1) * comparisons
    alike = _alike(a[varying], b[varying], tests)
    text = _brighter(whole_a, whole_b, error, alike, whole)
    assert whole * tests > FALSE_ALARM, text
    worst = int(np.argmin(block))
    assert block[worst] * tests > FALSE_ALARM, (
        f"block {np.flatnonzero(varying)[worst]} of {len(a)} differs: "
        f"{a[varying][worst].mean():.5g} against {b[varying][worst].mean():.5g}, "
        f"p = {block[worst]:.2e}"
    )
    in_a_block = np.hypot(stats.sem(a, axis=1), stats.sem(b, axis=1)).mean() / mean
    return _agreement(difference, error / mean, in_a_block, tests, len(whole_a))


def mean_is(samples: Any, expected: float, within: float, rounding: float = 1e-7) -> Agreement:
    """The mean of independent samples is ``expected``; power as in :func:`assert_same`.

    ``rounding`` adds a fraction of the mean to its standard error.
    """
    mean = np.mean(samples)
    error = np.std(samples) / np.sqrt(np.size(samples) - 1) + rounding * abs(mean)
    assert error <= within * abs(expected) / 7, f"too weak: error {error / expected:.2%}"
    score = (mean - expected) / error if error else 0.0 if mean == expected else np.inf
    limit = stats.t.isf(FALSE_ALARM / 2, np.size(samples) - 1)
    assert abs(score) < limit, (
        f"mean {mean:.6g}, expected {expected:.6g}: {score:+.1f} standard errors, "
        f"{mean / expected - 1 if expected else np.inf:+.2%}"
    )
    scale = abs(expected) or 1.0
    relative = error / scale
    return _agreement((mean - expected) / scale, relative, relative, 1, np.size(samples))


def sampled(
    run: Callable[[int], tuple[Any, Any]], within: float, count: int, most: int
) -> tuple[Any, Any]:
    """Two sets of block means of ``count`` samples, or of as many as :func:`assert_same` needs.

    ``run`` renders both with a number of samples. Raises ``AssertionError`` where more than
    ``most`` are needed.
    """
    while True:
        a, b = run(count)
        mean = abs(0.5 * (a.mean() + b.mean()))
        error = np.hypot(stats.sem(a.mean(axis=0)), stats.sem(b.mean(axis=0)))
        if not math.isfinite(error) or error <= within * mean / 7 or not mean:
            return a, b
        needed = math.ceil(1.2 * count * (7 * error / (within * mean)) ** 2)
        assert needed <= most, (
            f"too weak: a bias of {within:.2%} needs about {needed} samples where {most} are "
            f"allowed; {count} samples find one of {7 * error / mean:.2%}"
        )
        count = needed


# --------------------------------------------------------------------- words


def reach(tests: int, passes: int) -> float:
    """Standard errors at which one of so many tests of two means of so many passes finds a
    difference with a probability of 0.9."""
    return float(stats.t.isf(FALSE_ALARM / tests / 2, 2 * passes - 2)) + _FOUND


def _agreement(
    difference: float, error: float, in_a_block: float, tests: int, passes: int
) -> Agreement:
    finds, block = (reach(tests, passes) * abs(e) for e in (error, in_a_block))
    return Agreement(float(difference), abs(float(error)), float(finds), float(block), tests)


def _alike(a: Any, b: Any, tests: int) -> bool:
    """Whether one factor explains the difference of all blocks."""
    factor = a.mean() / b.mean() if b.mean() else 1.0
    found = stats.ttest_ind(a, factor * b, axis=1, equal_var=False).pvalue
    return bool(np.nanmin(found) * tests > FALSE_ALARM)


def _brighter(a: Any, b: Any, error: float, alike: bool = True, p: float = 0.0) -> str:
    ratio = a.mean() / b.mean() if b.mean() else np.inf
    word = "brighter" if ratio > 1 else "darker"
    where = "everywhere by the same factor" if alike else "not everywhere alike"
    if not np.isfinite(ratio):
        return f"means differ: {a.mean():.6g} against {b.mean():.6g}, p = {p:.2e}"
    return (
        f"means differ: the first is {word} than the second by {abs(ratio - 1):.2%} "
        f"(standard error {error / abs(b.mean()):.2%}), {where}: {a.mean():.6g} against "
        f"{b.mean():.6g}, ratio {ratio:.5f}, p = {p:.2e}"
    )
