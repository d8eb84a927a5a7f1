"""Whether two images are the same but for noise, or have the mean that they should."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..images.compare import compare
from ..images.exr import Picture, read
from ..images.image import Image
from ..rendering.passes import Plan, render_passes
from .statistics import FALSE_ALARM, Agreement, assert_same, mean_is, reach, sampled

__all__ = ["assert_mean", "assert_same_image"]

BLOCKS = 6
"""An image is divided into up to BLOCKS x BLOCKS blocks."""

PASSES = 32
"""What is rendered takes so many passes: each is a call of the integrator."""

_COLOURS = ("red", "green", "blue")


def assert_same_image(
    a: Any,
    b: Any,
    *,
    within: float = 0.01,
    scene: Any = None,
    spp: int = 2**16,
    seed: int = 0,
    sensor: int = 0,
) -> Agreement:
    """Two images are the same but for noise.

    ``a`` and ``b`` are each

    * a Mitsuba scene, which is rendered;
    * an integrator, by its plugin's name or as a dictionary, which renders ``scene``;
    * the images of N >= 32 independent passes, an array of shape (N, height, width, 3);
    * an image with its standard error: a :class:`nonexp.Image`, or an EXR file of ``nonexp
      render``.

    What is rendered takes 32 passes, with as many samples per pixel, ``spp`` at most, as it takes
    to find a relative bias of ``within`` of the whole image with a probability above 0.9. Blocks
    (up to 6 x 6) and the whole are tested by Welch's t-test, in the mean of the channels and in
    each channel; the limit is corrected for their number: one comparison in 100 000 fails by
    chance. Beside an image with a standard error a scene takes up to 1024 samples per pixel, and
    blocks are those of ``nonexp compare``.

    Returns how well they agree, and which bias would have been found. Raises ``AssertionError``
    that says by how much, and where, they differ, or that the test is too weak to find ``within``;
    ``ValueError`` for what is no image, and for images of different size.
    """
    if not within > 0:
        raise ValueError(f"within is {within}: it must be > 0")
    sides = [_side(name, given, scene, sensor) for name, given in (("a", a), ("b", b))]
    if any(isinstance(side, Picture) for side in sides):
        pictures = [_picture(side, spp, seed + i) for i, side in enumerate(sides)]
        return _same_pictures(pictures[0], pictures[1], within)
    images: dict[int, tuple[Any, Any]] = {}

    def run(count: int) -> tuple[Any, Any]:
        one, other = (_rendered(side, count, seed + i) for i, side in enumerate(sides))
        if one.shape[1:] != other.shape[1:]:
            raise ValueError(_sizes(one[0], other[0]))
        images[count] = one, other
        return _blocks(one.mean(axis=3)), _blocks(other.mean(axis=3))

    fixed = all(isinstance(side, np.ndarray) for side in sides)
    first = 1 if fixed else max(1, _FIRST // sides[0 if callable(sides[0]) else 1].pixels)
    needed = within * 7 / reach(4 * (BLOCKS**2 + 1), PASSES)
    sampled(run, needed, first, first if fixed else max(1, spp // PASSES))
    one, other = images.popitem()[1]
    grey = bool(np.all(one == one[..., :1]) and np.all(other == other[..., :1]))
    tests = 1 if grey else 4
    whole = [_blocks(image.mean(axis=3)) for image in (one, other)]
    agreement = assert_same(whole[0], whole[1], within, comparisons=tests)
    for channel in range(0 if grey else 3):
        blocks = [_blocks(image[..., channel]) for image in (one, other)]
        try:
            assert_same(blocks[0], blocks[1], math.inf, comparisons=tests)
        except AssertionError as error:
            raise AssertionError(f"{_COLOURS[channel]}: {error}") from None
    return agreement


_FIRST = 2**13
"""Samples of the whole image in a pass, to begin with."""


def assert_mean(
    of: Any,
    exact: float,
    *,
    within: float = 0.01,
    spp: int = 2**16,
    seed: int = 0,
    sensor: int = 0,
    rounding: float = 1e-6,
) -> Agreement:
    """The mean of an image is ``exact``.

    ``of`` is a Mitsuba scene, rendered in 32 passes with as many samples per pixel, ``spp`` at
    most, as it takes to find a relative bias of ``within`` with a probability above 0.9; or
    independent samples, an array. The mean runs over pixels and channels; ``rounding`` is a
    fraction of it that adds to its standard error.

    Returns how well they agree. Raises ``AssertionError`` with the difference in standard errors,
    or where the test is too weak; ``ValueError`` for what is neither.
    """
    if not isinstance(of, mi.Scene):
        values = np.asarray(of, dtype=float)
        if values.size < 2:
            raise ValueError(f"of is {of!r}: it must be a Mitsuba scene, or independent samples")
        return mean_is(values, exact, within, rounding)
    side = _Render(of, None, sensor)

    def run(count: int) -> tuple[Any, Any]:
        means = side(count, seed).mean(axis=(1, 2, 3))
        return means[None], np.full((1, PASSES), float(exact))

    needed = within * 7 / reach(1, PASSES)
    means, _ = sampled(run, needed, max(1, _FIRST // side.pixels), max(1, spp // PASSES))
    return mean_is(means[0], exact, within, rounding)


# --------------------------------------------------------------------- what is compared


class _Render:
    """A scene, and what renders it: images of passes, by samples per pixel of a pass and seed."""

    def __init__(self, scene: Any, integrator: Any, sensor: int) -> None:
        self.scene, self.integrator, self.sensor = scene, integrator, sensor
        self.pixels = int(np.prod(scene.sensors()[sensor].film().crop_size()))

    def __call__(self, count: int, seed: int) -> Any:
        how = {"sensor": self.sensor, "integrator": self.integrator}
        return np.array(list(render_passes(self.scene, Plan(PASSES, count), seed, **how)))


Side = Any
"""A _Render, a Picture, or an array of passes."""


def _side(name: str, given: Any, scene: Any, sensor: int) -> Side:
    if isinstance(given, mi.Scene):
        return _Render(given, None, sensor)
    if isinstance(given, Image):
        return _of_image(given)
    if isinstance(given, Path) or (isinstance(given, str) and given.lower().endswith(".exr")):
        return read(Path(given))
    if isinstance(given, str | dict):
        if scene is None:
            raise ValueError(f"scene is missing: {name} is the integrator {given!r}, without one")
        integrator = mi.load_dict({"type": given} if isinstance(given, str) else given)
        return _Render(scene, integrator, sensor)
    if isinstance(given, np.ndarray) and given.ndim == 4 and given.shape[3] == 3:
        if len(given) < 32:
            raise ValueError(f"{name} holds {len(given)} passes: they must be at least 32")
        return given.astype(float)
    raise ValueError(
        f"{name} is {type(given).__name__}: it must be a scene, an integrator's name, a "
        "nonexp.Image, an EXR file, or passes of shape (N, height, width, 3)"
    )


def _of_image(image: Image) -> Picture:
    return Picture(Path("image"), image.mean, image.stderr, {"passes": image.passes})


def _rendered(side: Side, count: int, seed: int) -> Any:
    return side(count, seed) if callable(side) else side


def _blocks(passes: Any) -> Any:
    """Means of blocks, shape (blocks, passes), of images of shape (passes, height, width)."""
    rows = np.array_split(passes, min(BLOCKS, passes.shape[1]), axis=1)
    found = [
        block.mean(axis=(1, 2))
        for row in rows
        for block in np.array_split(row, min(BLOCKS, passes.shape[2]), axis=2)
    ]
    return np.array(found)


def _sizes(a: Any, b: Any) -> str:
    shapes = [f"{one.shape[1]}x{one.shape[0]}" for one in (a, b)]
    return f"the images differ in size: {' and '.join(shapes)} pixels"


# --------------------------------------------------------------------- standard errors


def _picture(side: Side, spp: int, seed: int) -> Picture:
    if isinstance(side, Picture):
        return side
    passes = _rendered(side, max(1, min(spp, 1024) // PASSES), seed)
    error = passes.std(axis=0, ddof=1) / np.sqrt(len(passes))
    return Picture(Path("image"), passes.mean(axis=0), error, {"passes": len(passes)})


def _same_pictures(a: Picture, b: Picture, within: float) -> Agreement:
    found = compare(a, b, FALSE_ALARM)
    test = found.test
    if test is None or found.bias_error is None:
        raise ValueError("an image has no standard error: render it in passes, by nonexp")
    place = "over the whole image"
    if test.place is not None:
        place = "most around pixel {}, {}".format(*test.place)
    if not test.same:
        word = "brighter" if found.bias > 0 else "darker"
        raise AssertionError(
            f"images differ, {place}: the first is {word} than the second by {abs(found.bias):.2%} "
            f"(standard error {found.bias_error:.2%}); largest deviation {test.worst:.1f} "
            f"standard errors, limit {test.limit:.1f}"
        )
    if not test.seen <= within:
        raise AssertionError(
            f"too weak: these images would show a bias of {test.seen:.2%}, not of {within:.2%}: "
            "render them with more samples"
        )
    blocks = test.seen * np.sqrt(max(test.blocks, 1))
    return Agreement(found.bias, found.bias_error, test.seen, float(blocks), test.blocks + 1)
