"""What a fit to images found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mitsuba as mi

from .. import models
from ..transmittance import Transmittance
from ..transmittance.shown import html_table, signed, with_error
from .laws import Place
from .search import Step
from .unknowns import Unknown, write
from .views import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ImageFit", "Report"]

_HEAD = ("law", "loss", "by the best", "parameters")


@dataclass(frozen=True, eq=False, repr=False)
class ImageFit:
    """Parameters of a scene, with one law, fitted to images."""

    law: str
    """the law, as the fit was asked for it"""
    model: Transmittance | None
    """the law with the fitted parameters; None where the scene has no single medium with a law"""
    values: dict[str, float]
    """every fitted number"""
    errors: dict[str, float]
    """its standard error; inf where the images do not determine it, NaN where it sits at a limit"""
    covariance: Array
    """of the fitted numbers, in their order; 0 for those at a limit"""
    start: dict[str, float]
    """where the search began"""
    exposures: tuple[float, ...]
    """factor on the rendered image of each view"""
    loss: float
    """weighted mean of (fitted - image)^2, without the noise of the render, and without that of the
    image if it is known; may be less than 0 by its error"""
    loss_error: float
    """standard error of the loss"""
    steps: tuple[Step, ...]
    """where the search was, its last point included"""
    converged: bool
    """the last step was as small as its noise"""
    images: tuple[Array, ...]
    """the fitted image of each view"""
    ways: dict[str, str]
    """how each number's derivative was found: ``replay`` or ``differences``"""
    notes: tuple[str, ...]
    """what to know before trusting the numbers, one sentence each"""
    medium: str | None
    """the medium that has the law"""
    unknowns: tuple[Unknown, ...]
    """what was fitted"""

    def apply(self, scene: mi.Scene) -> None:
        """Give a scene the fitted law and parameters."""
        if self.medium is not None and self.model is not None:
            Place(scene, self.medium).put(self.model)
        values = [self.values[one.label] for one in self.unknowns]
        write(mi.traverse(scene), self.unknowns, values)

    def rows(self) -> list[tuple[str, str, str]]:
        """Name, value and standard error of every number, as text."""
        return [(n, *with_error(v, self.errors.get(n))) for n, v in self.values.items()]

    def to_xml(self, indent: str = "") -> str:
        """The fitted law as the element of a medium; empty where there is none."""
        return "" if self.model is None else models.to_xml(self.model, indent)

    def __str__(self) -> str:
        lines = [f"{self.law}: loss {_loss(self)} after {len(self.steps) - 1} steps"]
        rows = self.rows()
        widths = [max(len(row[i]) for row in rows) for i in (0, 1)]
        for name, value, error in rows:
            lines.append(f"  {name:{widths[0]}}  {value:>{widths[1]}} {signed(error)}".rstrip())
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={value} {signed(error)}" for name, value, error in self.rows())
        return f"ImageFit({self.law}: {shown}, loss={_loss(self)})"


