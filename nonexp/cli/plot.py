"""``nonexp plot``: draw a transmittance model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from ..models import create
from .arguments import Pairs, argument, definition, one_sentence

__all__ = ["plot", "values"]


def values(pairs: Pairs) -> dict[str, Any]:
    """Numbers as numbers; the rest, vectors among them, as the text that models understand."""
    understood: dict[str, Any] = {}
    for name, text in pairs:
        try:
            understood[name] = float(text)
        except ValueError:
            understood[name] = text
    return understood


def plot(
    model: Annotated[str, argument("MODEL")],
    /,
    *parameters: Annotated[tuple[str, str], argument("key=value", definition("alpha=0.5"))],
    output: Annotated[Path | None, argument("OUT.png", None, "--output", "-o")] = None,
) -> None:
    """Draw a transmittance model.

    Draws the transmittances and densities of a model over optical depth, beside the exponential law
    of the same mean extinction, and histograms of what it samples. Needs matplotlib.

    Args:
        model: one of those that `nonexp models` lists
        parameters: parameter of the model, such as alpha=0.5 or sigma=0.2,1.8
        output: PNG, SVG or PDF by its suffix (default: MODEL.png)
    """
    from ..fitting import plot as plotting

    path = output or Path(f"{model}.png")
    with one_sentence():
        law = create(model, **values(parameters))
        plotting.require()
        plotting.check_path(path)
        plotting.save(plotting.plot_model(law), path)
    print(path)
