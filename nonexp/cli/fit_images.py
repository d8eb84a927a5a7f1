"""``nonexp fit --image``: fit a scene to images."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..images.exr import read
from ..models import names as all_models
from ..system.files import check_writable, write_text
from ..system.terminal import show, table
from .arguments import Pairs, load, one_sentence

if TYPE_CHECKING:
    from ..inverse import Report

__all__ = ["Search", "fit_images", "parameter"]


@dataclass(frozen=True)
class Search:
    """What is fitted to what."""

    scene: Path
    images: tuple[Path, ...]
    parameters: Pairs
    """names in the scene, and where to start"""
    definitions: Pairs
    """of the scene file"""
    models: tuple[str, ...]
    fixed: Mapping[str, Any]
    """parameters of models that are held"""
    start: Mapping[str, Any]
    """where parameters of models start"""


def parameter(text: str) -> tuple[str, str]:
    """NAME or NAME=START; START is one number or several."""
    name, equals, value = text.partition("=")
    try:
        _numbers(value)
    except ValueError:
        equals, value = "=", ""
    if not re.fullmatch(r"[\w.]+(\[\d+\])?", name) or (equals and not value):
        raise ValueError(f"is {text!r}: it must be NAME or NAME=START, as in albedo=0.5")
    return name, value


def _numbers(text: str) -> list[float] | None:
    return [float(word) for word in re.split(r"[\s,;]+", text.strip()) if word] or None


def fit_images(
    search: Search,
    output: Path | None,
    variant: str | None,
    *,
    sensor: Sequence[str],
    medium: str | None,
    free_exposure: bool,
    spp: int | None,
    steps: int | None,
    seed: int | None,
) -> None:
    """Fit a scene to images; print the result and write it."""
    from .. import inverse  # which loads much
    from ..fitting import plot as plotting

    with one_sentence():
        if output is not None:
            plotting.require()
            plotting.check_path(output)
            _check_results(output.with_suffix(".json"))
        pictures = [read(path) for path in search.images]
        sizes = {picture.mean.shape[1::-1] for picture in pictures}
        if len(sizes) > 1:
            shown = ", ".join(f"{p.path} is {p.mean.shape[1]}x{p.mean.shape[0]}" for p in pictures)
            raise ValueError(f"the images differ in size: {shown} pixels")
        laws = _laws(search)
    size: Any = next(iter(sizes))
    loaded = load(search.scene, variant, search.definitions, size)
    given: dict[str, Any] = {"spp": spp, "steps": steps, "seed": seed}
    with one_sentence():
        try:
            report = inverse.fit(
                loaded.scene,
                {name: _numbers(start) for name, start in search.parameters},
                pictures,
                laws=laws,
                medium=medium,
                fixed=search.fixed if laws else None,
                exposure="free" if free_exposure else "fixed",
                sensors=sensor or None,
                progress=True,
                **{name: value for name, value in given.items() if value is not None},
            )
        except KeyError as error:
            raise ValueError(error.args[0]) from None
        _show(report)
        if output is not None:
            numbers = output.with_suffix(".json")
            plotting.save(report.plot(), output)
            text = json.dumps({**_asked(search), **report.to_dict()}, indent=2, allow_nan=False)
            write_text(numbers, text + "\n")
            print(f"\n{output}\n{numbers}")


def _check_results(path: Path) -> None:
    """Raise ``ValueError`` or ``OSError`` unless results can be written there, in place of nothing
    but older ones."""
    check_writable(path)
    if not path.exists():
        return
    try:
        older = "fits" in json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, TypeError):
        older = False
    if not older:
        raise ValueError(f"{str(path)!r} exists and is no result of a fit: give another --output")


def _laws(search: Search) -> dict[str, dict[str, Any]] | None:
    """The laws to try, with where they start; None: the scene's own."""
    if not search.models:
        for option, given in {"--fix": search.fixed, "--start": search.start}.items():
            if given:
                raise ValueError(
                    f"{option} is for the parameters of a --model: those of the scene are -p"
                )
        return None
    from ..fitting.problem import kinds_of

    names = all_models() if "all" in search.models else list(dict.fromkeys(search.models))
    known = {name: kinds_of(name) for name in names}
    for key in search.start:
        if not any(key in kinds for kinds in known.values()):
            raise ValueError(f"none of the models to fit has a parameter {key!r}")
    return {n: {k: v for k, v in search.start.items() if k in known[n]} for n in names}


def _asked(search: Search) -> dict[str, Any]:
    return {
        "scene": str(search.scene),
        "parameters": dict(search.definitions),
        "images": [str(path) for path in search.images],
    }


def _show(report: Report) -> None:
    rows = table("law", "loss", "by the best", "parameters", numbers=True)
    for row in report.rows():
        rows.add_row(*row)
    rows.columns[-1].justify, rows.columns[-1].no_wrap = "left", False
    show(rows)
    for line in report.all_notes():
        show(line)
    if xml := report.best.to_xml():
        show("\nThe law for the medium of a scene:", style="dim")
        show(xml)
