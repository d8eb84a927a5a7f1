"""``nonexp compare``: how two images of a scene differ, and whether that is noise."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import mitsuba as mi
import numpy as np

from ..images.exr import Picture, read, write_exr
from ..images.merge import seeds
from ..images.png import write_png
from ..system.files import check_writable, replacing
from ..system.machine import check_variant
from ..system.terminal import show, table
from .arguments import argument, one_sentence

if TYPE_CHECKING:
    from ..images.compare import Comparison

__all__ = ["compare"]


def compare(
    a: Annotated[Path, argument("A.exr")],
    b: Annotated[Path, argument("B.exr")],
    /,
    *,
    output: Annotated[Path | None, argument("DIFF.png", None, "--output", "-o")] = None,
) -> int:
    """Tell whether two images differ by more than noise.

    Compares image A with image B, the reference: errors, and a test of blocks of pixels against the
    standard errors in both files. The exit code is 0 if they differ by noise alone, or there is no
    noise to compare with, and 1 if they differ by more.

    Args:
        output: the difference A - B as a picture (PNG: red where A is brighter, blue where B is) or
            as numbers (EXR, with its standard error)
    """
    from ..images.compare import compare as compared  # scipy.stats takes a while

    with one_sentence():
        if output is not None:
            if output.suffix.lower() not in (".png", ".exr"):
                raise ValueError(f"output is {str(output)!r}: it must end in .png or .exr")
            check_writable(output)
        first, second = read(a), read(b)
        found = compared(first, second)
        scale = None if output is None else _write(output, first, second)
    rows = table("A against B", "value", numbers=True)
    for name, value in _rows(found):
        rows.add_row(name, value)
    show(rows)
    print(_verdict(found, first, second))
    if output is not None:
        print(output if scale is None else f"{output}: full colour is a difference of {scale:.3g}")
    return 1 if found.test is not None and not found.test.same else 0


def _rows(found: Comparison) -> list[tuple[str, str]]:
    rows = [("mean squared error", f"{found.mse:.4g}")]
    if found.noise is not None:
        rows.append(("  of which noise makes", f"{found.noise:.4g}"))
    rows.append(("relative mean squared error", f"{found.rel_mse:.4g}"))
    rows.append(("bias of the mean", f"{found.bias:+.3%}"))
    if found.bias_error is not None:
        rows.append(("  its standard error", f"{found.bias_error:.3%}"))
    if found.test is not None:
        rows.append((f"squared deviation of {found.test.blocks} blocks", f"{found.test.chi2:.3g}"))
        rows.append(("largest deviation, in standard errors", f"{found.test.worst:.2f}"))
        rows.append(("  limit", f"{found.test.limit:.2f}"))
    return rows


def _verdict(found: Comparison, a: Picture, b: Picture) -> str:
    if found.test is None:
        return "No verdict: a file has no standard error, or is of a single pass."
    doubts = _doubts(a, b)
    caution = f" (to be doubted: {' and '.join(doubts)})" if doubts else ""
    if found.test.same:
        return (
            "The images differ by noise alone, as far as can be seen: a bias of "
            f"{found.test.seen:.2%} over the whole image would have shown{caution}."
        )
    place = "over the whole image"
    if found.test.place is not None:
        place = "most around pixel {}, {}".format(*found.test.place)
    return f"The images differ by more than noise, {place}{caution}."


def _doubts(a: Picture, b: Picture) -> list[str]:
    """Assumptions of the test that do not hold."""
    doubts = []
    filters = {p.metadata.get("filter", "BoxFilter") for p in (a, b)} - {"BoxFilter"}
    if filters:
        doubts.append(f"the {filters.pop()} correlates neighbouring pixels")
    if shared := set(seeds(a)) & set(seeds(b)):
        doubts.append(f"both images hold seed {min(shared)}")
    return doubts


def _write(path: Path, a: Picture, b: Picture) -> float | None:
    """Write the difference; returns what full colour means."""
    from ..images.compare import picture

    with replacing(path) as (aside,):
        if path.suffix.lower() == ".exr":
            layers = {"": a.mean - b.mean}
            if a.stderr is not None and b.stderr is not None:
                layers["stderr."] = np.hypot(a.stderr, b.stderr)
            write_exr(aside, layers, {"difference": f"{a.path} - {b.path}"})
            return None
        mi.set_variant(check_variant(None))  # which the PNG is written by
        colours, scale = picture(a, b)
        write_png(aside, colours)
    return scale
