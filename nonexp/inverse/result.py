"""One law, fitted to images."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from .. import models
from ..transmittance import Transmittance
from ..transmittance.shown import signed, with_error
from .laws import Place
from .search import Step
from .unknowns import Unknown, write
from .views import Array

__all__ = ["ImageFit"]


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

    @property
    def shown_loss(self) -> str:
        """The loss and its error, as text."""
        return f"{self.loss:.3g} ± {self.loss_error:.1g}"

    def to_dict(self) -> dict[str, Any]:
        """All numbers, for JSON: None stands for an error that is not finite."""
        return {
            "law": self.law,
            "transmittance": None if self.model is None else models.to_dict(self.model),
            "values": self.values,
            "errors": {n: e if math.isfinite(e) else None for n, e in self.errors.items()},
            "covariance": self.covariance.tolist(),
            "start": self.start,
            "exposures": list(self.exposures),
            "loss": self.loss,
            "loss_error": self.loss_error,
            "converged": self.converged,
            "steps": [{"spp": s.spp, "loss": s.loss, "loss_error": s.error} for s in self.steps],
            "derivatives": self.ways,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        lines = [f"{self.law}: loss {self.shown_loss} after {len(self.steps) - 1} steps"]
        rows = self.rows()
        widths = [max(len(row[i]) for row in rows) for i in (0, 1)]
        for name, value, error in rows:
            lines.append(f"  {name:{widths[0]}}  {value:>{widths[1]}} {signed(error)}".rstrip())
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={value} {signed(error)}" for name, value, error in self.rows())
        return f"ImageFit({self.law}: {shown}, loss={self.shown_loss})"
