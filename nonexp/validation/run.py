"""All studies, one after the other, and what to make of their rows."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from scipy import stats

from . import (
    adams_1989_jqsrt,
    brantley_2011_jqsrt,
    davis_2014_jctt,
    deon_2018_jctt,
    ho_2024_joss,
    prahl_2023_pypi,
    vu_2021,
)
from .study import Effort, Row

__all__ = ["STUDIES", "Summary", "agrees", "limit", "measure", "summary", "titles"]

STUDIES: dict[str, ModuleType] = {
    module.__name__.rpartition(".")[2]: module
    for module in (
        adams_1989_jqsrt,
        brantley_2011_jqsrt,
        vu_2021,
        ho_2024_joss,
        prahl_2023_pypi,
        deon_2018_jctt,
        davis_2014_jctt,
    )
}
"""The studies by the names of their folders."""

FALSE_ALARM = 1e-3
"""Chance that some row deviates although nothing is wrong."""


@dataclass(frozen=True)
class Summary:
    """All rows of a study taken together."""

    rows: int
    chi2: float
    """mean of the squared deviations: about 1"""
    relative: float
    """mean relative difference, weighted by its precision"""
    error: float
    """its standard error"""
    worst: float
    """largest deviation, in standard errors"""


def measure(study: str, effort: Effort) -> Iterator[Row]:
    """The rows of a study, as they come; a Mitsuba variant must be set."""
    yield from STUDIES[study].measure(effort)


def titles(study: str) -> tuple[str, str]:
    """What a study compares, and with what."""
    return STUDIES[study].TITLE, STUDIES[study].SOURCE


def limit(rows: int) -> float:
    """Deviation, in standard errors, that one of so many rows exceeds by chance in 1 of 1000."""
    return float(stats.norm.isf(FALSE_ALARM / 2 / max(rows, 1)))


def agrees(row: Row, rows: int) -> bool:
    """Whether a row, one of so many, is within its error."""
    return abs(row.deviation) <= limit(rows)


def summary(rows: Iterable[Row]) -> Summary:
    """All rows of a study taken together."""
    found = list(rows)
    value = np.array([row.quantity.value for row in found])
    difference = np.array([row.ours for row in found]) / value - 1
    error = np.array([math.hypot(row.error, row.quantity.error) for row in found]) / value
    weight = 1 / error**2
    deviation = difference / error
    return Summary(
        rows=len(found),
        chi2=float(np.mean(deviation**2)),
        relative=float(np.sum(weight * difference) / np.sum(weight)),
        error=float(np.sum(weight) ** -0.5),
        worst=float(np.max(np.abs(deviation))),
    )