@dataclass(frozen=True, eq=False, repr=False)
class Report:
    """Fits of one or several laws. ``print(report)`` and Jupyter show them as a table."""

    fits: tuple[ImageFit, ...]
    """the laws, the one of least loss first"""
    refused: dict[str, str]
    """laws that could not be fitted, with the reason"""
    targets: tuple[Array, ...]
    """the images that were fitted"""
    notes: tuple[str, ...] = ()
    """what to know before preferring one of the laws"""

    @property
    def best(self) -> ImageFit:
        """The fit of least loss."""
        return self.fits[0]

    def __getitem__(self, law: str) -> ImageFit:
        for one in self.fits:
            if one.law == law:
                return one
        raise KeyError(f"there is no fit of {law!r}: the laws are {[f.law for f in self.fits]}")

    def ratio(self, law: str) -> tuple[float, bool]:
        """How many times greater a law's loss is than that of the best.

        The second value says whether it is at least so many times greater: where the best loss is
        not known to be above 0, both losses count with two standard errors against the ratio.
        """
        one, best = self[law], self.best
        if best.loss > 3 * best.loss_error or one is best:
            return (1.0 if one is best else one.loss / best.loss), False
        most = max(best.loss, 0.0) + 2 * best.loss_error
        return (max(one.loss - 2 * one.loss_error, 0.0) / most if most else math.inf), True

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Law, loss, ratio to the best loss, and parameters of every fit, as text."""
        found = []
        for one in self.fits:
            ratio, least = self.ratio(one.law)
            shown = [
                f"{name} = {value} {signed(error)}".rstrip() for name, value, error in one.rows()
            ]
            by = "" if one is self.best else f"{'> ' if least else ''}{ratio:.3g}"
            found.append((one.law, _loss(one), by, ", ".join(shown)))
        return found

    def all_notes(self) -> list[str]:
        """The notes of all fits, those laws' names before them, and of the comparison."""
        several = len(self.fits) > 1
        own = [f"{f.law}: {n}" if several else n for f in self.fits for n in f.notes]
        return [
            *own,
            *self.notes,
            *(f"{law} was not fitted: {why}" for law, why in self.refused.items()),
        ]

    @property
    def _title(self) -> str:
        sizes = ", ".join(f"{t.shape[1]}x{t.shape[0]}" for t in self.targets)
        count = len(self.targets)
        return f"fitted to {count} image{'s' if count > 1 else ''} of {sizes} pixels"

    def __str__(self) -> str:
        rows = [_HEAD, *self.rows()]
        widths = [max(len(row[i]) for row in rows) for i in range(3)]
        lines = [
            "  ".join(f"{cell:{w}}" for cell, w in zip(row, [*widths, 0], strict=True))
            for row in rows
        ]
        return "\n".join([self._title, *(line.rstrip() for line in lines), *self.all_notes()])

    def _repr_html_(self) -> str:
        return html_table(self._title, _HEAD, self.rows(), self.all_notes())

    def __repr__(self) -> str:
        return f"Report({', '.join(map(repr, self.fits))})"

    def plot(self, view: int = 0) -> Figure:
        """The image, what each law makes of it, the differences, and how the searches went.

        Raises ``ImportError`` where matplotlib is missing.
        """
        from .plot import plot_report

        return plot_report(self, view)

    def to_dict(self) -> dict[str, Any]:
        """All numbers, for JSON: None stands for what is not finite."""
        return {
            "fits": [
                {
                    "law": one.law,
                    "transmittance": None if one.model is None else _plain(one.model),
                    "values": one.values,
                    "errors": {name: _finite(error) for name, error in one.errors.items()},
                    "covariance": one.covariance.tolist(),
                    "start": one.start,
                    "exposures": list(one.exposures),
                    "loss": one.loss,
                    "loss_error": one.loss_error,
                    "converged": one.converged,
                    "steps": [
                        {"spp": step.spp, "loss": step.loss, "loss_error": step.error}
                        for step in one.steps
                    ],
                    "derivatives": one.ways,
                    "notes": list(one.notes),
                }
                for one in self.fits
            ],
            "refused": self.refused,
            "notes": list(self.notes),
        }


def compared(fits: list[ImageFit]) -> list[str]:
    """What to know before preferring the first of some fits, which are sorted."""
    best, alike = fits[0], []
    for other in fits[1:]:
        if other.loss - best.loss < 2 * math.hypot(other.loss_error, best.loss_error):
            alike.append(other.law)
    if not alike:
        return []
    laws = f"{best.law} and {', '.join(alike)}"
    return [f"{laws} cannot be told apart: their losses differ by less than two standard errors."]


def _loss(one: ImageFit) -> str:
    return f"{one.loss:.3g} ± {one.loss_error:.1g}"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain(model: Transmittance) -> Mapping[str, Any]:
    return models.to_dict(model)
