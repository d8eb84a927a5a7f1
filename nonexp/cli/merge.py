"""``nonexp merge``: one image of renders with different seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import mitsuba as mi

from ..images import merge as merging
from ..images.exr import exr_path, read, write
from ..system.files import check_writable
from ..system.machine import check_variant
from .arguments import argument, one_sentence

__all__ = ["merge"]


def merge(
    *images: Annotated[Path, argument("IN.exr")],
    output: Annotated[Path, argument("OUT.exr", None, "--output", "-o")],
) -> None:
    """Combine renders with different seeds into one.

    Combines images of one scene, rendered by nonexp with different seeds, into one: the mean
    weighted by samples, with its standard error.
    """
    with one_sentence():
        mi.set_variant(check_variant(None))  # which the PNG is written by
        path = exr_path(output)
        check_writable(path, path.with_suffix(".png"))
        image, metadata = merging.merge([read(file) for file in images])
        write(path, image, metadata)
    print(
        f"{path}: {image.spp} samples per pixel in {image.passes} passes "
        f"of {len(images)} images, {'black' if image.black else f'error {image.error:.2%}'}"
    )
