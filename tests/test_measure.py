"""The statistical test itself: quiet when nothing is wrong, loud when something is."""

from __future__ import annotations

import numpy as np
import pytest
from build import scene, stock
from measure import assert_same, passes
from tiers import THOROUGH

from nonexp.testing.exponential import GRID, lobe


@THOROUGH
@pytest.mark.parametrize("case", ["null", "dielectric"])
def test_volpath_agrees_with_itself(case: str, effort: int) -> None:
    """Calibration, on the heaviest tails: 64 passes of 128 paths a block, glass, small lamp."""
    built = scene("volpath", **lobe(stock, case, "area"))
    runs = [passes(built, 128 * effort, seed, GRID) for seed in range(8)]
    for a, b in zip(runs[::2], runs[1::2], strict=True):
        assert_same(a, b, within=0.15)


@pytest.mark.thorough
def test_a_planted_bias_is_found() -> None:
    built = scene("volpath", **lobe(stock, "null", "area"))
    a, b = passes(built, 256, 1, GRID), passes(built, 256, 2, GRID)
    assert_same(a, b, within=0.03)
    with pytest.raises(AssertionError, match="means differ"):
        assert_same(a, 1.03 * b, within=0.03)
    spoiled = b.copy()
    spoiled[np.argmax(b.mean(axis=1))] *= 1.3
    with pytest.raises(AssertionError, match="differ"):
        assert_same(a, spoiled, within=0.03)


@THOROUGH
def test_a_weak_test_is_refused() -> None:
    built = scene("volpath", **lobe(stock, "null", "area"))
    with pytest.raises(AssertionError, match="too weak"):
        assert_same(passes(built, 4, 1, GRID), passes(built, 4, 2, GRID), within=0.01)
