"""The images that a scene is fitted to, one for each of some sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import numpy.typing as npt

from ..images.exr import read
from ..rendering.passes import MAX_PASS_SAMPLES, pass_seed, sensor_number

__all__ = ["Array", "View", "views"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class View:
    """An image, and the sensor that sees it."""

    sensor: int
    image: Array
    """height x width x channels"""
    weight: Array
    """height x width x 1, >= 0: how much the square of a difference counts"""
    noise: float
    """mean of the image's own variance, weighted; 0 where it is not known"""
    reach: int
    """distance in pixels beyond which noise is independent, along rows and columns"""

    @property
    def count(self) -> float:
        """Sum of the weights of all numbers."""
        return float(self.weight.sum()) * self.image.shape[2]

    def spread(self, values: Any) -> Array:
        """Covariance of the sums over the image of some values, from how these scatter.

        The values have the axes (quantities, height, width, channels). Their noise is taken to be
        independent between pixels farther apart than ``reach``; channels of a pixel count as one.
        """
        pixels = values.sum(axis=-1)
        flat = pixels.reshape(len(pixels), -1)
        own = flat @ flat.T
        if not self.reach:
            return np.asarray(own)
        from scipy.ndimage import uniform_filter  # takes a while to import

        width = 2 * self.reach + 1
        near = uniform_filter(pixels, (1, width, width), mode="constant") * width**2
        found = flat @ near.reshape(len(pixels), -1).T
        # An estimate that may come out too small, even below 0: not less than of single pixels.
        variances, directions = np.linalg.eigh((found + found.T) / 2)
        least = np.einsum("ji,jk,ki->i", directions, own, directions)
        return np.asarray((directions * np.maximum(variances, least)) @ directions.T)

    def passes(self, spp: int) -> tuple[int, int]:
        """Number of passes, samples per pixel of each."""
        most = max(1, MAX_PASS_SAMPLES // math.prod(self.image.shape[:2]))
        count = -(-spp // most)
        return count, -(-spp // count)

    def mean(self, once: Any, spp: int, seed: int) -> Array:
        """The mean of the passes that make up ``spp`` samples per pixel: ``once(spp, seed)``."""
        count, each = self.passes(spp)
        total: Any = 0.0
        for number in range(count):
            total = total + self.colours(once(each, pass_seed(seed, number)))
        return np.asarray(total / count)

    def colours(self, image: Any) -> Array:
        """The colour channels of what a film develops."""
        return np.asarray(image, dtype=np.float64)[..., : self.image.shape[2]]


def views(
    scene: mi.Scene,
    images: Any,
    sensors: Sequence[Any] | None,
    weights: Any,
) -> list[View]:
    """The images with their sensors; ``ValueError`` where they do not fit together."""
    given = [images] if _is_one(images) else list(images)
    if not given:
        raise ValueError("images is empty: it must hold at least one image")
    chosen = range(len(given)) if sensors is None else sensors
    numbers = [sensor_number(scene, one) for one in chosen]
    if len(numbers) != len(given):
        raise ValueError(
            f"there are {len(given)} images and {len(numbers)} sensors: it must be one for each"
        )
    masks = [None] * len(given) if weights is None else weights
    masks = [masks] if weights is not None and _is_one(weights) else list(masks)
    if len(masks) != len(given):
        raise ValueError(f"there are {len(masks)} weights: it must be one for each image")
    pairs = zip(numbers, given, masks, strict=True)
    return [_view(scene, i, *parts) for i, parts in enumerate(pairs)]


def _is_one(images: Any) -> bool:
    return not isinstance(images, list | tuple) and getattr(images, "ndim", 3) < 4


def _view(scene: mi.Scene, number: int, sensor: int, image: Any, weight: Any) -> View:
    film: Any = scene.sensors()[sensor].film()
    channels = 3 if film.base_channels_count() >= 3 else 1
    label = f"image {number}"
    mean, variance = _numbers(label, image)
    height, width = film.crop_size()[1], film.crop_size()[0]
    if mean.shape[:2] != (height, width):
        raise ValueError(
            f"{label} is {mean.shape[1]}x{mean.shape[0]}: it must be {width}x{height}, the size of "
            f"the film of sensor {sensor}"
        )
    if channels == 1:
        mean, variance = mean.mean(axis=2, keepdims=True), variance.mean(axis=2, keepdims=True) / 3
    weighed = np.ones((height, width, 1))
    if weight is not None:
        weighed = np.array(weight, dtype=np.float64).reshape(height, width, -1)[..., :1]
    if not (np.isfinite(weighed).all() and weighed.min() >= 0 and weighed.max() > 0):
        raise ValueError(f"the weights of {label} must be finite numbers >= 0, and not all be 0")
    unusable = ~np.isfinite(mean).all(axis=2, keepdims=True)
    if np.any(unusable & (weighed > 0)):
        raise ValueError(
            f"{label} holds {np.count_nonzero(unusable)} pixels that are not finite numbers: "
            "give them the weight 0"
        )
    mean = np.where(unusable, 0.0, mean)
    noise = float(np.mean(weighed * np.nan_to_num(variance)) / weighed.mean())
    radius = film.rfilter().radius()
    reach = 0 if radius <= 0.5 + 1e-6 else math.ceil(radius)
    return View(sensor, mean, weighed, noise, reach)


def _numbers(label: str, image: Any) -> tuple[Array, Array]:
    """An image and its variance, height x width x 3."""
    stderr: Any = None
    if isinstance(image, str | Path):
        image = read(Path(image))
    if hasattr(image, "mean") and hasattr(image, "stderr"):
        image, stderr = image.mean, image.stderr
    elif hasattr(image, "pixel_format"):  # a bitmap
        image = np.array(image.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))
    array = np.array(image, dtype=np.float64)
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[2] not in (1, 3, 4):
        raise ValueError(f"{label} has the shape {array.shape}: it must be height x width x 3")
    array = array[..., :3] if array.shape[2] >= 3 else np.repeat(array, 3, axis=2)
    variance = np.zeros_like(array) if stderr is None else np.square(np.array(stderr, dtype=float))
    return array, variance
