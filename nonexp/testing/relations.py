"""Relations that hold between the functions of every law, in double precision.

References are numerical quadrature, differences and automatic differentiation, never a second
formula. Each function takes a law and raises :class:`.Fault`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

from ..system.machine import array_types
from ..transmittance import Transmittance
from .arrays import with_arrays
from .faults import Fault, percent

__all__ = [
    "area",
    "computes_with_arrays",
    "declared_jumps",
    "depths",
    "derivatives_by_parameters",
    "falls_and_is_convex",
    "floats_and_arrays",
    "fp_is_minus_the_slope_of_ff",
    "integrals",
    "nothing_but_numbers",
    "pp_is_minus_the_slope_of_pf",
    "reach",
    "reciprocity",
    "renewal",
    "slope",
]

_KERNELS = ("ff", "fp", "pf", "pp")


def reach(law: Transmittance) -> float:
    """Twenty mean flights: the optical depths in which most happens."""
    mean = 1 / law.sigma_bar if law.sigma_bar else 1.0
    return float(20 * mean)


def depths(law: Transmittance) -> Any:
    """Optical depths at which values are compared."""
    grid = np.concatenate([np.geomspace(1e-6, 1, 60), np.linspace(0.013, 1, 80)]) * reach(law)
    return np.sort(grid)


def slope(function: Callable[[Any], Any], tau: Any) -> Any:
    """The derivative of a law's function at float64 depths, by automatic differentiation."""
    x = array_types().Float64(tau)
    dr.enable_grad(x)
    y = function(x)
    if not dr.grad_enabled(y):
        return np.zeros(len(tau))
    dr.backward(y)
    return np.array(x.grad)


def area(law: Transmittance, function: Callable[[Any], Any], end: float) -> float:
    """Integral from 0 in pieces that get ever smaller towards 0 and, from the left, each kink."""
    kinks = np.array([float(kink) for kink in law.kinks if 0 < kink < end])
    graded = np.outer(kinks, 1 - 0.25 ** np.arange(1, 26)).ravel()
    ends = np.unique(np.concatenate([[0.0], end * 0.25 ** np.arange(40), kinks, graded]))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    half, middle = np.diff(ends)[:, None] / 2, (ends[1:] + ends[:-1])[:, None] / 2
    values = values_of(function, (middle + half * nodes).ravel())
    return float(np.sum(half * weights * values.reshape(-1, 40)))


def values_of(function: Callable[[Any], Any], tau: Any) -> Any:
    """A law's function in double precision at depths given as a NumPy array of one dimension."""
    return np.broadcast_to(np.array(function(array_types().Float64(tau)), dtype=float), len(tau))


def _away_from_kinks(law: Transmittance, tau: Any) -> Any:
    for where in law.kinks:
        tau = tau[np.abs(tau - where) > 1e-9 * where]
    return tau


def _close(a: Any, b: Any, relative: float, absolute: float = 1e-300) -> Any:
    return np.abs(a - b) <= relative * np.abs(b) + absolute


def _factor(found: Any, right: Any) -> float | None:
    """What a function is times too large, if that is the same wherever it is not tiny."""
    big = np.abs(right) > 1e-6 * np.max(np.abs(right), initial=0)
    ratio = found[big] / right[big]
    if not len(ratio) or not np.all(np.isfinite(ratio)):
        return None
    middle = float(np.median(ratio))
    return middle if np.all(np.abs(ratio - middle) <= 1e-6 * abs(middle)) else None


def _where(name: str, tau: Any, found: Any, right: Any, good: Any) -> str:
    with np.errstate(all="ignore"):
        error = np.where(good, 0, np.abs(found - right) / np.maximum(np.abs(right), 1e-12))
    worst = int(np.argmax(error))
    return f"{name}({tau[worst]:.4g}) is {found[worst]:.8g}, not {right[worst]:.8g}"


# --------------------------------------------------------------------- the functions


