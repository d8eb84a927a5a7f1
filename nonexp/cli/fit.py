"""``nonexp fit``: fit models to a measured transmittance."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..system.terminal import stdout, table
from .arguments import definition, one_sentence
from .plot import values

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from ..fitting.fit import Fit

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to those of the parser."""
    fit = commands.add_parser(
        "fit",
        help="fit models to a measured transmittance",
        description="Fit the parameters of a model to a transmittance over distance, by least "
        "squares, and print what a scene's medium needs. DATA is a table with the columns "
        "distance (or optical depth), transmittance and, if known, its standard deviation, as "
        "text or as NPZ with arrays tau, ff and sigma. Several models are compared by AIC, "
        "Akaike's information criterion: the one with the least is the best.",
    )
    fit.add_argument("data", type=Path, metavar="DATA.csv", help="table: distance, ff [, sigma]")
    fit.add_argument(
        "--model",
        dest="models",
        action="append",
        metavar="MODEL",
        help="may be repeated; all (the default) tries every model",
    )
    for flag, does in (("--fix", "hold a parameter there"), ("--start", "start the search there")):
        fit.add_argument(
            flag,
            type=definition("alpha=0.5"),
            action="append",
            default=[],
            metavar="key=value",
            help=f"{does}, as in alpha=0.5; may be repeated",
        )
    fit.add_argument(
        "--sigma-t",
        type=_sigma_t,
        default="auto",
        metavar="VALUE",
        help="extinction that turns distance into optical depth: a number, fit, or auto (default: "
        "fitted, but 1 for models whose parameters are lengths or extinctions themselves)",
    )
    fit.add_argument(
        "-o", "--output", type=Path, metavar="OUT.png", help="also draw data, fits and residuals"
    )
    fit.set_defaults(run=_run)


def _sigma_t(text: str) -> float | str:
    if text in ("auto", "fit"):
        return text
    try:
        value = float(text)
    except ValueError:
        value = -1
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"is {text!r}: it must be a number > 0, fit, or auto")
    return value


def _run(options: argparse.Namespace) -> int:
    with one_sentence():
        _fit(options, stdout())
    return 0


def _fit(options: argparse.Namespace, console: Console) -> None:
    """Fit one model, or several and compare them; print the results."""
    from rich.text import Text

    from .. import fitting, models
    from ..fitting import plot as plotting

    if options.output is not None:
        plotting.require()
        plotting.check_path(options.output)
    tau, ff, sigma = fitting.read_table(options.data)
    every = not options.models or "all" in options.models
    names = models.names() if every else list(dict.fromkeys(options.models))
    given = {
        "start": values(options.start),
        "fixed": values(options.fix),
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
        console.print(_comparison(fits, console))
        for name, why in refused.items():
            console.print(Text(f"not fitted: {name} ({why})"), style="dim")
        console.print()
    _show(fits[0], sigma is not None, console)
    if options.output is not None:
        console.print(Text(f"\n{options.output}"))


def _check_known(names: Iterable[str], given: Iterable[str]) -> None:
    """Not every model must have each parameter, but one at least."""
    from ..fitting.problem import kinds_of

    known = {key for name in names for key in kinds_of(name)}
    for parameter in given:
        if parameter not in known:
            raise ValueError(f"none of the models to fit has a parameter {parameter!r}")


def _comparison(fits: list[Fit], console: Console) -> Table:
    from rich.text import Text

    columns = ("model", "parameters", "sigma_t", "rms residual", "AIC - best")
    found = table(console, *columns, numbers=True)
    for result in fits:
        rows = {name: (value, error) for name, value, error in result.rows()}
        sigma_t, _ = rows.pop("sigma_t")
        rows.pop("extinction", None)
        shown = ", ".join(f"{name} = {value}" for name, (value, _) in rows.items())
        cells = (result.name, shown, sigma_t, f"{result.residual:.3g}")
        found.add_row(*map(Text, cells), f"{result.aic - fits[0].aic:.1f}")
    found.columns[1].justify = "left"
    return found


def _show(result: Fit, weighted: bool, console: Console) -> None:
    from rich.text import Text

    rows = table(console, result.name, "value", "standard error", numbers=True)
    for row in result.rows():
        rows.add_row(*map(Text, row))
    console.print(rows)
    for line in result.notes:
        console.print(Text(line))
    goodness = f"rms residual {result.residual:.3g} over {result.points} points"
    if weighted:
        goodness += f", chi2 {result.chi2:.4g} with {result.freedom} degrees of freedom"
    console.print(Text(goodness), style="dim")
    console.print(Text("\nFor the medium of a scene in the same unit of length:"), style="dim")
    console.print(Text(result.to_xml()), soft_wrap=True)
