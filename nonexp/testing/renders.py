"""A law in rendered scenes whose answers are known, through ``nonexp_volpath``.

Each function takes a law whose class is registered (:func:`registered` does that for a while),
renders in the present variant, and returns samples beside what they should be.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import mitsuba as mi
import numpy as np

from .. import models
from ..system.machine import check_variant
from ..transmittance import Transmittance
from .faults import Fault
from .relations import values_of
from .scenes import (
    DRAWN,
    FURNACE,
    NO_ROULETTE,
    ball,
    beam,
    orthographic,
    scene,
    square_film,
)
from .statistics import assert_same, assert_share, mean_is, passes, radiance

__all__ = [
    "crossing",
    "exact_furnace",
    "exchange",
    "filled",
    "furnace",
    "quadrature",
    "reciprocal",
    "registered",
    "scattered_once",
    "share_that_crosses",
    "single_scattering",
    "unit",
    "white_furnace",
    "white_furnace_without_connections",
]


@contextlib.contextmanager
def registered(law: Transmittance) -> Iterator[None]:
    """The law's class is registered within the block, and a variant set."""
    if mi.variant() is None:
        mi.set_variant(check_variant(None))
        mi.set_log_level(mi.LogLevel.Error)
    if type(law) in models.registry.values():
        yield
        return
    key = f"checked_{type(law).__name__}"
    models.register(type(law), key)
    try:
        yield
    finally:
        del models.registry[key]


def unit(law: Transmittance) -> float:
    """A mean free path, in optical depth."""
    return 1 / (float(law.sigma_bar) or 1.0)


def filled(law: Transmittance, **kw: Any) -> dict[str, Any]:
    """``nonexp_homogeneous`` with that law."""
    return {"type": "nonexp_homogeneous", "transmittance": models.to_dict(law), **kw}


