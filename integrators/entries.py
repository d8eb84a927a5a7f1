"""One medium of a scene, and what a flight through it needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp import models
from nonexp.plugins.spectra import grey, somewhere, visible
from nonexp.transmittance import Transmittance

from .jit import recording


@dataclass
class Scatter:
    """Evaluated and sampled phase function at a collision, with the medium's albedo."""

    albedo: Any
    value: Any
    pdf: Any
    wo: Any
    weight: Any
    wo_pdf: Any


@dataclass(frozen=True)
class Entry:
    """A homogeneous medium."""

    pointer: Any
    """where it stands in Mitsuba"""
    model: Transmittance
    """its law"""
    extinction: Callable[[Any], Any]
    """extinction per scene unit at a medium interaction: a number, a spectrum if chromatic"""
    albedo: Callable[..., Any]
    """albedo at a medium interaction"""
    sealed: bool
    """no straight line from it reaches an emitter"""
    chromatic: bool = False
    """extinction differs between channels or wavelengths"""
    constant: bool = True
    """extinction depends neither on direction nor on wavelengths that differ from path to path"""

    @property
    def samples(self) -> bool:
        """Collisions use next-event estimation, where it can succeed."""
        return bool(self.pointer.use_emitter_sampling())

    @property
    def connects(self) -> bool:
        """A straight connection from a collision can succeed, and is wanted."""
        return self.samples and not self.sealed

    def flight(self, from_particle: Any, draws: Callable[[], Callable[[], Any]]) -> Any:
        """Optical depth of the next collision; ``draws()`` begins the random numbers anew, as only
        one of the two laws is used per lane."""
        p, f = self.model.sample_p(draws()), self.model.sample_f(draws())
        return dr.select(from_particle, mi.Float(p), mi.Float(f))

    def survival(self, from_particle: Any, tau: Any) -> Any:
        """Transmittance over ``tau``, a number or a spectrum: pf from a particle, ff from a fixed
        point."""

        def of(tau: Any) -> Any:
            return dr.select(from_particle, self.model.pf(tau), self.model.ff(tau))

        return of(tau) if dr.depth_v(tau) == 1 else mi.UnpolarizedSpectrum([of(t) for t in tau])

    def densities(self, from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any) -> Any:
        """Spectrum of the densities of a flight per channel; see :class:`~.media.Media`."""
        model = self.model
        atom = mi.Bool(False)
        for where, probability in model.atoms:
            # Samplers return an atom as it is, and reach its value otherwise with chance zero.
            atom |= (drawn == where) & (mi.Float(probability) > 0)
        atom &= from_particle & collided

        def of(tau: Any, own: Any) -> Any:
            density = own * dr.select(from_particle, model.pp(tau), model.fp(tau))
            density = dr.select(atom, dr.select(own == 1, mi.Float(1), 0), density)
            return dr.select(collided, density, self.survival(from_particle, tau))

        return mi.UnpolarizedSpectrum([of(t, o) for t, o in zip(tau, own, strict=True)])

    def bounds(self, ray: Any) -> tuple[Any, Any, Any]:
        """For tracking: where a ray enters and leaves, and the majorant. Nothing here."""
        return mi.Float(0), mi.Float(-1), mi.Float(1)

    def coefficients(self, mei: Any, active: Any) -> tuple[Any, Any]:
        """For tracking: coefficients of null collisions and of extinction."""
        return mi.UnpolarizedSpectrum(0), mi.UnpolarizedSpectrum(0)

    def scatter(self, mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Scatter:
        """Phase function towards ``wo`` and a sampled direction, at collisions ``mei``."""
        context, phase = mi.PhaseFunctionContext(None), self.pointer.phase_function()
        value, pdf = phase.eval_pdf(context, mei, wo, active)
        sampled, weight, sampled_pdf = phase.sample(context, mei, u1, u2, active)
        return Scatter(self.albedo(mei, active), value, pdf, sampled, weight, sampled_pdf)


@dataclass(frozen=True)
class Tracked(Entry):
    """A heterogeneous medium of Mitsuba's own: exponential, tracked with null collisions.

    Its ``extinction`` is 1 everywhere, its flights do not end, nothing is lost on its shadow
    rays: all that is done by :mod:`.tracking`, on :meth:`bounds` and :meth:`coefficients`.
    """

    def flight(self, from_particle: Any, draws: Callable[[], Callable[[], Any]]) -> Any:
        return mi.Float(dr.inf)

    def survival(self, from_particle: Any, tau: Any) -> Any:
        return type(tau)(1)

    def densities(self, from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any) -> Any:
        return mi.UnpolarizedSpectrum(1)

    def bounds(self, ray: Any) -> tuple[Any, Any, Any]:
        meets, near, far = self.pointer.intersect_aabb(ray)
        majorant = self.pointer.get_majorant(dr.zeros(mi.MediumInteraction3f))[0]
        return dr.maximum(near, 0), dr.select(meets, far, -1), majorant

    def coefficients(self, mei: Any, active: Any) -> tuple[Any, Any]:
        _, sigma_n, sigma_t = self.pointer.get_scattering_coefficients(mei, active)
        return sigma_n, sigma_t


def entry_of(pointer: Any, sealed: bool) -> Entry | None:
    """What the loop needs to know of a medium; None where nothing ever collides."""
    model = getattr(pointer, "model", None)
    if model is not None:
        if isinstance(model.sigma_bar, float) and model.sigma_bar == 0:
            return None
        chromatic, oriented = pointer.chromatic, pointer.oriented
        extinction, albedo = pointer.extinction, pointer.eval_albedo
    else:
        model = models.create("exponential")
        albedo = _stock_albedo(pointer)
        if not pointer.is_homogeneous():
            return _tracked(pointer, model, albedo, sealed)
        oriented = bool(
            mi.has_flag(pointer.phase_function().flags(), mi.PhaseFunctionFlags.Microflake)
        )
        chromatic = not grey(np.array(dr.detach(_majorant_of(pointer, visible()))))
        extinction = _stock_extinction(pointer, chromatic)
    constant = not oriented and not (chromatic and mi.is_spectral)
    if constant:
        value = extinction(somewhere())
        # While a function is being frozen nothing can be read: then zero goes through the loop.
        if not recording() and dr.all(dr.detach(value) == 0, axis=None):
            return None
        dr.make_opaque(value)
        return Entry(pointer, model, lambda mei: value, albedo, sealed, chromatic)
    return Entry(pointer, model, extinction, albedo, sealed, chromatic, constant=False)


def _tracked(pointer: Any, model: Transmittance, albedo: Any, sealed: bool) -> Entry | None:
    majorant = pointer.get_majorant(somewhere())[0]
    if not recording() and dr.all(dr.detach(majorant) == 0, axis=None):
        return None
    parameters = mi.traverse(pointer)
    if "sigma_t.data" in parameters:
        chromatic = np.shape(parameters["sigma_t.data"])[-1] > 1
    else:
        values = pointer.get_scattering_coefficients(visible())[2]
        chromatic = not grey(np.array(dr.detach(values)))
    return Tracked(pointer, model, lambda mei: mi.Float(1), albedo, sealed, chromatic)


def _majorant_of(medium: Any, mei: Any) -> Any:
    mei.wi = mi.Vector3f(0, 0, 1)
    return medium.get_majorant(mei)


def _stock_extinction(medium: Any, chromatic: bool) -> Callable[[Any], Any]:
    def extinction(mei: Any) -> Any:
        sigma_t = medium.get_majorant(mei)
        return sigma_t if chromatic else sigma_t[0]

    return extinction


def _stock_albedo(medium: Any) -> Callable[..., Any]:
    def albedo(mei: Any, active: Any = True) -> Any:
        sigma_s, _, sigma_t = medium.get_scattering_coefficients(mei, active)
        return mi.UnpolarizedSpectrum(dr.select(sigma_t > 0, sigma_s / sigma_t, 0))

    return albedo
