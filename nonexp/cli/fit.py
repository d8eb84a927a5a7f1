"""``nonexp fit``: fit models to a measured transmittance, or a scene to images."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from .. import fitting
from ..fitting.fit import Fit
from ..fitting.problem import kinds_of
from ..models import names as all_models
from ..system.terminal import show, stdout, table
from .arguments import (
    Definitions,
    Pairs,
    UserError,
    Variant,
    argument,
    definition,
    one_sentence,
    whole,
)
from .fit_images import Search, fit_images
from .fit_images import parameter as unknown
from .plot import values

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["fit"]

IMAGES = Group("Fit a scene to images", sort_key=1)


def _sigma_t(text: str) -> float | str:
    if text in ("auto", "fit"):
        return text
    try:
        value = float(text)
    except ValueError:
        value = -1
    if not 0 < value < math.inf:
        raise ValueError(f"is {text!r}: it must be a number > 0, fit, or auto")
    return value


_PAIR = argument("key=value", definition("alpha=0.5"), many=True)


def fit(
    data: Annotated[Path, argument("DATA")],
    /,
    *,
    model: Annotated[tuple[str, ...], argument("MODEL", str, many=True)] = (),
    fix: Annotated[Pairs, _PAIR] = (),
    start: Annotated[Pairs, _PAIR] = (),
    sigma_t: Annotated[float | str, argument("VALUE", _sigma_t)] = "auto",
    output: Annotated[Path | None, argument("OUT.png", None, "--output", "-o")] = None,
    image: Annotated[tuple[Path, ...], argument("IMAGE.exr", Path, many=True, group=IMAGES)] = (),
    parameter: Annotated[
        Pairs, argument("NAME[=START]", unknown, "--parameter", "-p", many=True, group=IMAGES)
    ] = (),
    parameters: Annotated[Definitions, Parameter(group=IMAGES)] = (),
    medium: Annotated[str | None, argument("NAME", None, group=IMAGES)] = None,
    sensor: Annotated[tuple[str, ...], argument("N", str, many=True, group=IMAGES)] = (),
    free_exposure: Annotated[bool, Parameter(group=IMAGES)] = False,
    spp: Annotated[int | None, argument("N", whole(4), group=IMAGES)] = None,
    steps: Annotated[int | None, argument("N", whole(1), group=IMAGES)] = None,
    seed: Annotated[int | None, argument("S", whole(0), group=IMAGES)] = None,
    variant: Annotated[Variant, Parameter(group=IMAGES)] = None,
) -> None:
    """Fit models to a measured transmittance, or a scene to images.

    Fits the parameters of a model to a transmittance over distance, by least squares, and prints
    what a scene's medium needs. DATA is a table with the columns distance (or optical depth),
    transmittance and, if known, its standard deviation, as text or as NPZ with arrays tau, ff and
    sigma. Several models are compared by AIC, Akaike's information criterion: the one with the
    least is the best.

    With --image DATA is a scene, whose parameters are fitted to EXR images. Each --model takes the
    place of the medium's law, and all of its parameters are fitted; without, the law stays. Laws
    are compared by their loss, the mean squared difference without noise. With -o all numbers go to
    OUT.json, beside the picture OUT.png.

    Args:
        data: table: distance, ff [, sigma]; with --image a scene file
        model: may be repeated; all tries every model (the default for a table)
        fix: hold a parameter there, as in alpha=0.5; may be repeated
        start: start the search there, as in alpha=0.5; may be repeated
        sigma_t: extinction that turns distance into optical depth: a number, fit, or auto (default:
            fitted, but 1 for models whose parameters are lengths or extinctions themselves)
        output: also draw data, fits and residuals
        image: fit a scene to this image, of the size that it is rendered in; may be repeated, for
            one image per sensor
        parameter: parameter of the scene to fit, such as sigma_t or albedo=0.5 to start there; may
            be repeated
        medium: medium whose law is exchanged, if there are several
        sensor: number or id of an image's sensor (default: the scene's, in order)
        free_exposure: fit a factor on the brightness of each image
        spp: samples per pixel in the end, twice (default: 1024)
        steps: most steps of the search (default: 20)
        seed: default: 0
    """
    options: dict[str, Any] = {
        "sensor": sensor,
        "medium": medium,
        "free_exposure": free_exposure,
        "spp": spp,
        "steps": steps,
        "seed": seed,
    }
    if image:
        if sigma_t != "auto":
            raise UserError("--sigma-t goes with a table: with --image it is -p sigma_t=VALUE")
        search = Search(data, image, parameter, parameters, model, values(fix), values(start))
        fit_images(search, output, variant, **options)
        return
    for name, value in {"parameter": parameter, "-D": parameters, **options}.items():
        if value:
            flag = name if name == "-D" else "--" + name.replace("_", "-")
            raise UserError(f"{flag} goes with --image: a table has no scene")
    with one_sentence():
        _fit(data, model, values(fix), values(start), sigma_t, output)


def _fit(
    data: Path,
    models: tuple[str, ...],
    fixed: dict[str, Any],
    start: dict[str, Any],
    sigma_t: float | str,
    output: Path | None,
) -> None:
    """Fit one model, or several and compare them; print the results."""
    from ..fitting import plot as plotting

    if output is not None:
        plotting.require()
        plotting.check_path(output)
    tau, ff, sigma = fitting.read_table(data)
    every = not models or "all" in models
    names = all_models() if every else list(dict.fromkeys(models))
    given: dict[str, Any] = {"start": start, "fixed": fixed, "sigma_t": sigma_t, "sigma": sigma}
    refused: dict[str, str] = {}
    with stdout().status("fitting ..."):
        if len(names) == 1:
            fits = [fitting.fit(names[0], tau, ff, **given)]
        else:
            _check_known(names, {**start, **fixed})
            fits, refused = fitting.compare(names, tau, ff, **given)
        if refused and (not every or not fits):
            raise ValueError("; ".join(f"{name}: {why}" for name, why in refused.items()))
    if output is not None:
        plotting.save(plotting.plot_fit(fits, tau, ff, sigma), output)
    if len(names) > 1:
        show(_comparison(fits))
        for name, why in refused.items():
            show(f"not fitted: {name} ({why})", style="dim")
        print()
    _show(fits[0], sigma is not None)
    if output is not None:
        print(f"\n{output}")


def _check_known(names: Iterable[str], given: Iterable[str]) -> None:
    """Raise ``ValueError`` for a parameter that none of the models has."""
    known = {key for name in names for key in kinds_of(name)}
    for parameter in given:
        if parameter not in known:
            raise ValueError(f"none of the models to fit has a parameter {parameter!r}")


def _comparison(fits: list[Fit]) -> Table:
    columns = ("model", "parameters", "sigma_t", "rms residual", "AIC - best")
    found = table(*columns, numbers=True)
    for result in fits:
        rows = {name: (value, error) for name, value, error in result.rows()}
        sigma_t, _ = rows.pop("sigma_t")
        rows.pop("extinction", None)
        shown = ", ".join(f"{name} = {value}" for name, (value, _) in rows.items())
        aic = f"{result.aic - fits[0].aic:.1f}"
        found.add_row(result.name, shown, sigma_t, f"{result.residual:.3g}", aic)
    found.columns[1].justify, found.columns[1].no_wrap = "left", False
    return found


def _show(result: Fit, weighted: bool) -> None:
    rows = table(result.name, "value", "standard error", numbers=True)
    for row in result.rows():
        rows.add_row(*row)
    show(rows)
    for line in result.notes:
        show(line)
    goodness = f"rms residual {result.residual:.3g} over {result.points} points"
    if weighted:
        goodness += f", chi2 {result.chi2:.4g} with {result.freedom} degrees of freedom"
    show(goodness, style="dim")
    show("\nFor the medium of a scene in the same unit of length:", style="dim")
    show(result.to_xml())
