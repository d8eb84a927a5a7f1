"""Image files: EXR with the standard error and metadata, a PNG beside it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from ..system.files import replacing
from .image import Image
from .moments import Array
from .png import tone_map, write_png

__all__ = ["Picture", "exr_path", "independent", "read", "write", "write_exr"]

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


def independent(picture: Picture) -> int:
    """Independent images that its standard error comes from; many where the file does not say."""
    known = picture.metadata
    return int(known.get("independent", known.get("passes", 1000)))


def exr_path(output: Path) -> Path:
    """The EXR file of an output, which may be named as the PNG beside it.

    Raises ``ValueError`` for another suffix.
    """
    if output.suffix.lower() not in (".exr", ".png"):
        raise ValueError(f"output is {str(output)!r}: it must be a file name in .exr or .png")
    return output if output.suffix.lower() == ".exr" else output.with_suffix(".exr")


def write(path: Path, image: Image, metadata: Metadata, denoised: Array | None = None) -> None:
    """Write an image as EXR, and tone-mapped as PNG beside it.

    The EXR holds 32-bit floats: the mean in ``R, G, B``, its standard error in ``stderr.R,
    stderr.G, stderr.B``, and ``metadata`` as header attributes ``nonexp:<key>``. A ``denoised``
    image is added to it as ``denoised.R, ...``, and is also written to a PNG of its own. The files
    replace existing ones when all of them are complete; otherwise ``OSError`` says why.
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
    except (OSError, RuntimeError) as error:  # whose text names the temporary files
        why = re.sub(r"^.*?\.part\W*", "", str(error), flags=re.DOTALL)
        raise OSError(f"{str(path)!r} cannot be written: {why.strip(' .') or error}") from error


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