def computes_with_arrays(law: Transmittance) -> None:
    """ff, pf and pp take Python floats, float32 and float64 arrays, and keep the precision."""
    types = array_types()
    for name in ("ff", "pf", "pp"):
        for kind in (types.Float64, types.Float, float):
            try:
                value = getattr(law, name)(kind(0.3))
            except Exception as error:
                said = " ".join(str(error).split())
                what = "a float" if kind is float else "a Dr.Jit array"
                raise Fault(f"{name} fails on {what} with {type(error).__name__}: {said}") from None
            single = dr.is_array_v(value) and dr.type_v(value) == dr.VarType.Float32
            if kind is types.Float64 and single:
                raise Fault(
                    f"{name} of a float64 array is of single precision: does it select between two "
                    "numbers? nonexp.numerics.filled(tau, 1.0) is one of tau's precision"
                )


def falls_and_is_convex(law: Transmittance) -> None:
    """ff(0) = 1, 0 <= ff <= 1, ff never rises, and is convex."""
    tau = np.linspace(0, reach(law), 400)
    ff = values_of(law.ff, tau)
    if ff[0] != 1:
        raise Fault(f"ff does not start at 1: ff(0) is {ff[0]:.8g}")
    if not np.all((ff >= 0) & (ff <= 1)):
        i = int(np.argmin((ff >= 0) & (ff <= 1)))
        raise Fault(f"ff leaves [0, 1]: ff({tau[i]:.4g}) is {ff[i]:.8g}")
    if not np.all(np.diff(ff) <= 1e-15):
        i = int(np.argmax(np.diff(ff)))
        raise Fault(f"ff rises: from {ff[i]:.8g} at {tau[i]:.4g} to {ff[i + 1]:.8g}")
    if not np.all(np.diff(ff, 2) >= -1e-14):
        i = int(np.argmin(np.diff(ff, 2)))
        raise Fault(f"ff is not convex around {tau[i + 1]:.4g}: pp would be negative there")


def fp_is_minus_the_slope_of_ff(law: Transmittance) -> None:
    """fp = sigma_bar pf = -ff'; the parts of it, pf(0) = 1 and sigma_bar = -ff'(0), one by one."""
    tau = _away_from_kinks(law, depths(law))
    right, sigma_bar = -slope(law.ff, tau), float(law.sigma_bar)
    fp, pf, ff = (values_of(f, tau) for f in (law.fp, law.pf, law.ff))
    good = _close(right, fp, 1e-9)
    if np.all(good):
        return
    start = float(-slope(law.ff, np.zeros(1))[0])
    factor = _factor(fp, right)
    if not sigma_bar or factor is not None:
        at_zero = float(law.pf(0.0))
        if abs(at_zero - 1) > 1e-9:
            raise Fault(f"normalisation of pf: pf(0) is {at_zero:.8g}, not 1")
        ratio = f", {percent(sigma_bar / start)}" if start else ""
        raise Fault(f"sigma_bar is {sigma_bar:.8g}, but -ff'(0) is {start:.8g}{ratio}")
    if np.all(_close(pf, ff, 1e-9)):
        raise Fault(
            "pf equals ff: flights from a particle must have the transmittance -ff'/sigma_bar, "
            + _where("pf", tau, pf, right / sigma_bar, good)
        )
    raise Fault(
        "pf is not -ff'/sigma_bar: "
        + _where("pf", tau, pf, right / sigma_bar if sigma_bar else right, good)
    )


def reciprocity(law: Transmittance) -> None:
    """fp = sigma_bar pf, pf(0) = 1, and sigma_bar = -ff'(0)."""
    tau, sigma_bar = depths(law), float(law.sigma_bar)
    fp, right = values_of(law.fp, tau), sigma_bar * values_of(law.pf, tau)
    good = _close(fp, right, 1e-12)
    if not np.all(good):
        raise Fault(
            f"reciprocity: fp is not sigma_bar pf: {_where('fp', tau, fp, right, good)} "
            f"(sigma_bar is {sigma_bar:.8g})"
        )
    if float(law.pf(0.0)) != 1:
        raise Fault(f"normalisation of pf: pf(0) is {float(law.pf(0.0)):.8g}, not 1")
    start = float(-slope(law.ff, np.zeros(1))[0])
    if not _close(start, sigma_bar, 1e-9, 0):
        ratio = f", {percent(sigma_bar / start)}" if start else ""
        raise Fault(f"sigma_bar is {sigma_bar:.8g}, but -ff'(0) is {start:.8g}{ratio}")


