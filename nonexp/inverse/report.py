"""What a fit to images found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..transmittance.shown import html_table, signed
from .result import ImageFit
from .views import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Report", "compared"]

_HEAD = ("law", "loss", "by the best", "parameters")


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
            by = (
                ""
                if one is self.best or (least and ratio < 1)
                else f"{'> ' if least else ''}{ratio:.3g}"
            )
            found.append((one.law, one.shown_loss, by, ", ".join(shown)))
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

        return plot_report(self.fits, self.targets[view], view)

    def to_dict(self) -> dict[str, Any]:
        """All numbers, for JSON: None stands for what is not finite."""
        return {
            "fits": [one.to_dict() for one in self.fits],
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
