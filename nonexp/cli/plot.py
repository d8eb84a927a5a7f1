"""``nonexp plot``: draw a transmittance model."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from .arguments import definition, one_sentence

__all__ = ["add", "values"]


def add(commands: Any) -> None:
    """Add the command to those of the parser."""
    plot = commands.add_parser(
        "plot",
        help="draw a transmittance model",
        description="Draw the transmittances and densities of a model over optical depth, beside "
        "the exponential law of the same mean extinction, and histograms of what it samples. "
        "Needs matplotlib.",
    )
    plot.add_argument("model", metavar="MODEL", help="one of those that `nonexp models` lists")
    plot.add_argument(
        "parameters",
        nargs="*",
        type=definition("alpha=0.5"),
        default=[],
        metavar="key=value",
        help="parameter of the model, such as alpha=0.5 or sigma=0.2,1.8",
    )
    plot.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="OUT.png",
        help="PNG, SVG or PDF by its suffix (default: MODEL.png)",
    )
    plot.set_defaults(run=_plot)


def values(pairs: Iterable[tuple[str, str]]) -> dict[str, Any]:
    """Numbers as numbers; the rest, vectors among them, as the text that models understand."""
    understood: dict[str, Any] = {}
    for name, text in pairs:
        try:
            understood[name] = float(text)
        except ValueError:
            understood[name] = text
    return understood


def _plot(options: argparse.Namespace) -> int:
    from .. import models
    from ..fitting import plot as plotting

    path: Path = options.output or Path(f"{options.model}.png")
    with one_sentence():
        model = models.create(options.model, **values(options.parameters))
        plotting.require()
        plotting.check_path(path)
        plotting.save(plotting.plot_model(model), path)
    print(path)
    return 0