def pp_is_minus_the_slope_of_pf(law: Transmittance) -> None:
    """pp = -pf' away from kinks; 0 where nothing collides."""
    tau = _away_from_kinks(law, depths(law))
    pp = values_of(law.pp, tau)
    if not law.sigma_bar:
        if not np.all(pp == 0):
            raise Fault("pp is not 0, although sigma_bar is: nothing collides")
        return
    right = -slope(law.pf, tau)
    good = _close(right, pp, 1e-9)
    if np.all(good):
        return
    for name in ("fp", "pf", "ff"):
        if np.all(_close(values_of(getattr(law, name), tau), pp, 1e-9)):
            raise Fault(f"pp equals {name}: it must be the density of pf, -pf'")
    factor = _factor(pp, right)
    if factor is not None:
        raise Fault(f"normalisation of pp: it is {percent(factor)} everywhere, beside -pf'")
    raise Fault("pp is not -pf': " + _where("pp", tau, pp, right, good))


def declared_jumps(law: Transmittance) -> None:
    """Derivatives rely on ``jumps``: at each kink pp jumps as they say, and there are no atoms."""
    if law.jumps is None:
        return
    if law.atoms:
        raise Fault("jumps are declared, but there are atoms: derivatives would be biased")
    heights: dict[float, float] = dict.fromkeys(map(float, law.kinks), 0.0)
    for where, height in law.jumps:
        where = float(where)
        heights[where] = heights.get(where, 0.0) + float(height)
    tau = np.array(sorted(where for where in heights if where > 0))
    if not len(tau):
        return
    told = np.array([heights[where] for where in tau])
    before, beyond = (values_of(law.pp, tau * (1 + side * 1e-9)) for side in (-1, 1))
    found = beyond - before
    size = np.abs(before) + np.abs(beyond) + np.abs(told) + 1e-6 * float(law.sigma_bar)
    good = np.abs(found - told) <= 1e-6 * size
    if not np.all(good):
        i = int(np.argmin(good))
        raise Fault(f"pp jumps by {found[i]:.6g} at {tau[i]:.6g}, but jumps say {told[i]:.6g}")


def integrals(law: Transmittance) -> None:
    """fp integrates to 1 - ff, and pp with the atoms to 1 - pf, over twenty mean flights."""
    if not law.sigma_bar:
        return
    end = reach(law)
    for name, survival in (("fp", "ff"), ("pp", "pf")):
        density = getattr(law, name)
        atoms = sum(float(p) for where, p in law.atoms if where <= end and name == "pp")
        expected = 1 - float(getattr(law, survival)(end))
        found = area(law, density, end) + atoms
        if abs(found - expected) > 1e-8:
            held = f", {atoms:.6g} of it in atoms" if name == "pp" and law.atoms else ""
            missing = "" if held else "; is an atom or a kink not declared?"
            raise Fault(
                f"normalisation of {name}: its integral up to {end:.4g} is {found:.8g}{held}, "
                f"not 1 - {survival} = {expected:.8g}{missing}"
            )


def renewal(law: Transmittance) -> None:
    """A first flight is a random part of a length-biased flight: 1 - ff = sigma_bar times the
    integral of pf."""
    if not law.sigma_bar:
        return
    for flights in (0.1, 0.7, 3.0):
        end = float(flights / law.sigma_bar)
        found = float(law.sigma_bar) * area(law, law.pf, end)
        expected = 1 - float(law.ff(end))
        if abs(found - expected) > 1e-9:
            raise Fault(
                f"renewal: sigma_bar times the integral of pf up to {end:.4g} is {found:.8g}, "
                f"not 1 - ff = {expected:.8g}"
            )


# --------------------------------------------------------------------- numbers


