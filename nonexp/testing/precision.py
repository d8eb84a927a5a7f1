"""A law in single precision beside the same formulas in double precision, over 16 decades.

Relative errors are in units of 1 + |ln value|, the condition of an exponential. What cancels in
single precision (``1 - tanh(tau)**2``, ``log(1 + tau)``) shows here; a formula that is wrong in
both does not.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..system.machine import array_types
from ..transmittance import Transmittance
from .arrays import with_arrays
from .faults import Fault

__all__ = ["BAR", "SLOPES", "far_slopes", "slopes", "values"]

BAR = 1e-5
"""Relative error allowed, in units of 1 + |ln value|; the laws of nonexp keep 2e-6."""

SLOPES = 1e-3
"""Relative error allowed in derivatives."""

_TINY = 1e-30


def _both(law: Transmittance) -> tuple[Transmittance, Transmittance]:
    """The law with parameters of float32, and computed with in float64."""
    types = array_types()
    return with_arrays(law, types.Float)[0], with_arrays(law, types.Float64)[0]


def _depths(law: Transmittance, count: int) -> Any:
    """Log-spaced depths and those around a mean flight, as float32; none on a kink."""
    flight = 1 / float(law.sigma_bar) if law.sigma_bar else 1.0
    grids = [np.geomspace(1e-8, 1e8, count), np.geomspace(1e-3, 1e2, count // 2) * flight]
    tau = np.unique(np.concatenate(grids).astype(np.float32))
    for kink in law.kinks:
        tau = tau[np.abs(tau - float(kink)) > 1e-6 * float(kink)]
    return tau


def _values(law: Transmittance, name: str, tau: Any) -> Any:
    return np.broadcast_to(np.array(getattr(law, name)(tau), dtype=float), len(tau))


def values(law: Transmittance) -> None:
    """ff, pf and pp at 180 depths: within :data:`BAR`, finite, and at most 1 for ff and pf."""
    narrow, wide = _both(law)
    types, tau = array_types(), _depths(law, 120)
    for name in ("ff", "pf", "pp"):
        got = _values(narrow, name, types.Float(tau))
        right = _values(wide, name, types.Float64(tau))
        if not np.all(np.isfinite(got)):
            i = int(np.argmin(np.isfinite(got)))
            raise Fault(f"{name}({tau[i]:.4g}) is {got[i]} in single precision")
        if name != "pp" and np.any(got > 1):
            i = int(np.argmax(got))
            raise Fault(f"{name}({tau[i]:.4g}) is {got[i]!r} > 1 in single precision")
        with np.errstate(all="ignore"):
            error = np.abs(got - right) / (right * (1 + np.abs(np.log(right))))
        error = np.where(right > _TINY, error, 0)
        i = int(np.argmax(error))
        if error[i] > BAR:
            with np.errstate(all="ignore"):
                off = abs(got[i] / right[i] - 1)
            raise Fault(
                f"rounding of {name}: {name}({tau[i]:.4g}) is {got[i]:.6g} in single precision and "
                f"{right[i]:.6g} in double, off by {off:.1g}: does a difference cancel?"
            )


def slopes(law: Transmittance) -> None:
    """Derivatives of ff, pf and pp by tau in single precision, of laws that declare no jumps."""
    if law.jumps != ():
        return
    narrow, wide = _both(law)
    types, tau = array_types(), _depths(law, 24)
    for name in ("ff", "pf", "pp"):
        found = []
        for one, kind in ((narrow, types.Float), (wide, types.Float64)):
            x = kind(tau)
            dr.enable_grad(x)
            y = getattr(one, name)(x)
            if not dr.grad_enabled(y):
                found.append(np.zeros(len(tau)))
                continue
            dr.backward(y)
            found.append(np.array(x.grad, dtype=float))
        got, right = found
        if not np.all(np.isfinite(got)):
            i = int(np.argmin(np.isfinite(got)))
            raise Fault(f"derivative of {name} by tau at {tau[i]:.4g} is {got[i]}")
        value = _values(wide, name, types.Float64(tau))
        slack = 1e-5 * value / np.maximum(tau, 1e-8) + _TINY
        good = np.abs(got - right) <= SLOPES * np.abs(right) + slack
        if not np.all(good | (value < _TINY)):
            i = int(np.argmin(good | (value < _TINY)))
            raise Fault(
                f"derivative of {name} by tau: at {tau[i]:.4g} it is {got[i]:.6g} in single "
                f"precision and {right[i]:.6g} in double"
            )


def far_slopes(law: Transmittance) -> None:
    """Derivatives at depth 1e20 are finite, of laws that declare no jumps."""
    if law.jumps != ():
        return
    for name in ("ff", "pf", "pp"):
        x = array_types().Float([1e20])
        dr.enable_grad(x)
        y = getattr(_both(law)[0], name)(x)
        if dr.grad_enabled(y):
            dr.backward(y)
            if not np.all(np.isfinite(np.array(x.grad))):
                raise Fault(f"derivative of {name} by tau at 1e20 is {np.array(x.grad)[0]}")
