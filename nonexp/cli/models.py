"""``nonexp models``: the transmittance models that there are."""

from __future__ import annotations

import inspect

from ..models import create, names, registry
from ..system.terminal import show, table
from ..transmittance.parameters import describe, parameters_of

__all__ = ["models"]


def models() -> None:
    """List the transmittance models with their parameters."""
    rows = table("model", "transmittance", "parameters", "sigma_bar", lines=True)
    for name in names():
        cls = registry[name]
        law = (inspect.getdoc(cls) or "").partition("\n")[0]
        fields = [describe(field) for field in parameters_of(cls).values()]
        sigma_bar = f"{create(name, **cls.examples[0]).sigma_bar:.6g}"
        rows.add_row(name, law, "\n".join(fields) or "none", sigma_bar)
    show(rows)
    show("tau is optical depth, sigma_bar = -T'(0) at the default parameters.", style="dim")
