"""A procedural cloud: a density that needs no data of others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..system.files import replacing

__all__ = ["ENDINGS", "cloud", "write"]

ENDINGS = (".npz", ".npy", ".vol")

_MARGIN = 0.04
"""Width of the empty space along the faces of the cube."""
_BASE = 0.2
"""Height of the flat underside."""
_SHARPNESS = 5.0
"""Of the union of puffs: how little they bulge where they touch."""
_OCTAVES = ((6, 0.7), (13, 0.55), (27, 0.35), (55, 0.2), (111, 0.11))
"""Cells along an axis and strength of each octave of the billows."""
_SLAB = 32


def cloud(resolution: int = 64, seed: int = 1) -> Any:
    """Density of a cumulus in the unit cube: ``resolution``^3 values in [0, 1], float32.

    The axes are z, y, x, and y is up. The cloud is a smooth union of Gaussian puffs over a flat
    base, displaced by billows (absolute values of noise, in octaves). It is empty along the faces
    of the cube and over most of it. The field does not depend on the resolution, at which it is
    sampled, at the centres of voxels; octaves finer than two voxels are left out. Another ``seed``
    is another cloud.

    Raises ``ValueError`` if ``resolution`` is not in [4, 1024], or ``seed`` negative.
    """
    if not 4 <= resolution <= 1024:
        raise ValueError(f"resolution is {resolution}: it must be a whole number from 4 to 1024")
    if seed < 0:
        raise ValueError(f"seed is {seed}: it must be a whole number >= 0")
    rng = np.random.default_rng(seed)
    puffs = _puffs(rng)
    octaves = [(n, s, rng.standard_normal((n + 3,) * 3).astype(np.float32)) for n, s in _OCTAVES]
    at = (np.arange(resolution) + 0.5) / resolution
    result = np.zeros((resolution,) * 3, np.float32)
    # Only in the box that the cloud can fill.
    low = np.clip((puffs[:, :3] - 1.4 * puffs[:, 3:]).min(0), _MARGIN, 1)
    high = np.clip((puffs[:, :3] + 1.4 * puffs[:, 3:]).max(0), 0, 1 - _MARGIN)
    first, last = np.searchsorted(at, low), np.searchsorted(at, high)
    x, y = (at[first[axis] : last[axis]] for axis in (0, 1))
    floor = (18 * (y - _BASE))[:, None].astype(np.float32)
    for start in range(first[2], last[2], _SLAB):
        stop = min(start + _SLAB, last[2])
        shape = np.minimum(_union(puffs, x, y, at[start:stop]), floor)
        for cells, strength, lattice in octaves:
            if 2 * cells <= resolution:
                noise = _noise(lattice, *(_weights(cells, axis) for axis in (x, y, at[start:stop])))
                shape += strength * (np.abs(noise) - np.float32(0.25))
        for axis, places in enumerate((at[start:stop], y, x)):
            border = np.minimum(places, 1 - places) - _MARGIN
            along = [1, 1, 1]
            along[axis] = len(places)
            shape = np.minimum(shape, 12 * border.astype(np.float32).reshape(along))
        ramp = np.clip(1.6 * shape, 0, 1)
        box = (slice(start, stop), slice(first[1], last[1]), slice(first[0], last[0]))
        result[box] = ramp * ramp * (3 - 2 * ramp)
    return result


def _puffs(rng: np.random.Generator) -> Any:
    """Rows of x, y, z and radius: large ones side by side, smaller ones on top and around them."""
    angle = rng.uniform(0, 2 * np.pi, 9)
    out = 0.29 * np.sqrt(rng.random(9))
    radius = 0.2 - 0.23 * out + 0.03 * rng.random(9)
    x, z = 0.5 + 1.1 * out * np.cos(angle), 0.5 + 0.8 * out * np.sin(angle)
    y = _BASE + 0.6 * radius + (0.3 - out) * rng.uniform(0.2, 1.2, 9)
    large = np.stack([x, y, z, radius], 1)
    mother = large[rng.integers(0, 9, 30)]
    way = rng.standard_normal((30, 3))
    way[:, 1] = np.abs(way[:, 1])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    small = mother * np.array([1, 1, 1, 0.45]) * (1 - 0.2 * rng.random((30, 1)) * [0, 0, 0, 1])
    small[:, :3] += 0.85 * mother[:, 3:] * way
    return np.concatenate([large, small])


def _union(puffs: Any, x: Any, y: Any, z: Any) -> Any:
    """1 - (r / radius)^2 of a puff at distance r from its centre; of several, a smooth maximum."""
    along = [
        np.exp(-_SHARPNESS * ((at[:, None] - puffs[:, axis]) / puffs[:, 3]) ** 2)
        for axis, at in enumerate((x, y, z))
    ]
    plane = (along[2][:, None] * along[1]).reshape(-1, len(puffs))
    total = plane.astype(np.float32) @ along[0].T.astype(np.float32)
    field = np.log(np.maximum(total, np.float32(1e-30))) / np.float32(_SHARPNESS) + np.float32(1)
    return field.reshape(len(z), len(y), len(x))


def _weights(cells: int, at: Any) -> Any:
    """Cubic B-splines around the points of a lattice, at some positions."""
    away = np.abs(at[:, None] * cells + 1 - np.arange(cells + 3))
    near, far = 2 / 3 - away**2 * (1 - away / 2), np.clip(2 - away, 0, None) ** 3 / 6
    return np.where(away < 1, near, far).astype(np.float32)


def _noise(lattice: Any, x: Any, y: Any, z: Any) -> Any:
    """Random numbers of a lattice, interpolated by B-splines along each axis."""
    return (y @ np.tensordot(z, lattice, 1)) @ x.T


def write(path: Path, array: Any) -> None:
    """Write a grid with the axes z, y, x as ``.npz`` (array ``density``), ``.npy`` or ``.vol``.

    An old file stays until the new one is complete. ``.vol`` needs a Mitsuba variant.
    """
    with replacing(path) as (aside,):
        if path.suffix == ".vol":
            mi.VolumeGrid(array).write(str(aside))
        else:
            with open(aside, "wb") as file:
                if path.suffix == ".npy":
                    np.save(file, array)
                else:
                    np.savez_compressed(file, density=array)
