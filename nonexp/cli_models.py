"""What ``nonexp plot`` and ``nonexp fit`` do; errors leave as exceptions of one sentence."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from . import fitting, leastsquares, models, plotting

if TYPE_CHECKING:
    from .fitting import Fit

__all__ = ["fit", "plot"]


def plot(options: argparse.Namespace) -> str:
    """Draw a model; returns the file's name."""
    path: Path = options.output or Path(f"{options.model}.png")
    model = models.create(options.model, **_values(options.parameters))
    plotting.require()
    plotting.check(path)
    plotting.save(plotting.plot_model(model), path)
    return str(path)


def fit(options: argparse.Namespace, console: Console) -> None:
    """Fit one model, or several and compare them; print the results."""
    if options.output is not None:
        plotting.require()
        plotting.check(options.output)
    tau, ff, sigma = fitting.read_table(options.data)
    every = not options.models or "all" in options.models
    names = models.names() if every else list(dict.fromkeys(options.models))
    given = {
        "start": _values(options.start),
        "fixed": _values(options.fix),
        "sigma_t": options.sigma_t,
        "sigma": sigma,
    }
    refused: dict[str, str] = {}
    with console.status("fitting ..."):
        if len(names) == 1:
            fits = [fitting.fit(names[0], tau, ff, **given)]
        else:
            _check_known(names, {**given["start"], **given["fixed"]})
            fits, refused = fitting.compare(names, tau, ff, **given)
        if refused and (not every or not fits):
            raise ValueError("; ".join(f"{name}: {why}" for name, why in refused.items()))
    if options.output is not None:
        plotting.save(plotting.plot_fit(fits, tau, ff, sigma), options.output)
    if len(names) > 1:
        console.print(_comparison(fits, console.is_terminal))
        for name, why in refused.items():
            console.print(Text(f"not fitted: {name} ({why})"), style="dim")
        console.print()
    _show(fits[0], sigma is not None, console)
    if options.output is not None:
        console.print(Text(f"\n{options.output}"))


def _values(pairs: Iterable[tuple[str, str]]) -> dict[str, Any]:
    """Numbers as numbers; the rest, vectors among them, as the text that models understand."""
    values: dict[str, Any] = {}
    for name, text in pairs:
        try:
            values[name] = float(text)
        except ValueError:
            values[name] = text
    return values


def _check_known(names: Iterable[str], given: Iterable[str]) -> None:
    """Not every model must have each parameter, but one at least."""
    known = {key for name in names for key in leastsquares.fields_of(name)}
    for parameter in given:
        if parameter not in known:
            raise ValueError(f"none of the models to fit has a parameter {parameter!r}")


def _table(terminal: bool, *columns: str) -> Table:
    table = Table(box=box.ROUNDED if terminal else None, pad_edge=terminal)
    for i, column in enumerate(columns):
        table.add_column(column, no_wrap=not terminal, justify="right" if i else "left")
    return table


def _comparison(fits: list[Fit], terminal: bool) -> Table:
    table = _table(terminal, "model", "parameters", "sigma_t", "rms residual", "AIC - best")
    for result in fits:
        rows = {name: (value, error) for name, value, error in result.rows()}
        sigma_t, _ = rows.pop("sigma_t")
        rows.pop("extinction", None)
        shown = ", ".join(f"{name} = {value}" for name, (value, _) in rows.items())
        cells = (result.name, shown, sigma_t, f"{result.residual:.3g}")
        table.add_row(*map(Text, cells), f"{result.aic - fits[0].aic:.1f}")
    table.columns[1].justify = "left"
    return table


def _show(result: Fit, weighted: bool, console: Console) -> None:
    table = _table(console.is_terminal, result.name, "value", "standard error")
    for row in result.rows():
        table.add_row(*map(Text, row))
    console.print(table)
    for note in result.notes:
        console.print(Text(note))
    goodness = f"rms residual {result.residual:.3g} over {result.points} points"
    if weighted:
        goodness += f", chi2 {result.chi2:.4g} with {result.freedom} degrees of freedom"
    console.print(Text(goodness), style="dim")
    console.print(Text("\nFor the medium of a scene in the same unit of length:"), style="dim")
    console.print(Text(result.to_xml()), soft_wrap=True)
