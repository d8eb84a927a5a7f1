"""Image files: EXR with the standard error and metadata, PNG to look at."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR

from .rendering import Array, Image

__all__ = ["check", "tone_map", "write"]


def check(path: Path) -> None:
    """Raise ``ValueError`` or ``OSError`` unless an EXR file, and a PNG beside it, can be written.

    Leaves no trace, and existing files alone.
    """
    if path.suffix.lower() != ".exr":
        raise ValueError(f"output is {str(path)!r}: it must be a file name that ends in .exr")
    if not path.parent.is_dir():
        raise OSError(f"output is {str(path)!r}: its folder {str(path.parent)!r} does not exist")
    for target in (path, path.with_suffix(".png")):
        if target.is_dir():
            raise OSError(f"output is {str(path)!r}: {str(target)!r} is a folder")
        try:
            with open(_aside(target), "xb"):
                pass
            os.unlink(_aside(target))
        except OSError as error:
            raise OSError(
                f"output is {str(path)!r}: its folder {str(path.parent)!r} must be writable "
                f"({error.strerror})"
            ) from error


def write(path: Path, image: Image, metadata: Mapping[str, str | int | float]) -> None:
    """Write an image as EXR, and tone-mapped as PNG beside it.

    The EXR holds 32-bit floats: the mean in ``R, G, B``, its standard error in ``stderr.R,
    stderr.G, stderr.B``, and ``metadata`` as header attributes ``nonexp:<key>``. Both files are
    written aside and put in place when they are complete.
    """
    picture = path.with_suffix(".png")
    aside = {target: _aside(target) for target in (path, picture)}
    try:
        _write_exr(aside[path], image, metadata)
        _write_png(aside[picture], image.mean)
        for target, finished in aside.items():
            os.replace(finished, target)
    finally:
        for unfinished in aside.values():
            unfinished.unlink(missing_ok=True)


def tone_map(linear: Array) -> Array:
    """Displayable values in [0, 1]: linear up to 0.7, a smooth shoulder above, sRGB transfer."""
    knee = 0.7
    bright = 1 - (1 - knee) * np.exp((knee - np.maximum(linear, knee)) / (1 - knee))
    value = np.clip(np.where(linear > knee, bright, np.nan_to_num(linear)), 0, 1)
    srgb: Array = np.where(
        value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 0.0031308) ** (1 / 2.4) - 0.055
    )
    return srgb


def _write_exr(path: Path, image: Image, metadata: Mapping[str, str | int | float]) -> None:
    header = {f"nonexp:{key}": value for key, value in metadata.items()}
    header |= {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    layers = {"": image.mean, "stderr.": image.stderr}
    channels = {
        prefix + name: np.ascontiguousarray(values[:, :, i], dtype=np.float32)
        for prefix, values in layers.items()
        for i, name in enumerate("RGB")
    }
    OpenEXR.File(header, channels).write(str(path))


def _write_png(path: Path, mean: Array) -> None:
    pixels = np.round(255 * tone_map(mean)).astype(np.uint8)
    mi.Bitmap(pixels).write(str(path), mi.Bitmap.FileFormat.PNG)


def _aside(path: Path) -> Path:
    """Name of the unfinished file: in the same folder, so that it can replace the old one."""
    return path.with_name(f".{path.name}.{os.getpid()}.part")
