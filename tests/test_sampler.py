"""The sampler nonexp_sobol: nets, independence, passes; and how renders use it."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from tiers import quick

from nonexp.numerics import sobol

pytestmark = pytest.mark.usefixtures("several_threads")


def sampler(count: int, pixels: int = 1, seed: int = 0, first: int = 0, **given: Any) -> Any:
    """A seeded sampler of ``count`` samples for each of the pixels."""
    made: Any = mi.load_dict({"type": "nonexp_sobol", "sample_count": count, **given})
    made.first = first
    made.seed(seed, count * pixels)
    return made


def numbers(source: Any, dimensions: int, pixels: int = 1) -> Any:
    """The next numbers of all samples: (dimensions, pixels, samples of a pixel)."""
    drawn = np.array([np.array(source.next_1d()) for _ in range(dimensions)], dtype=np.float64)
    return drawn.reshape(dimensions, pixels, -1)


# --------------------------------------------------------------------- points


def test_points_are_those_of_scipy() -> None:
    from scipy.stats import qmc

    expected = qmc.Sobol(sobol.DIMENSIONS, scramble=False, bits=32).random(64)
    for first, count in ((0, 64), (0, 5), (5, 7), (48, 16), (3, 1)):
        reversed_bits = dr.brev(mi.UInt32(sobol.points(first, count).ravel()))
        found = np.array(reversed_bits).reshape(sobol.DIMENSIONS, count).T * 2.0**-32
        np.testing.assert_array_equal(found, expected[first : first + count])
    with pytest.raises(ValueError, match=r"there are 2\^32 points, not the"):
        sobol.points(2**32 - 8, 16)


@pytest.mark.parametrize("count", quick([1, 2, 16, 256], lambda n: n == 16))
def test_nets_are_nets_after_scrambling(count: int) -> None:
    """Of the 2^m points from a multiple of 2^m on, each elementary interval holds one.

    In each single dimension, and in the first two of them for all shapes of intervals.
    """
    pixels = 7
    for block in (0, 1, 6):
        drawn = numbers(sampler(count, pixels, 3, block * count), sobol.DIMENSIONS, pixels)
        assert 0 <= drawn.min() and drawn.max() < 1
        cells = np.sort(np.floor(drawn * count), axis=2)
        np.testing.assert_array_equal(cells, np.broadcast_to(np.arange(count), cells.shape))
        for wide in (1 << k for k in range(count.bit_length())):
            x, y = np.floor(drawn[0] * wide), np.floor(drawn[1] * (count // wide))
            cells = np.sort(x * (count // wide) + y, axis=1)
            np.testing.assert_array_equal(cells, np.broadcast_to(np.arange(count), cells.shape))


def test_scrambling_flips_a_bit_by_higher_ones_only() -> None:
    """And is one-to-one; flips are as likely as not, by the bits above and by the seed."""
    x = np.random.default_rng(1).integers(0, 2**32, 4096, dtype=np.uint32)
    for bit in (0, 5, 17, 31):
        lower = np.uint32(2**bit - 1)
        changed = sobol.scrambled(mi.UInt32(x ^ (1 << bit)), mi.UInt32(7))
        difference = np.array(changed) ^ np.array(sobol.scrambled(mi.UInt32(x), mi.UInt32(7)))
        assert not (difference & lower).any() and ((difference >> bit) & 1).all()


def test_flips_are_independent_and_as_likely_as_not() -> None:
    """Of bit k, for all 2^k patterns of the bits before it, over 2^14 seeds; k = 0 to 4.

    Means and correlations of all 31 flips have a standard deviation of 2^-7 and 2^-7: 5.5 of these
    in one of 496 have a probability below 1e-4.
    """
    seeds = sobol.mixed(dr.arange(mi.UInt32, 2**14) * 3)
    flips = []
    for k in range(5):
        for pattern in range(2**k):
            found = np.array(sobol.scrambled(mi.UInt32(pattern), seeds))
            flips.append(1.0 - 2.0 * ((found >> k) & 1))
    signs = np.array(flips)
    assert len(np.unique(np.array(seeds))) == 2**14
    assert np.abs(signs.mean(axis=1)).max() < 5.5 / 2**7
    correlation = signs @ signs.T / 2**14 - np.eye(len(signs))
    assert np.abs(correlation).max() < 5.5 / 2**7


# --------------------------------------------------------------------- the sampler


def test_each_number_is_uniform_and_independent_of_other_pixels_and_seeds() -> None:
    """Sample 5 of 16 in 2^14 pixels: dimensions of points, and hashed ones; two seeds.

    A chi-square of 64 cells for each, and correlations between all, also with the pixel beside.
    """
    pixels, shown = 2**14, [0, 1, 2, 17, 31, 32, 33, 40]
    rows = []
    for seed in (0, 1):
        drawn = numbers(sampler(16, pixels, seed), 41, pixels)[shown, :, 5]
        rows += [drawn, np.roll(drawn, 1, axis=1)]
    drawn = np.concatenate(rows)
    for row in drawn:
        cells = np.bincount((row * 64).astype(int), minlength=64)
        assert stats.chisquare(cells).pvalue > 1e-5
    correlation = np.corrcoef(drawn) - np.eye(len(drawn))
    assert np.abs(correlation).max() < 5.5 / 2**7  # of 496: below 1e-4


def test_hashed_dimensions_are_independent_between_samples() -> None:
    pixels = 2**11
    drawn = numbers(sampler(8, pixels), 36, pixels)
    correlation = np.corrcoef(drawn[33].T) - np.eye(8)
    assert np.abs(correlation).max() < 5 / np.sqrt(pixels)
    before = np.corrcoef(drawn[3].T) - np.eye(8)  # of a net: not twice in one interval
    assert np.abs(before).max() > 5 / np.sqrt(pixels)


@pytest.mark.parametrize("count", [16, 12])
def test_parts_continue_the_sequence(count: int) -> None:
    """By ``first``, by ``advance`` in one wavefront, and by both: the same numbers to the bit."""
    pixels = 5
    whole = numbers(sampler(count, pixels, 9, 32), 40, pixels)
    size = count // 4
    parts = [numbers(sampler(size, pixels, 9, 32 + k * size), 40, pixels) for k in range(4)]
    np.testing.assert_array_equal(np.concatenate(parts, axis=2), whole)
    source: Any = mi.load_dict({"type": "nonexp_sobol", "sample_count": count})
    source.first = 32
    source.set_samples_per_wavefront(size)
    source.seed(9, pixels * size)
    parts = []
    for _ in range(4):
        parts.append(numbers(source, 40, pixels))
        source.advance()
        source.schedule_state()
    np.testing.assert_array_equal(np.concatenate(parts, axis=2), whole)


def test_masks_leave_dimensions_aligned() -> None:
    one, other = sampler(8, 3), sampler(8, 3)
    one.next_1d(dr.arange(mi.UInt32, 24) % 3 == 0)
    one.next_2d(False)
    for _ in range(3):
        other.next_1d()
    np.testing.assert_array_equal(numbers(one, 2), numbers(other, 2))


def test_a_loop_draws_what_single_calls_do() -> None:
    """With a different number of turns in each lane, beyond the last planned dimension."""
    count, pixels = 16, 4
    turns = dr.arange(mi.UInt32, count * pixels) % 37

    def body(source: Any, turn: Any, total: Any) -> Any:
        point = source.next_2d()
        return source, turn + 1, total + point.x * point.y

    source, _, total = dr.while_loop(
        (sampler(count, pixels, 2), mi.UInt32(0), mi.Float(0)),
        lambda source, turn, total: turn < turns,
        body,
    )
    after = np.array(source.next_1d())
    drawn = numbers(sampler(count, pixels, 2), 74).reshape(37, 2, -1)
    expected = [drawn[:n, :, lane].prod(axis=1).sum() for lane, n in enumerate(np.array(turns))]
    np.testing.assert_allclose(np.array(total), expected, rtol=1e-5)
    following = drawn.reshape(74, -1)[2 * np.array(turns) % 74, np.arange(count * pixels)]
    np.testing.assert_array_equal(after, following.astype(np.float32))


def test_clones_go_on_and_forks_begin() -> None:
    source: Any = mi.load_dict({"type": "nonexp_sobol", "seed": 2})
    source.first = 8
    source.seed(3, 24)
    source.next_2d()
    clone, fork = source.clone(), source.fork()
    clone.next_1d()
    assert clone.wavefront_size() == 24 and (fork.sample_count(), fork.first) == (4, 8)
    expected = numbers(source, 3)
    np.testing.assert_array_equal(numbers(clone, 2), expected[1:])
    fork.seed(3, 24)
    np.testing.assert_array_equal(numbers(fork, 5)[2:], expected)
    np.testing.assert_array_equal(numbers(sampler(4, 6, 5, 8), 5)[2:], expected)  # 2 + 3


def integrand(source: Any, count: int, pixels: int) -> Any:
    """Mean over the samples of a pixel of a smooth function of 4 numbers, whose mean is 1."""
    x = numbers(source, 4, pixels)
    return np.prod(1 + 0.5 * np.sin(2 * np.pi * x), axis=0).mean(axis=1)


@pytest.mark.parametrize("count", quick([64, 100, 256], lambda n: n != 256))
def test_means_have_no_bias_and_little_noise(count: int) -> None:
    """Also for a number of samples that is no power of two: there with a smaller gain.

    Over 2000 pixels; the variance of independent samples is (1.125^4 - 1) / n.
    """
    pixels = 2000
    means = integrand(sampler(count, pixels, 1), count, pixels)
    assert abs(means.mean() - 1) < 4.5 * stats.sem(means)
    gain = (1.125**4 - 1) / count / means.var()
    assert gain > {64: 25, 100: 6, 256: 150}[count]


def test_only_whole_seeds_and_counts() -> None:
    with pytest.raises(RuntimeError, match="sample_count is 0: it must be a whole number >= 1"):
        mi.load_dict({"type": "nonexp_sobol", "sample_count": 0})
    fresh: Any = mi.load_dict({"type": "nonexp_sobol"})
    assert fresh.sample_count() == 4 and fresh.wavefront_size() == 0
    with pytest.raises(RuntimeError, match="has no numbers before its first call of seed"):
        fresh.next_1d()
    with pytest.raises(ValueError, match="wavefront_size is not given, as it must be at the first"):
        fresh.seed(1)
    with pytest.raises(RuntimeError):
        fresh.set_samples_per_wavefront(3)
