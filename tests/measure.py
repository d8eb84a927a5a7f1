"""Radiance samples of a scene, and the statistical tests on them.

:func:`radiance` calls an integrator's ``sample()`` once for many independent paths, so that one
kernel yields all passes and every single path can be looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy import stats

PASSES = 64
"""Independent passes that a block mean is averaged over (at least 32: heavy tails)."""

FALSE_ALARM = 1e-5
"""Chance that one comparison fails although nothing is wrong. The whole suite makes fewer than
2000 comparisons: all together cry wolf with a probability below 2 %."""


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


def largest_kernel(run: Callable[[], Any]) -> Any:
    """Of the kernels that ``run`` launches the one of most operations, as Dr.Jit records it."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        run()
        return max(dr.kernel_history([dr.KernelType.JIT]), key=lambda k: k["operation_count"])


def assert_share(samples: Any, expected: float) -> None:
    """Samples are 0 or 1, and 1 with the ``expected`` probability p, by the exact binomial test.

    Finds, with a probability above 0.9, a share off by 5.7 (p (1 - p) / n) ** 0.5: with 2^15
    samples of p = 1/2 by 0.016, with 2^18 by 0.006.
    """
    assert set(np.unique(samples)) <= {0.0, 1.0}
    expected = min(expected, 1.0)
    assert stats.binomtest(int(np.sum(samples)), np.size(samples), expected).pvalue > FALSE_ALARM


def assert_same(a: Any, b: Any, within: float) -> None:
    """Block means agree: Welch's t-test per block and on the whole, Bonferroni-corrected.

    ``within`` states the power: the standard error of the difference of the whole means must be
    below a seventh of that fraction of the mean, so that a relative bias of ``within`` is found
    with a probability above 0.9 (critical value 5.4 for FALSE_ALARM over 37 blocks of 64 passes;
    7 - 5.4 = 1.6 sigma).
    """
    whole_a, whole_b = a.mean(axis=0), b.mean(axis=0)
    mean = 0.5 * (whole_a.mean() + whole_b.mean())
    rounding = 1e-5 * mean
    if np.ptp(a) <= rounding and np.ptp(b) <= rounding:
        assert abs(whole_a.mean() - mean) <= rounding
        return
    error = np.hypot(stats.sem(whole_a), stats.sem(whole_b))
    assert error <= within * mean / 7, f"too weak: error {error / mean:.2%} of the mean"
    if np.ptp(whole_a) <= rounding or np.ptp(whole_b) <= rounding:  # scipy warns of no variance
        whole = 2 * stats.norm.sf(abs(whole_a.mean() - whole_b.mean()) / max(error, rounding))
        assert len(a) == 1
        assert whole > FALSE_ALARM, f"means differ: {whole_a.mean():.6g}, {whole_b.mean():.6g}"
        return
    whole = stats.ttest_ind(whole_a, whole_b, equal_var=False).pvalue
    varying = (np.ptp(a, axis=1) > rounding) | (np.ptp(b, axis=1) > rounding)
    block = stats.ttest_ind(a[varying], b[varying], axis=1, equal_var=False).pvalue
    tests = len(block) + 1
    ratio = whole_a.mean() / whole_b.mean()
    assert whole * tests > FALSE_ALARM, f"means differ: ratio {ratio:.5f}, p = {whole:.2e}"
    worst = int(np.argmin(block))
    assert block[worst] * tests > FALSE_ALARM, (
        f"block {np.flatnonzero(varying)[worst]} differs: "
        f"{a[varying][worst].mean():.5g} against {b[varying][worst].mean():.5g}, "
        f"p = {block[worst]:.2e}"
    )


def assert_mean(samples: Any, expected: float, within: float, rounding: float = 1e-7) -> None:
    """The mean of independent samples is ``expected``; power as in :func:`assert_same`.

    ``rounding`` adds a fraction of the mean to its standard error.
    """
    mean = np.mean(samples)
    error = np.std(samples) / np.sqrt(np.size(samples) - 1) + rounding * abs(mean)
    assert error <= within * abs(expected) / 7, f"too weak: error {error / expected:.2%}"
    score = (mean - expected) / error
    assert abs(score) < stats.norm.isf(FALSE_ALARM / 2), (
        f"mean {mean:.6g}, expected {expected:.6g}: {score:+.1f} standard errors"
    )
