"""Derivatives of images by scene parameters, for inverse rendering.

``mi.render(scene, params)`` has the derivatives that ``nonexp_volpath`` computes itself, forward
and backward. :func:`jacobian` collects them for some parameters. :func:`differences` works for
every parameter and every law, for two renders each.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = [
    "Derivative",
    "changed",
    "differences",
    "jacobian",
    "numbers",
    "replays",
    "restored",
    "tangent",
]


@dataclass(frozen=True)
class Derivative:
    """The derivative of an image by one number among a scene's parameters."""

    name: str
    """the parameter as ``mi.traverse`` calls it, perhaps with the number of an item"""
    value: Any
    """height x width x channels"""
    stderr: Any
    """its standard error, pixel by pixel; NaN from a single run"""


def jacobian(
    scene: mi.Scene,
    names: str | Sequence[str],
    *,
    sensor: int = 0,
    spp: int = 0,
    runs: int = 4,
    seed: int = 0,
) -> list[Derivative]:
    """Derivatives of the image by scene parameters, by path replay in forward mode.

    A parameter with several numbers, such as a colour, counts as one: all of them move together;
    ``name[2]`` is the third of them alone. The mean and the standard error are over ``runs``
    renders of ``spp`` samples per pixel each (0: the scene's own). Raises ``KeyError`` for names
    that the scene does not have, and ``ValueError`` for parameters by which there is no derivative.
    """
    parameters = mi.traverse(scene)

    def once(key: str, item: int | None, number: int) -> Any:
        return tangent(scene, parameters, key, item, sensor=sensor, spp=spp, seed=number)

    return [_over(name, parameters, runs, seed, once) for name in _names(names)]


def differences(
    scene: mi.Scene,
    names: str | Sequence[str],
    *,
    step: float = 0.02,
    sensor: int = 0,
    spp: int = 0,
    runs: int = 4,
    seed: int = 0,
) -> list[Derivative]:
    """The same as :func:`jacobian` by central differences of renders with common seeds.

    Parameters move by ``step`` times the largest of their numbers, or by ``step`` itself where all
    are zero. The result is off by a term of the order of ``step`` squared, and its standard error
    grows as ``step`` falls. Raises ``KeyError`` for names that the scene does not have.
    """
    parameters = mi.traverse(scene)

    def once(key: str, item: int | None, number: int) -> Any:
        with restored(parameters, key) as base:
            size = step * (float(np.abs(np.array(base)).max()) or 1.0)
            images = []
            for sign in (1, -1):
                parameters[key] = base + sign * size * _direction(base, item)
                parameters.update()
                images.append(np.array(mi.render(scene, sensor=sensor, spp=spp, seed=number)))
            return (images[0] - images[1]) / (2 * size)

    return [_over(name, parameters, runs, seed, once) for name in _names(names)]


def tangent(
    scene: mi.Scene,
    parameters: Any,
    key: str,
    item: int | None,
    *,
    sensor: int,
    spp: int,
    seed: int,
) -> Any:
    """Derivative of one render by a parameter, or by one of its numbers."""
    with restored(parameters, key) as moved:
        dr.enable_grad(moved)
        parameters[key] = moved
        parameters.update()
        dr.set_grad(moved, _direction(moved, item))
        # As mi.render does, with the seed that it chooses, but without the image.
        number, _ = mi.sample_tea_32(seed, 1)
        camera = scene.sensors()[sensor]
        integrator: Any = scene.integrator()
        return np.array(integrator.render_forward(scene, parameters, camera, number, spp))


def replays(scene: mi.Scene, backward: bool = False) -> bool:
    """Whether the scene's integrator replays paths, so that its derivatives are unbiased. Some of
    Mitsuba's do so in ``backward`` mode only."""
    integrator = scene.integrator()
    stock: Any = mi.ad.integrators.common.RBIntegrator
    own = type(integrator).__name__ == "NonexpVolpath"
    return own or (backward and isinstance(integrator, stock))


@contextmanager
def restored(parameters: Any, key: str) -> Iterator[Any]:
    """A parameter without derivatives, to be changed; afterwards it is again what it was."""
    # A copy: what mi.traverse gives changes with the scene.
    kept = type(parameters[key])(parameters[key])
    try:
        yield type(kept)(dr.detach(kept))
    finally:
        parameters[key] = kept
        parameters.update()


def numbers(value: Any) -> Any:
    """The numbers that a parameter consists of, as a vector."""
    return np.array(dr.detach(value), dtype=np.float64).ravel()


def changed(value: Any, to: Sequence[float]) -> Any:
    """A parameter with other numbers."""
    kind = type(value)
    if dr.is_tensor_v(value):
        return kind(np.reshape(np.asarray(to, dtype=np.float32), value.shape))
    if dr.depth_v(value) > 1:
        return kind(*map(float, to))
    return kind([float(number) for number in to])


def _direction(value: Any, item: int | None) -> Any:
    if item is None:
        return dr.ones(type(value), dr.shape(value))
    unit = np.zeros(len(numbers(value)))
    unit[item] = 1
    return changed(value, list(unit))


def _names(names: str | Sequence[str]) -> Sequence[str]:
    return [names] if isinstance(names, str) else names


def _over(name: str, parameters: Any, runs: int, seed: int, once: Any) -> Derivative:
    """Mean and standard error over independent runs."""
    key, item = name, None
    if name not in parameters and (match := re.fullmatch(r"(.+)\[(\d+)\]", name)):
        key, item = match[1], int(match[2])
    if key not in parameters or (item is not None and item >= len(numbers(parameters[key]))):
        raise KeyError(f"the scene has no parameter {name!r}")
    if runs < 1:
        raise ValueError(f"runs is {runs}: it must be at least 1")
    found = np.array([once(key, item, seed + number) for number in range(runs)])
    stderr = np.full_like(found[0], np.nan)
    if runs > 1:
        stderr = found.std(axis=0, ddof=1) / np.sqrt(runs)
    return Derivative(name, found.mean(axis=0), stderr)
