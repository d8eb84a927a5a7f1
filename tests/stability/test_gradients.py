"""Derivatives by automatic differentiation in float32 against differences in 60-digit arithmetic.

Of ff, pf, pp and the logarithms of the last two, by tau and by every parameter of every model that
has derivatives, also those of its components. The bar is 1e-4 |derivative| + 1e-6 |value/parameter|
(for a parameter that is 0, 1e-6 of the largest value at any depth, over a mean flight below 1); the
second part is the rounding of values. At a kink the derivative from either side will do.
"""

from __future__ import annotations

import functools
import itertools
from typing import Any

import drjit as dr
import numpy as np
import pytest
from drjit.llvm.ad import Float
from stability_cases import CASES, every_case
from stability_reference import exact, mp, reference
from stability_values import some, steps_around

from nonexp import models
from nonexp.testing.arrays import with_arrays

BAR = 1e-4
SLACK = 1e-6
UNDERFLOW = 1e-32
"""Derivatives are not compared more closely than this: powers in them leave float32."""

KERNELS = ("ff", "pf", "pp")

UNLESS_MASKED = {"gamma", "hard_rod", "mixture"}
"""Models whose derivatives by a parameter are NaN, 0 times infinity, where depths overflow."""
WITHOUT_PARAMETERS: dict[int, Any] = {}
"""Models, some slow to make, that no gradient ties to one test."""


def attached(value: float) -> Any:
    array = Float(value)
    dr.enable_grad(array)
    return array


def make(position: int) -> tuple[Any, dict[str, Any]]:
    """The model of a case and its parameters, which have gradients."""
    key, parameters = CASES[position]
    if position not in WITHOUT_PARAMETERS:
        model, leaves = with_arrays(models.create(key, **parameters), attached)
        if leaves:
            return model, leaves
        WITHOUT_PARAMETERS[position] = model
    return WITHOUT_PARAMETERS[position], {}


def depths(law: Any, count: int) -> Any:
    flight = 1 / float(law.sigma_bar) if law.sigma_bar else 1.0
    grid = [[0, 1e-8, 1e8], np.geomspace(1e-8, 1e8, count), flight * np.geomspace(0.03, 10, count)]
    near = [steps_around(kink) for kink in some(law.kinks, 3)]
    return np.unique(np.concatenate([*grid, *near]).astype(np.float32))


def logarithm(value: Any) -> Any:
    """ln value where it is not tiny, without poison where it is."""
    tall = value > 1e-30
    return dr.select(tall, dr.log(dr.select(tall, value, 1)), 0)


def forward(y: Any, count: int) -> Any:
    """d y / d what has a gradient set, in each lane; 0 where y does not depend on it."""
    if not (dr.is_array_v(y) and dr.grad_enabled(y)):
        return np.zeros(count)
    return np.broadcast_to(np.array(dr.forward_to(y), dtype=float), (count,))


def one_sided(function: Any, h: Any) -> Any:
    """Derivative of function(shift) at 0 from the side of h, never evaluated at 0."""
    first, second, third = function(h), function(2 * h), function(3 * h)
    return (-5 * first + 8 * second - 3 * third) / (2 * h)


def assert_derivatives(
    law: Any, tau: Any, value: Any, got: Any, exact_slope: Any, scale: Any, label: str
) -> None:
    """``got`` are derivatives of ``value`` at ``tau`` by a variable of size ``scale``.

    ``exact_slope(t, side)`` is the derivative from the side of 1 or -1; either will do.
    Where the value is tiny, or the law singular, any finite number will do.
    """
    finite = np.isfinite(got)
    assert np.all(finite), f"{label} is {got[~finite]} at {tau[~finite]}"
    kinks = np.array([float(kink) for kink in law.kinks])
    for i in np.flatnonzero((value > 1e-30) & ((tau > 0) | (not law.singular))):
        t = exact(tau[i])
        places = [t]
        if len(kinks) and np.min(np.abs(kinks - tau[i])) < 1e-6 * tau[i]:
            places += [t * mp.mpf(factor) for factor in (1 - 1e-6, 1 + 1e-6)]  # it is rounded, too
        unit = min(1.0, 1 / float(law.sigma_bar or 1))  # of what is 0 among tiny depths
        slack = SLACK * (value[i] / scale[i] if scale[i] else np.max(value) / unit) + UNDERFLOW
        found: list[float] = []
        for place, side in itertools.product(places, (1, -1)):
            found.append(float(exact_slope(place, side)))
            if abs(got[i] - found[-1]) <= BAR * abs(found[-1]) + slack:
                break  # each further one costs as much again
        else:
            pytest.fail(f"{label} at {tau[i]!r} is {got[i]:.9g}, not {found}")


