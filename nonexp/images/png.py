"""Pictures to look at: tone mapping, and PNG files."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np

from .moments import Array

__all__ = ["encode", "tone_map", "write_png"]


def tone_map(linear: Array) -> Array:
    """Displayable values in [0, 1]: linear up to 0.7, a smooth shoulder above, sRGB transfer."""
    knee = 0.7
    bright = 1 - (1 - knee) * np.exp((knee - np.maximum(linear, knee)) / (1 - knee))
    value = np.clip(np.where(linear > knee, bright, np.nan_to_num(linear)), 0, 1)
    srgb: Array = np.where(
        value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 0.0031308) ** (1 / 2.4) - 0.055
    )
    return srgb


def encode(picture: Array) -> bytes:
    """Values in [0, 1] as the bytes of a PNG file."""
    stream = mi.MemoryStream()
    mi.Bitmap(np.round(255 * picture).astype(np.uint8)).write(stream, mi.Bitmap.FileFormat.PNG)
    return bytes(stream.raw_buffer())


def write_png(path: Path, picture: Array) -> None:
    """Write values in [0, 1]."""
    path.write_bytes(encode(picture))
