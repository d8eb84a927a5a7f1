"""``nonexp compare``: how two images of a scene differ, and whether that is noise."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..system.terminal import stdout, table
from .arguments import one_sentence

if TYPE_CHECKING:
    from ..images.compare import Comparison
    from ..images.exr import Picture

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to those of the parser."""
    compare = commands.add_parser(
        "compare",
        help="tell whether two images differ by more than noise",
        description="Compare image A with image B, the reference: errors, and a test of blocks of "
        "pixels against the standard errors in both files. The exit code is 0 if they differ by "
        "noise alone, or there is no noise to compare with, and 1 if they differ by more.",
    )
    compare.add_argument("a", type=Path, metavar="A.exr")
    compare.add_argument("b", type=Path, metavar="B.exr")
    compare.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="DIFF.png",
        help="the difference A - B as a picture (PNG: red where A is brighter, blue where B is) "
        "or as numbers (EXR, with its standard error)",
    )
    compare.set_defaults(run=_compare)


def _compare(options: argparse.Namespace) -> int:
    from ..images import compare as comparing
    from ..images import exr as output

    path: Path | None = options.output
    with one_sentence():
        if path is not None:
            _check(path)
        a, b = output.read(options.a), output.read(options.b)
        found = comparing.compare(a, b)
        scale = _write(path, a, b) if path is not None else None
    console = stdout()
    rows = table(console, "A against B", "value", numbers=True)
    for name, value in _rows(found):
        rows.add_row(name, value)
    console.print(rows)
    print(_verdict(found, a, b))
    if path is not None:
        print(path if scale is None else f"{path}: full colour is a difference of {scale:.3g}")
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
    """What the test presumes, and is not so."""
    from ..images import merge as merging

    doubts = []
    filters = {p.metadata.get("filter", "BoxFilter") for p in (a, b)} - {"BoxFilter"}
    if filters:
        doubts.append(f"the {filters.pop()} correlates neighbouring pixels")
    if shared := set(merging.seeds(a)) & set(merging.seeds(b)):
        doubts.append(f"both images hold seed {min(shared)}")
    return doubts


def _check(path: Path) -> None:
    from ..system.files import check_writable

    if path.suffix.lower() not in (".png", ".exr"):
        raise ValueError(f"output is {str(path)!r}: it must end in .png or .exr")
    check_writable(path)


def _write(path: Path, a: Picture, b: Picture) -> float | None:
    """Write the difference; returns what full colour means."""
    import mitsuba as mi
    import numpy as np

    from ..images import compare as comparing
    from ..images import exr as output
    from ..system import machine
    from ..system.files import replacing

    with replacing(path) as (aside,):
        if path.suffix.lower() == ".exr":
            layers = {"": a.mean - b.mean}
            if a.stderr is not None and b.stderr is not None:
                layers["stderr."] = np.hypot(a.stderr, b.stderr)
            output.write_exr(aside, layers, {"difference": f"{a.path} - {b.path}"})
            return None
        mi.set_variant(machine.check_variant(None))
        colours, scale = comparing.picture(a, b)
        output.write_png(aside, colours)
    return scale