def quadrature(
    law: Transmittance, *edges: float, units: tuple[float, ...] = (1.0,)
) -> tuple[Any, Any]:
    """Gauss-Legendre nodes and weights, piecewise between edges and where the law's functions,
    called on optical depths in these ``units``, have kinks."""
    kinks = [unit * float(tau) for tau in law.kinks for unit in units]
    cuts = np.unique([*edges, *(x for x in kinks if edges[0] < x < edges[-1])])
    x, w = np.polynomial.legendre.leggauss(max(8, 256 // len(cuts)))
    half = np.diff(cuts)[:, None] / 2
    return (cuts[:-1, None] + half * (1 + x)).ravel(), (half * w).ravel()


def _of(function: Callable[[Any], Any], tau: Any) -> Any:
    return values_of(function, np.ravel(tau)).reshape(np.shape(tau))


# --------------------------------------------------------------------- scenes


def crossing(law: Transmittance, depth: float, count: int = 2**18, seed: int = 3) -> Any:
    """Whether single rays escape through the middle of an absorbing ball, ``depth`` across: 1 with
    the probability ff(depth)."""
    inside = filled(law, sigma_t=depth / 2, albedo=0.0)
    return radiance(scene(DRAWN, sensor=beam(), ball=ball(inside), sky=FURNACE), count, seed)


def single_scattering(
    law: Transmittance, connecting: bool, count: int = 2**11, seed: int = 5
) -> tuple[Any, float]:
    """Radiance along a ray through the middle of a ball, two flights at most, and what it should
    be: ff + c/2 int fp(s) int pf(exit(s, mu)) dmu ds.

    With connections pf is evaluated along shadow rays; without, flights from particles escape with
    that probability.
    """
    radius, albedo = 0.65 * unit(law), 0.8
    inside = filled(law, sigma_t=radius, albedo=albedo, sample_emitters=connecting)
    integrator = {"type": "nonexp_volpath", "max_depth": 2}
    parts = {"sensor": beam(), "ball": ball(inside), "sky": FURNACE}
    got = passes(scene(integrator, **parts), count, seed)

    s, weight = quadrature(law, 0, 2 * radius)
    mu = (np.arange(1000) + 0.5) / 500 - 1
    r = np.abs(s - radius)[:, None]
    exits = -r * mu + np.sqrt(radius**2 - r**2 * (1 - mu**2))
    scattered = np.dot(weight, _of(law.fp, s) * _of(law.pf, exits).mean(axis=1))
    return got, float(law.ff(2 * radius)) + albedo * float(scattered)


def exact_furnace(law: Transmittance, boundary: str = "null", count: int = 2**14) -> Any:
    """Radiance of a white ball in a white sky, without connections and roulette: 1 exactly."""
    inside = filled(law, sigma_t=3 * unit(law), albedo=1.0, sample_emitters=False)
    parts = {"sensor": orthographic(1.1), "ball": ball(inside, boundary), "sky": FURNACE}
    return radiance(scene(NO_ROULETTE, **parts), count, 6)


def furnace(law: Transmittance, count: int = 2**10) -> Any:
    """The same with connections, roulette and forward scattering: 1 on average."""
    phase = {"type": "hg", "g": 0.5}
    inside = filled(law, sigma_t=3 * unit(law), albedo=1.0, phase=phase)
    parts = {"sensor": orthographic(1.1), "ball": ball(inside), "sky": FURNACE}
    return passes(scene(**parts), count, 7)


def exchange(law: Transmittance, count: int = 2**13) -> tuple[Any, Any]:
    """Flux from a lamp to a detector, and with both exchanged. One of the two plates stands in the
    medium, one outside, at other distances and angles."""
    sigma_t = 1.2 * unit(law)
    fog = {"type": "ref", "id": "fog"}
    inner = {"where": [0.2, -0.5, 0.1], "towards": [0.6, 0.6, 0.5]}
    outer = {"where": [0.3, 1.6, 0.4], "towards": [-0.3, 0.0, 0.1]}
    light = {"emitter": {"type": "area", "radiance": 1.0}}

    def meter(**kw: Any) -> dict[str, Any]:
        return {"sensor": {"type": "irradiancemeter", "film": square_film(1), **kw}}

    def flux(inside: dict[str, Any], outside: dict[str, Any], seed: int) -> Any:
        built = scene(
            fog={**filled(law, sigma_t=sigma_t, albedo=0.9), "id": "fog"},
            ball=ball(fog),
            inner=_plate(**inner, **inside),
            outer=_plate(**outer, **outside),
        )
        return passes(built, count, seed)

    return flux(meter(medium=fog), light, 12), flux(light, meter(), 13)


def _plate(where: list[float], towards: list[float], **kw: Any) -> dict[str, Any]:
    to_world = mi.ScalarTransform4f().look_at(where, towards, [0, 1, 0.1]).scale(0.35)
    black = {"type": "diffuse", "reflectance": 0.0}
    return {"type": "rectangle", "to_world": to_world, "bsdf": black, **kw}


# --------------------------------------------------------------------- checks


@contextlib.contextmanager
def _kind(text: str) -> Iterator[None]:
    """Name the kind of fault that a failing comparison shows."""
    try:
        yield
    except AssertionError as error:
        raise Fault(f"{text}: {error}") from None


def share_that_crosses(law: Transmittance) -> None:
    """The share of rays that cross an absorbing ball is ff, at two depths."""
    for depth in (0.15 * unit(law), 0.8 * unit(law)):
        with registered(law), _kind(f"transmittance of a ball of depth {depth:.3g}"):
            assert_share(crossing(law, depth), float(law.ff(depth)))


def scattered_once(law: Transmittance) -> None:
    """Single scattering in a ball, by shadow rays and by flights."""
    for connecting in (True, False):
        how = "shadow rays (pf)" if connecting else "flights (sampler of pf)"
        with registered(law), _kind(f"single scattering by {how}"):
            mean_is(*single_scattering(law, connecting), 0.02)


def white_furnace_without_connections(law: Transmittance) -> None:
    """A white ball in a white sky is invisible: every path is 1."""
    with registered(law):
        samples = exact_furnace(law)
    if not np.all(samples == 1):
        raise Fault(f"white furnace: radiance is {samples.min():.8g} to {samples.max():.8g}, not 1")


def white_furnace(law: Transmittance) -> None:
    """The same with connections: 1 within 5 %."""
    with registered(law), _kind("white furnace with connections"):
        mean_is(furnace(law), 1.0, 0.05)


def reciprocal(law: Transmittance) -> None:
    """Exchanging a lamp and a detector leaves the flux unchanged within 15 %."""
    with registered(law), _kind("reciprocity of lamp and detector"):
        assert_same(*exchange(law), 0.15)
