"""``nonexp cloud``: a procedural cloud as a grid file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import mitsuba as mi

from ..scene import cloud as clouds
from ..system.files import check_writable
from ..system.machine import check_variant
from .arguments import UserError, argument, one_sentence, whole

__all__ = ["cloud"]


def cloud(
    file: Annotated[Path, argument("FILE")],
    /,
    *,
    resolution: Annotated[int, argument("N", whole(4, 1024))] = 128,
    seed: Annotated[int, argument("N", whole(0))] = 1,
) -> None:
    """Make a cloud, as a grid of densities from 0 to 1.

    The cloud is procedural: the same at every resolution, another one for each seed. The scene
    scenes/cloud.xml shows it.

    Args:
        file: where to write it, as .npz, .npy (NumPy) or .vol (Mitsuba) by its suffix
        resolution: voxels along each side of the cube (default: 128)
        seed: which cloud (default: 1)
    """
    if file.suffix not in clouds.ENDINGS:
        raise UserError(f"FILE is {str(file)!r}: it must end in {', '.join(clouds.ENDINGS)}")
    with one_sentence():
        check_writable(file, name="FILE")
        if file.suffix == ".vol":
            mi.set_variant(check_variant(None))  # which writes it
        array = clouds.cloud(resolution, seed)
        clouds.write(file, array)
    size = " x ".join(3 * [str(resolution)])
    print(f"{file}: {size} voxels, {(array == 0).mean():.0%} of them empty")
