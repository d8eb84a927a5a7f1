"""Merging renders of one scene with different seeds into one image."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..scene.identity import differences
from .exr import Picture, independent
from .image import Image
from .moments import Noise

__all__ = ["merge", "seeds"]


def merge(pictures: Sequence[Picture]) -> tuple[Image, dict[str, Any]]:
    """One image of renders with different seeds, and its metadata.

    The mean is weighted by samples. With W samples per pixel, N independent images (replicates or
    passes), mean m and standard error e of each part, S = W (N - 1) e^2 is the sum of the weighted
    squared deviations of these images; for the whole, S is the sum over the parts of
    S + W (m - mean)^2, and e^2 = S / (W (N - 1)): what one run of all these images gives.

    Raises ``ValueError`` for renders that are not of one scene, with one size and one version, or
    that share a seed, and says what differs.
    """
    if len(pictures) < 2:
        there = "there is one image" if pictures else "there are no images"
        raise ValueError(f"{there}: merging takes two or more")
    first = pictures[0]
    held: dict[int, Picture] = {}
    for picture in pictures:
        _check_same(first, picture)
        for seed in seeds(picture):
            if seed in held:
                raise ValueError(
                    f"{held[seed].path} and {picture.path} both hold seed {seed}: "
                    "their samples are the same; render with another --seed"
                )
            held[seed] = picture
    weights = [int(picture.metadata["spp"]) for picture in pictures]
    passes = sum(int(picture.metadata["passes"]) for picture in pictures)
    numbers = [independent(picture) for picture in pictures]
    mean = np.average([picture.mean for picture in pictures], axis=0, weights=weights)
    squares = np.zeros_like(mean)
    for picture, weight, number in zip(pictures, weights, numbers, strict=True):
        squares += weight * np.square(picture.mean - mean)
        if number > 1 and picture.stderr is not None:
            squares += weight * (number - 1) * np.square(picture.stderr)
    stderr = np.sqrt(squares / sum(weights) / (sum(numbers) - 1))
    seconds = math.fsum(float(picture.metadata["seconds"]) for picture in pictures)
    error = Noise.between(mean, stderr, sum(numbers)).error
    image = Image(
        mean, stderr, sum(weights), passes, min(held), seconds, error, independent=sum(numbers)
    )
    metadata = {
        **first.metadata,
        "spp": image.spp,
        "passes": image.passes,
        "independent": sum(numbers),
        "seconds": image.seconds,
        "seeds": json.dumps(sorted(held)),
        "error": error,
    }
    return image, metadata


def seeds(picture: Picture) -> list[int]:
    """The seeds of all renders that an image was merged from, or its own."""
    found: list[int] = json.loads(picture.metadata.get("seeds") or "[]")
    return found or [int(picture.metadata[key]) for key in ("seed",) if key in picture.metadata]


def _check_same(first: Picture, picture: Picture) -> None:
    needed = ("spp", "passes", "seed", "seconds", "identity")
    if missing := [name for name in needed if name not in picture.metadata]:
        raise ValueError(
            f"{picture.path} is not an image of nonexp render: its header has no "
            f"{', '.join(f'nonexp:{name}' for name in missing)}"
        )
    if picture.stderr is None:
        raise ValueError(f"{picture.path} holds no standard error")
    old, new = (json.loads(str(p.metadata["identity"])) for p in (first, picture))
    for identity in (old, new):  # which decides the last bits, not the image
        identity.get("versions", {}).pop("llvm", None)
    if differ := differences(old, new):
        raise ValueError(
            f"{first.path} and {picture.path} are not of one scene: {'; '.join(differ)}"
        )
