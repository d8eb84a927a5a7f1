"""Values of the models in Dr.Jit's arithmetic beside those of the references."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
from drjit.llvm.ad import Float, Float64
from stability_cases import CASES
from stability_reference import Law, exact, mp, reference

from nonexp import models
from nonexp.testing.arrays import with_arrays

BAR = 2e-6
"""Relative error allowed in float32, in units of 1 + |ln value|."""

MOST_KINKS = 12
"""Kinks near which a law is tested; of more of them, some from first to last."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """One kernel of one model at ``tau``.

    ``error`` is relative, in units of 1 + |ln exact|, and 0 where the exact value is below 1e-30.
    """

    tau: Any
    got: Any
    exact: Any
    error: Any


def some(items: Any, most: int = MOST_KINKS) -> list[Any]:
    """At most so many of the items, evenly chosen, with the first and the last."""
    if len(items) <= most:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, most).round().astype(int)]


def steps_around(tau: Any, most: int = 4) -> Any:
    """The float32 nearest to ``tau`` and its neighbours up to ``most`` steps away."""
    start = np.float32(float(tau))
    below = [start]
    above = [start]
    for _ in range(most):
        below.append(np.nextafter(below[-1], np.float32(0)))
        above.append(np.nextafter(above[-1], np.float32(np.inf)))
    return np.array([*below[:0:-1], *above], dtype=np.float32)


def depths(law: Law, count: int) -> Any:
    """``count`` points over 16 decades, half as many around a mean flight, and all kinks'."""
    flight = 1 / float(law.sigma_bar) if law.sigma_bar else 1.0
    grids = [np.geomspace(1e-8, 1e8, count), np.geomspace(1e-3, 1e2, count // 2) * flight]
    near = [steps_around(kink) for kink in some(law.kinks)]
    tau = np.unique(np.concatenate([*grids, *near]).astype(np.float32))
    return tau[(tau > 0) & (tau < np.inf)]


@functools.cache
def narrow(position: int) -> tuple[Any, Law]:
    """Model of the case at that position with parameters of float32, and its reference."""
    key, parameters = CASES[position]
    model, _ = with_arrays(models.create(key, **parameters), Float)
    return model, reference(model)


@functools.cache
def wide(position: int) -> tuple[Any, Law]:
    """The same parameters, held and computed with in float64."""
    key, parameters = CASES[position]
    model, _ = with_arrays(models.create(key, **parameters), Float64)
    return model, reference(model)


def compare(position: int, kernel: str, count: int, kind: Any = Float) -> Comparison:
    """The kernel of a case in float32 or float64 against its reference."""
    model, law = (narrow if kind is Float else wide)(position)
    tau = depths(law, count) if kind is Float else np.geomspace(1e-8, 1e8, count)
    got = np.broadcast_to(np.array(getattr(model, kernel)(kind(tau)), dtype=float), tau.shape)

    function, jumps = getattr(law, kernel), {float(kink) for kink in law.kinks}
    values = np.array([float(function(exact(t))) for t in tau])
    if kernel == "pp":  # a density that jumps has no value there: either will do
        for i, t in enumerate(tau):
            if float(t) in jumps:
                before = float(function(exact(t) * (1 - mp.mpf(10) ** -30)))
                if abs(got[i] - before) < abs(got[i] - values[i]):
                    values[i] = before
    with np.errstate(all="ignore"):
        error = np.abs(got - values) / (values * (1 + np.abs(np.log(values))))
    return Comparison(tau, got, values, np.where(values > 1e-30, error, 0))
