"""``nonexp models``: the transmittance models that there are."""

from __future__ import annotations

import argparse
import inspect
from typing import Any

from ..system.terminal import stdout, table

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to those of the parser."""
    models = commands.add_parser(
        "models",
        help="list the transmittance models",
        description="List the transmittance models with their parameters.",
    )
    models.set_defaults(run=_models)


def _models(_options: argparse.Namespace) -> int:
    from rich.text import Text

    from .. import models
    from ..transmittance import parameters

    console = stdout()
    rows = table(console, "model", "transmittance", "parameters", "sigma_bar", lines=True)
    for name in models.names():
        cls = models.registry[name]
        law = (inspect.getdoc(cls) or "").partition("\n")[0]
        fields = [parameters.describe(field) for field in parameters.parameters_of(cls).values()]
        sigma_bar = f"{models.create(name, **cls.examples[0]).sigma_bar:.6g}"
        separator = "\n" if console.is_terminal else ", "
        row = (name, law, separator.join(fields) or "none", sigma_bar)
        rows.add_row(*(Text(cell) for cell in row))
    console.print(rows)
    console.print(
        Text("tau is optical depth, sigma_bar = -T'(0) at the default parameters."), style="dim"
    )
    return 0
