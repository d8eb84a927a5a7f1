"""Image files: EXR with the standard error and metadata, PNG to look at."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import OpenEXR

from ..system.files import check_writable, replacing
from .image import Image
from .moments import Array

__all__ = ["Picture", "check", "read", "tone_map", "write", "write_exr", "write_png"]

Metadata = Mapping[str, str | int | float]


@dataclass(frozen=True, eq=False)
class Picture:
    """An image read from a file."""

    path: Path
    mean: Array
    """shape (height, width, 3)"""
    stderr: Array | None
    """its standard error, where the file has it"""
    metadata: dict[str, Any]
    """how it was made: the header's ``nonexp:<key>``, by key"""


def check(path: Path, *beside: Path) -> None:
    """Raise ``ValueError`` or ``OSError`` unless an EXR file, and a PNG beside it, can be written.

    So can other files ``beside`` it. Leaves no trace, and existing files alone.
    """
    if path.suffix.lower() != ".exr":
        raise ValueError(f"output is {str(path)!r}: it must be a file name that ends in .exr")
    check_writable(path, path.with_suffix(".png"), *beside)


def write(path: Path, image: Image, metadata: Metadata, denoised: Array | None = None) -> None:
    """Write an image as EXR, and tone-mapped as PNG beside it.

    The EXR holds 32-bit floats: the mean in ``R, G, B``, its standard error in ``stderr.R,
    stderr.G, stderr.B``, and ``metadata`` as header attributes ``nonexp:<key>``. A ``denoised``
    image is added to it as ``denoised.R, ...``, and is also written to a PNG of its own. The files
    are written aside and put in place when all of them are complete; where that fails, ``OSError``
    says why, and the old ones stay.
    """
    layers = {"": image.mean, "stderr.": image.stderr}
    pictures = {path.with_suffix(".png"): image.mean}
    if denoised is not None:
        layers["denoised."] = denoised
        pictures[path.with_suffix(".denoised.png")] = denoised
    try:
        with replacing(path, *pictures) as (exr, *pngs):
            write_exr(exr, layers, metadata)
            for png, picture in zip(pngs, pictures.values(), strict=True):
                write_png(png, tone_map(picture))
    except (OSError, RuntimeError) as error:  # which name the files written aside
        why = re.sub(r"^.*?\.part\W*", "", str(error), flags=re.DOTALL)
        raise OSError(f"{str(path)!r} cannot be written: {why.strip(' .') or error}") from error


def tone_map(linear: Array) -> Array:
    """Displayable values in [0, 1]: linear up to 0.7, a smooth shoulder above, sRGB transfer."""
    knee = 0.7
    bright = 1 - (1 - knee) * np.exp((knee - np.maximum(linear, knee)) / (1 - knee))
    value = np.clip(np.where(linear > knee, bright, np.nan_to_num(linear)), 0, 1)
    srgb: Array = np.where(
        value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 0.0031308) ** (1 / 2.4) - 0.055
    )
    return srgb


def write_exr(path: Path, layers: Mapping[str, Array], metadata: Metadata) -> None:
    """Write layers of three channels, named ``<prefix>R, <prefix>G, <prefix>B``.

    Raises ``OSError`` or ``RuntimeError`` if that fails; the file is read back to be sure, because
    OpenEXR does not notice that its last bytes did not fit on the disk.
    """
    header = {f"nonexp:{key}": value for key, value in metadata.items()}
    header |= {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    channels = {
        prefix + name: np.ascontiguousarray(values[:, :, i], dtype=np.float32)
        for prefix, values in layers.items()
        for i, name in enumerate("RGB")
    }
    OpenEXR.File(header, dict(channels)).write(str(path))  # which changes its arguments
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            same = all(
                np.array_equal(file.channels()[name].pixels, values, equal_nan=True)
                for name, values in channels.items()
            )
    except (RuntimeError, KeyError):
        same = False
    if not same:
        raise OSError("the file is not what was written to it; is the disk full?")


def write_png(path: Path, picture: Array) -> None:
    """Write values in [0, 1]."""
    pixels = np.round(255 * picture).astype(np.uint8)
    stream = mi.MemoryStream()
    mi.Bitmap(pixels).write(stream, mi.Bitmap.FileFormat.PNG)
    path.write_bytes(stream.raw_buffer())


def read(path: Path) -> Picture:
    """Read an EXR image: its colour and, where there are any, standard error and metadata.

    Raises ``ValueError`` for a file that is missing, or has no channels R, G, B.
    """
    if not path.is_file():
        raise ValueError(f"image {str(path)!r} does not exist")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: c.pixels.astype(np.float64) for name, c in file.channels().items()}
            header = dict(file.header())
    except (RuntimeError, ValueError) as error:
        raise ValueError(f"image {str(path)!r} is not an EXR file, or is damaged") from error
    mean, stderr = (_layer(channels, prefix) for prefix in ("", "stderr."))
    if mean is None:
        found = ", ".join(channels)
        raise ValueError(f"image {str(path)!r} has no channels R, G and B (but {found})")
    mark = "nonexp:"
    metadata = {k.removeprefix(mark): v for k, v in header.items() if k.startswith(mark)}
    return Picture(path, mean, stderr, metadata)


def _layer(channels: Mapping[str, Array], prefix: str) -> Array | None:
    names = [prefix + name for name in "RGB"]
    if any(name not in channels for name in names):
        return None
    return np.stack([channels[name] for name in names], axis=2)