@every_case
@pytest.mark.parametrize("kernel", KERNELS)
def test_derivatives_by_tau(position: int, kernel: str, effort: int) -> None:
    model, _ = make(position)
    law = reference(model)
    tau = depths(law, 12 * min(effort, 4))[1 if law.singular and kernel == "pp" else 0 :]
    function = getattr(law, kernel)
    value = np.array([float(function(exact(t))) for t in tau])

    @functools.cache
    def by_tau(t: Any, side: int) -> Any:
        if t:
            return one_sided(lambda shift: function(t * (1 + shift)) / t, side * law.step)
        step = law.step / (law.sigma_bar or 1)
        return (function(2 * step) - function(step)) / step

    for logarithmic in (False, True) if kernel != "ff" else (False,):
        model, _ = make(position)
        x = Float(tau)
        dr.enable_grad(x)
        y = getattr(model, kernel)(x)
        y = logarithm(y) if logarithmic else y
        dr.set_grad(x, 1)
        got = forward(y, len(tau))
        if logarithmic:
            got = np.where(value > 1e-30, got * value, 0)
        flight = 1 / float(law.sigma_bar) if law.sigma_bar else 1.0
        at = np.where(tau > 0, tau, flight)
        label = f"d {'ln ' * logarithmic}{kernel} / d tau"
        assert_derivatives(law, tau, value, got, by_tau, at, label)


@every_case
def test_derivatives_by_parameters(position: int, effort: int) -> None:
    model, leaves = make(position)
    law = reference(model)
    if not leaves:
        pytest.skip("no parameters with derivatives")
    tau = depths(law, 8 * min(effort, 4))[1 if law.singular else 0 :]
    values = {
        kernel: np.array([float(getattr(law, kernel)(exact(t))) for t in tau]) for kernel in KERNELS
    }
    for path in leaves:
        number = exact(leaves[path])
        scale = abs(number) or mp.one
        shifted: dict[Any, Any] = {}

        def at(shift: Any, path: str = path, number: Any = number, known: Any = shifted) -> Any:
            if shift not in known:
                known[shift] = reference(model, {path: number + shift})  # noqa: B023
            return known[shift]

        for kernel, value in values.items():

            @functools.cache
            def by_parameter(
                t: Any, side: int, kernel: str = kernel, at: Any = at, scale: Any = scale
            ) -> Any:
                step = side * law.step * scale
                return one_sided(lambda shift: getattr(at(shift), kernel)(t), step)

            for logarithmic in (False, True) if kernel != "ff" else (False,):
                model, leaves = make(position)
                y = getattr(model, kernel)(Float(tau))
                y = logarithm(y) if logarithmic else y
                dr.set_grad(leaves[path], 1)
                got = forward(y, len(tau))
                if logarithmic:
                    got = np.where(value > 1e-30, got * value, 0)
                sizes = np.full(len(tau), abs(float(number)))
                label = f"d {'ln ' * logarithmic}{kernel} / d {path}"
                assert_derivatives(law, tau, value, got, by_parameter, sizes, label)


@every_case
def test_derivatives_are_finite_however_far(position: int) -> None:
    """By tau and by every parameter."""
    ends = [1e20] if CASES[position][0] in UNLESS_MASKED else [1e20, 1e30, 3e38, np.inf]
    far = np.array(ends, dtype=np.float32)
    for kernel in KERNELS:
        for path in (None, *make(position)[1]):
            model, leaves = make(position)
            tau = Float(far)
            dr.enable_grad(tau)
            y = getattr(model, kernel)(tau)
            dr.set_grad(leaves[path] if path else tau, 1)
            assert np.all(np.isfinite(forward(y, len(far)))), (kernel, path)


@every_case
def test_masked_lanes_leave_gradients_alone(position: int) -> None:
    """Depths that a select discards, infinite ones too, add nothing to sums over all lanes."""
    model, leaves = make(position)
    law = reference(model)
    flight = 1 / float(law.sigma_bar) if law.sigma_bar else 1.0
    good = np.float32(flight) * np.array([0.21, 0.43, 1.31], dtype=np.float32)
    bad = np.array([0, 1e-38, 3e38, np.inf, *(float(k) for k in law.kinks[:1])], dtype=np.float32)
    for kernel in KERNELS:
        sums = []
        for tau in (good, np.concatenate([good, bad])):
            model, leaves = make(position)
            x = Float(tau)
            dr.enable_grad(x)
            y = dr.select(dr.arange(dr.llvm.ad.UInt, len(tau)) < 3, getattr(model, kernel)(x), 0)
            if not dr.grad_enabled(y):
                continue
            dr.backward(y)
            assert np.all(np.isfinite(np.array(x.grad)))
            assert np.all(np.array(x.grad)[3:] == 0)
            sums.append(np.array([float(leaf.grad[0]) for leaf in leaves.values()]))
            assert np.all(np.isfinite(sums[-1]))
        if sums:
            np.testing.assert_allclose(sums[0], sums[1], rtol=1e-5, atol=1e-6)
