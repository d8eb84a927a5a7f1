"""Grids as the density of a medium: where they come from, and which are allowed."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.plugins import gridfiles, values

__all__ = ["PARAMETERS", "channels_of", "check_density", "density_volume"]

_PLACING = ("field", "to_world", "filter_type", "wrap_mode")
PARAMETERS = ("filename", *_PLACING)
"""Parameters of a medium that reads its grid from a file."""


def density_volume(props: mi.Properties) -> tuple[mi.Volume, float]:
    """The volume of ``sigma_t``, or of the grid in ``filename``, and a factor on its values."""
    if "filename" not in props:
        if placing := [name for name in _PLACING if name in props]:
            raise ValueError(
                f"{placing[0]} goes with filename: to a volume given as sigma_t it belongs itself"
            )
        found, factor = values.coefficient(props, "sigma_t")
        if found.class_name() not in ("ConstVolume", "GridVolume"):
            raise ValueError(
                f"sigma_t is a {found.class_name()}: "
                "it must be a gridvolume, a constvolume or a value"
            )
        return found, factor
    if "sigma_t" in props:
        raise ValueError("filename and sigma_t are given: exactly one of the two must be")
    name = str(props["filename"])
    path = str(mi.file_resolver().resolve(name))
    array, placed = gridfiles.read(path, str(props.get("field", "")))
    low, high = array.min(), array.max()
    if not (low >= 0 and high < np.inf):
        bad = low if not low >= 0 else high
        raise ValueError(
            f"filename is {path!r}: its grid holds {bad:g}: densities must be finite numbers >= 0"
        )
    to_world = props.get("to_world", mi.ScalarTransform4f())
    if placed is not None:
        to_world = mi.ScalarTransform4d(np.array(to_world.matrix, dtype=float) @ placed)
    volume = values.make(
        "gridvolume",
        grid=mi.VolumeGrid(array),
        to_world=to_world,
        filter_type=props.get("filter_type", "trilinear"),
        wrap_mode=props.get("wrap_mode", "clamp"),
        raw=True,
    )
    return volume, 1.0


def check_density(volume: mi.Volume) -> float:
    """The largest density of a grid. Raises ``ValueError`` for a grid without values, and where
    one is negative or not finite."""
    data = mi.traverse(volume)["data"]
    shape = tuple(int(n) for n in data.shape)
    if len(shape) != 4 or 0 in shape:
        raise ValueError(
            f"sigma_t.data has the shape {shape}: it must be (z, y, x, channels), without a zero"
        )
    flat = dr.detach(data.array)
    bad = ~((flat >= 0) & dr.isfinite(flat))
    if dr.any(bad):
        first = dr.gather(type(flat), flat, dr.compress(bad)[0])
        raise ValueError(f"sigma_t.data holds {first[0]:g}: densities must be finite numbers >= 0")
    return float(dr.max(flat)[0])


def channels_of(volume: mi.Volume) -> tuple[int, Any]:
    """The channel of a grid that is its density, and all channels as multiples of it.

    ``ValueError`` where they are no multiples.
    """
    data = mi.traverse(volume)["data"]
    count = int(data.shape[3])
    if count == 1:
        return 0, np.ones(1)
    if mi.is_spectral or count != dr.size_v(mi.UnpolarizedSpectrum):
        raise ValueError(
            f"sigma_t has {count} channels: in variant {mi.variant()} it must be one density "
            "(its colour is the parameter extinction)"
        )
    array = np.array(dr.detach(data)).reshape(-1, count).astype(float)
    sums = array.sum(0)
    channel = int(np.argmax(sums))
    ratios = sums / sums[channel] if sums[channel] > 0 else np.ones(count)
    off = np.abs(array - array[:, channel : channel + 1] * ratios).max()
    if off > 1e-5 * array.max():
        raise ValueError(
            f"sigma_t has {count} channels that are not multiples of one grid: it must be one "
            "density (its colour is the parameter extinction)"
        )
    return channel, ratios
