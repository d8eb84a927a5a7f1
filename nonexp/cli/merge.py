"""``nonexp merge``: one image of renders with different seeds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .arguments import one_sentence

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to those of the parser."""
    merge = commands.add_parser(
        "merge",
        help="combine renders with different seeds into one",
        description="Combine images of one scene, rendered by nonexp with different seeds, into "
        "one: the mean weighted by samples, with its standard error.",
    )
    merge.add_argument("images", type=Path, nargs="+", metavar="IN.exr")
    merge.add_argument("-o", "--output", type=Path, metavar="OUT.exr", required=True)
    merge.set_defaults(run=_merge)


def _merge(options: argparse.Namespace) -> int:
    import mitsuba as mi

    from ..images import exr as output
    from ..images import merge as merging
    from ..system import machine

    with one_sentence():
        mi.set_variant(machine.check_variant(None))  # which the PNG is written by
        output.check(options.output)
        pictures = [output.read(path) for path in options.images]
        image, metadata = merging.merge(pictures)
        output.write(options.output, image, metadata)
    print(
        f"{options.output}: {image.spp} samples per pixel in {image.passes} passes "
        f"of {len(pictures)} images, error {image.error:.2%}"
    )
    return 0
