"""On which parameters the suite runs the models: their examples, and the ends of their ranges."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from build import MODELS, model_id
from tiers import quick

from nonexp import models

Case = tuple[str, dict[str, Any]]


def _grid(**ranges: tuple[Any, ...]) -> list[dict[str, Any]]:
    """Every combination of the values."""
    combined: list[dict[str, Any]] = [{}]
    for name, values in ranges.items():
        combined = [{**given, name: value} for given in combined for value in values]
    return combined


def steep(tau: Any) -> Any:
    return dr.exp(-1e4 * tau)


def heavy(tau: Any) -> Any:
    return dr.rsqrt(1 + 2 * tau)


def straight(tau: Any) -> Any:
    return dr.maximum(1 - 3 * tau, 0)


def partly_clear(tau: Any) -> Any:
    return 0.25 + 0.75 * dr.exp(-tau / 0.75)


UNEVEN = {"sigma": (1e4, 1e-4, 0.3), "weight": (1.0, 1e4, 1e-3)}


def _mixtures() -> list[dict[str, Any]]:
    def make(key: str, **parameters: Any) -> Any:
        return models.create(key, **parameters)

    steep_and_flat = (make("linear", b=1e-3), make("gamma", alpha=0.1))
    nested = models.registry["mixture"](models=steep_and_flat, weight=(1.0, 3.0))
    blend = make("mixture", models=(make("exponential"), make("linear", b=2.0)), weight=(1.0, 3.0))
    wide = make("exponential_mixture", sigma=(1e-4, 1.0, 1e4))
    three = (make("gamma", alpha=0.5), make("quadratic", b=3.0), wide)
    inner = make("mixture", models=three, weight=(1.0, 3.0, 2.0))
    return [
        {"models": blend.models, "weight": blend.weight},
        {"models": (inner, make("linear", b=0.7), blend, make("constant"))},
        {
            "models": (make("exponential_mixture", **UNEVEN), make("gamma", alpha=1e4)),
            "weight": (1e-3, 1e3),
        },
        {"models": (make("gamma", alpha=1e-2), make("gamma", alpha=1e4)), "weight": (1e-4, 1.0)},
        {"models": (nested, make("quadratic", b=30.0)), "weight": (1.0, 1e-3)},
        {
            "models": (make("constant"), nested, make("linear", b=1e4), make("exponential")),
            "weight": (0.1, 1.0, 10.0, 0.0),
        },
        {"models": (make("constant"), make("linear", b=1.0)), "weight": (1e6, 1.0)},
    ]


EXTREMES: dict[str, list[dict[str, Any]]] = {
    "constant": [],
    "exponential": [],
    "linear": _grid(b=(1e-4, 1e6)),
    "quadratic": _grid(b=(1e-4, 1e6)),
    "gamma": _grid(alpha=(1e-3, 0.03, 1e2, 1e4, 1e6)),
    "power": [
        {"n": 1.0},
        {"n": 1.001},
        {"n": 1.5},
        {"n": 100.0},
        {"n": 1e4},
        {"n": 1e4, "b": 1e-2},
        {"n": 3.0, "b": 1e6},
        {"n": 1.0, "b": 0.7},
        {"n": 1 + 2**-23},
        {"n": 1.3, "b": 0.01},
        {"n": 2.0, "b": 1e3},
        {"n": 2.5},
        {"n": 1e6},
        {"n": 1e6, "b": 1e3},
    ],
    "erlang": [
        {"k": 1},
        {"k": 3},
        {"k": 16},
        {"k": 64},
        {"k": 64, "rate": 1e-3},
        {"k": 64, "rate": 1e4},
        {"k": 3, "rate": 1e-3},
        {"k": 5, "rate": 1e4},
        {"k": 6, "rate": 200.0},
        {"k": 17, "rate": 0.1},
    ],
    "exponential_mixture": [
        {"sigma": (1e-4, 1e-2, 1.0, 1e2, 1e4), "weight": (1.0, 1.0, 1.0, 1.0, 1.0)},
        {"sigma": (1e-4, 1e4), "weight": (1.0, 1e-6)},
        {"sigma": (0.0, 3.0), "weight": (0.25, 0.75)},
        {"sigma": (0.3,), "weight": (7.0,)},
        UNEVEN,
        {"sigma": tuple(10 ** (k / 2 - 4) for k in range(17))},
    ],
    "davis_weinstein": [
        *_grid(h=(0.5, 0.501, 0.75, 0.999, 1.0), c=(1e-2, 1.0, 1e2)),
        *_grid(h=(0.5, 0.75, 1.0), c=(1e-3, 1e3)),
        *_grid(h=(0.6,), c=(0.1, 1e3)),
        *_grid(h=(0.99,), c=(0.03, 10.0)),
        {"h": 0.5 + 2**-24, "c": 2.0},
        {"h": 0.501, "c": 1e-3},
    ],
    "hard_rod": [
        {"d": 0.0, "l": 1.0},
        {"d": 1e-6, "l": 1.0},
        {"d": 1.0, "l": 1e-6},
        {"d": 0.5, "l": 1e-6},
        {"d": 1e4, "l": 3e-3},
        {"d": 1e-4, "l": 1e5},
        {"d": 0.0, "l": 1e-6},
        {"d": 1.0, "l": 1e-2},
        {"d": 1e-3, "l": 2.0},
        {"d": 0.3, "l": 7.7},
        {"d": 1e-8, "l": 1e-8},
    ],
    "pulse": [
        {"n": 1},
        {"n": 2, "a": 0.9, "b": 1.1},
        {"n": 1000},
        {"n": 7, "a": 1e-4, "b": 1e4},
        {"n": 100, "a": 9.0, "b": 11.0},
        {"n": 1, "a": 0.3, "b": 1.9},
        {"n": 3, "a": 100.0, "b": 1000.0},
        {"n": 7, "a": 0.3, "b": 1.9},
        {"n": 41, "a": 0.3, "b": 1.9},
        {"n": 300, "a": 1e-4, "b": 1e-3},
    ],
    "ensemble": [
        {"law": "gamma", "args": (0.01, 0.0, 100.0)},
        {"law": "gamma", "args": (1e3, 0.0, 1e-3)},
        {"law": "gamma", "args": (0.5, 0.1, 10.0)},
        {"law": "lognorm", "args": (2.0, 0.0, 0.1)},
        {"law": "lognorm", "args": (0.01, 0.0, 1.0)},
        {"law": "uniform", "args": (0.0, 2.0)},
        {"law": "uniform", "args": (1e3, 1e-2)},
        {"law": "beta", "args": (0.05, 0.05, 0.0, 2.0)},
        {"law": "poisson", "args": (1.5,)},
        {"sigma": (1e-4, 1e-2, 1.0, 1e2, 1e4), "weight": (1.0, 1.0, 1.0, 1.0, 1.0)},
        {"sigma": (0.0, 1e4), "weight": (1.0, 1e-3)},
        {"sigma": (7.0,)},
    ],
    "tabulated": [
        {"tau": (1e-6, 1.0, 1e6), "ff": (0.999, 0.3, 1e-5)},
        {"tau": (0.0, 1e-4), "ff": (1.0, 0.0)},
        {"tau": (0.0, 1.0, 2.0, 3.0), "ff": (1.0, 0.5, 0.25, 0.25)},
        {
            "tau": tuple(map(float, np.geomspace(1e-5, 1e4, 300))),
            "ff": tuple(map(float, (1 + 20 * np.geomspace(1e-5, 1e4, 300)) ** -0.05)),
        },
    ],
    "custom": [
        {"ff": f"{__name__}:{name}"} for name in ("steep", "heavy", "straight", "partly_clear")
    ],
    "mixture": _mixtures() if "mixture" in models.registry else [],
}
"""The ends of the ranges of every model's parameters, by key; empty only where there are none."""


def _cases() -> list[Case]:
    extremes = [(key, p) for key in models.names() for p in EXTREMES.get(key, [])]
    return [*MODELS, *extremes]


CASES: list[Case] = _cases()
"""Examples and extremes of every model: (key, parameters)."""

KERNELS = ("ff", "fp", "pf", "pp")


def case_id(case: Case) -> str:
    return model_id(case)


def _first_of_both() -> set[int]:
    firsts: dict[Any, int] = {}
    for position, (key, _) in enumerate(CASES):
        firsts.setdefault((key, position < len(MODELS)), position)
    return set(firsts.values())


QUICK = _first_of_both()
"""Positions in CASES of every model's first example and first extreme: the quick ones."""

POSITIONS = quick(range(len(CASES)), QUICK.__contains__)

every_case = pytest.mark.parametrize("position", POSITIONS, ids=map(case_id, CASES))
