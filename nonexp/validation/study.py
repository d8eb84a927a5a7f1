"""What a study consists of: published quantities, our results, and how precise they shall be."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

__all__ = ["FULL", "QUICK", "Effort", "Quantity", "Row", "estimate", "numbers", "row", "seed_of"]


@dataclass(frozen=True)
class Quantity:
    """A published number."""

    name: str
    value: float
    error: float
    """its standard error; half a unit of the last digit where only rounding is known"""
    where: str
    """where it stands"""


@dataclass(frozen=True)
class Row:
    """A published number beside ours."""

    study: str
    quantity: Quantity
    ours: float
    error: float
    """standard error of ours; 0 for quadrature"""

    @property
    def deviation(self) -> float:
        """Difference in standard errors of both."""
        error = math.hypot(self.error, self.quantity.error)
        difference = self.ours - self.quantity.value
        return difference / error if error else math.copysign(math.inf, difference)


@dataclass(frozen=True)
class Effort:
    """How precise results shall be.

    ``relative`` is the standard error wanted, as a fraction of a result (of 0.05, for results below
    that); a result takes up to ``batches`` batches of ``count`` paths. ``quick`` leaves out cases.
    """

    relative: float
    batches: int
    count: int
    quick: bool = False

    @staticmethod
    def to(relative: float) -> Effort:
        """All cases, to that error; what is small keeps a larger one."""
        batches = 8 * max(1.0, (_USUAL / relative) ** 2)
        return Effort(relative, math.ceil(batches), 2**18)


_USUAL = 2e-3

QUICK = Effort(1e-2, 4, 2**16, quick=True)
FULL = Effort.to(_USUAL)


def numbers(package: str | None) -> dict[str, Quantity]:
    """The quantities in ``numbers.csv`` of a study's package, by name."""
    assert package is not None
    text = (files(package) / "numbers.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    found = {}
    for given in rows:
        value, error = float(given["value"]), float(given["error"])
        found[given["name"]] = Quantity(given["name"], value, error, given["where"])
    return found


def row(package: str | None, quantity: Quantity, ours: float, error: float = 0.0) -> Row:
    """A row of the study of that package."""
    return Row(str(package).rpartition(".")[2], quantity, float(ours), float(error))


def estimate(
    case: str, run: Callable[[int], Mapping[str, Any]], effort: Effort
) -> dict[str, tuple[float, float]]:
    """Means and standard errors by name, of as many batches as the effort asks for.

    No two cases share random numbers, so that their deviations are independent.

    ``run`` returns samples by name for a seed. It is that of every result.
    """
    sums: dict[str, Any] = {}
    for batch in range(effort.batches):
        for name, samples in run(seed_of(case, batch)).items():
            part = np.array([np.size(samples), np.sum(samples), np.sum(np.square(samples))])
            sums[name] = sums.get(name, 0) + part
        found = {name: _mean(*total) for name, total in sums.items()}
        if all(error <= effort.relative * max(abs(m), 0.05) for m, error in found.values()):
            break
    return found


def seed_of(case: str, batch: int) -> int:
    """The seed (32 bits) of a batch of a case."""
    digest = hashlib.blake2b(f"{case} {batch}".encode(), digest_size=4).digest()
    return int.from_bytes(digest, "little")


def _mean(count: float, total: float, squares: float) -> tuple[float, float]:
    mean = total / count
    variance = max(squares / count - mean**2, 0.0)
    # Rounding of single precision along paths.
    return float(mean), math.hypot(math.sqrt(variance / (count - 1)), 1e-6 * mean)