def floats_and_arrays(law: Transmittance) -> None:
    """Python floats, float64 and float32 arrays give the same values."""
    types = array_types()
    for tau in (0.0, 1e-8, 0.3, 1.0, 7.0, 1e8):
        for name in _KERNELS:
            function = getattr(law, name)
            one = float(function(tau))
            wide = float(values_of(function, np.array([tau]))[0])
            narrow = float(np.ravel(np.array(function(types.Float(tau)), dtype=float))[0])
            if not _close(wide, one, 1e-12):
                raise Fault(f"{name}({tau:g}) is {one!r} of a float, {wide!r} of an array")
            if not _close(narrow, one, 3e-5, 1e-37):
                raise Fault(f"{name}({tau:g}) is {one!r} of a float, {narrow!r} in float32")


def nothing_but_numbers(law: Transmittance, kernels: tuple[str, ...] = _KERNELS) -> None:
    """No NaN, nothing infinite or negative, in float32 from 0 to infinity."""
    tau = [0, 1e-38, 1e-8, 1, 1e8, 1e30, 3e38, dr.inf]
    for name in kernels:
        found = np.array(getattr(law, name)(array_types().Float(tau)), dtype=float)
        found = np.broadcast_to(found, len(tau))
        good = np.isfinite(found) & (found >= 0)
        if not np.all(good):
            i = int(np.argmin(good))
            raise Fault(f"{name}({tau[i]:g}) is {found[i]} in single precision")


# --------------------------------------------------------------------- parameters


def derivatives_by_parameters(law: Transmittance) -> None:
    """By every number, item of a vector and parameter of a component that has derivatives:
    automatic differentiation against differences."""
    kind = array_types().Float64

    def attached(value: float) -> Any:
        array = kind(value)
        dr.enable_grad(array)
        return array

    narrow, leaves = with_arrays(law, kind)
    tau = np.array([0.11, 0.53, 2.7])
    for kink in narrow.kinks:
        tau = tau[np.abs(tau - float(dr.slice(kink))) > 1e-3 * tau]
    for path, leaf in leaves.items():
        step = 1e-4 * (abs(leaf[0]) or 1.0)

        def shifted(shift: float, path: str = path) -> Transmittance:
            return with_arrays(law, kind, {path: shift})[0]

        made = []
        for name in ("ff", "pf", "pp"):
            model, parameters = with_arrays(law, attached)
            dr.set_grad(parameters[path], 1)
            y = getattr(model, name)(kind(tau))
            attached_to = dr.is_array_v(y) and dr.grad_enabled(y)
            made.append(np.array(dr.forward_to(y)) if attached_to else np.zeros(len(tau)))
        gradient = np.array([np.broadcast_to(g, (len(tau),)) for g in made])

        at = kind(tau)
        try:
            low, high = _kernels(shifted(-step), at), _kernels(shifted(step), at)
            difference = (high - low) / (2 * step)
        except ValueError:  # at the end of its range: from inside
            ends = [shifted(k * step) for k in range(4)]
            jump = abs(float(dr.slice(ends[1].sigma_bar)) - float(dr.slice(ends[0].sigma_bar)))
            if jump > 0.01:
                continue  # derivatives leave it out
            values = [_kernels(model, at) for model in ends]
            weights = np.array([-11, 18, -9, 2]) / 6
            difference = sum(w * v for w, v in zip(weights, values, strict=True)) / step
        # Differences lose what rounding puts into the values: 1e-16/step.
        good = _close(gradient, difference, 1e-6, 2e-15 / step)
        if not np.all(good):
            row, column = np.unravel_index(int(np.argmin(good)), good.shape)
            raise Fault(
                f"derivative of {('ff', 'pf', 'pp')[row]} by {path}: at {tau[column]:g} it is "
                f"{gradient[row, column]:.8g}, differences say {difference[row, column]:.8g}"
            )


def _kernels(law: Transmittance, tau: Any) -> Any:
    """ff, pf and pp as one array of shape (3, n)."""
    values = [getattr(law, name)(tau) for name in ("ff", "pf", "pp")]
    return np.array([np.broadcast_to(np.array(v, dtype=float), (len(tau),)) for v in values])
