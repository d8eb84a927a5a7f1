"""The shipped scenes: every medium renders, the laws look different, as they should."""

from __future__ import annotations

import functools
import itertools
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from measure import passes
from scipy import stats
from tiers import THOROUGH, quick

SCENES = Path(__file__).resolve().parent.parent / "scenes"
MEDIA = sorted(path.stem for path in (SCENES / "media").glob("*.xml"))
LAWS = ["constant", "exponential", "gamma", "linear", "quadratic"]


@functools.cache
def blocks(name: str, medium: str, size: int = 8) -> Any:
    """Means of size x size blocks of the image, and their standard errors."""
    built = mi.load_file(str(SCENES / f"{name}.xml"), medium=medium)
    assert type(built.integrator()).__name__ == "NonexpVolpath"
    values = passes(built, 24 if name == "dragon" else 64, 1, size)
    assert np.all(np.isfinite(values))
    return values.mean(axis=1), stats.sem(values, axis=1)


def test_there_is_a_medium_for_each_law_and_each_of_the_series() -> None:
    assert {*LAWS, "linear_b1000", "linear_b1.72", "linear_b0.8"} <= set(MEDIA)


@THOROUGH
@pytest.mark.parametrize("name", ["dragon", "fog"])
def test_every_two_laws_look_different(name: str) -> None:
    found = {law: blocks(name, law) for law in LAWS}
    for a, b in itertools.combinations(LAWS, 2):
        (mean_a, error_a), (mean_b, error_b) = found[a], found[b]
        squares = np.square(mean_a - mean_b) / (np.square(error_a) + np.square(error_b))
        assert stats.chi2.sf(squares.sum(), len(squares)) < 1e-6, (a, b)


@THOROUGH
def test_fog_darkens_along_the_series() -> None:
    series = [blocks("fog", f"linear_b{b}")[0].mean() for b in ("1000", "1.72", "0.8")]
    assert series[0] > 1.1 * series[1] > 1.2 * series[2]


IN_BOTH = {"gamma", "linear_b0.8"}


@pytest.mark.parametrize("medium", quick(MEDIA, IN_BOTH.__contains__))
def test_every_medium_file_renders(medium: str, effort: int) -> None:
    """In the fog; some, and with --full all, also in the dragon (the laws above are, too)."""
    for name in ("dragon", "fog") if medium in IN_BOTH or effort > 1 else ("fog",):
        built = mi.load_file(str(SCENES / f"{name}.xml"), medium=medium, width=16, height=12)
        image = np.array(mi.render(built, spp=4))
        assert image.shape == (12, 16, 3)
        assert np.all(np.isfinite(image) & (image >= 0))
