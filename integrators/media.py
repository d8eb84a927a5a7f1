"""The media of one scene as the path loop sees them.

Which medium a path is in is a *location*: nothing in a scene without media, a mask in a scene with
one, an index (0: none) in a scene with several. The loop treats it as a value to carry, compare
and pass back.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp import models
from nonexp.spectra import grey, visible
from nonexp.transmittance import Transmittance

from .scene_needs import SceneNeeds


@dataclass(frozen=True)
class _Entry:
    """One medium: where it stands in Mitsuba, and what a flight through it needs."""

    pointer: Any
    sigma_t: Any
    model: Transmittance
    albedo: Callable[..., Any]
    sealed: bool

    @property
    def connects(self) -> bool:
        return not self.sealed and bool(self.pointer.use_emitter_sampling())

    def flight(self, from_particle: Any, draws: Callable[[], Callable[[], Any]]) -> Any:
        """Optical depth of the next collision; ``draws()`` begins the random numbers anew, as only
        one of the two laws is used per lane."""
        p, f = self.model.sample_p(draws()), self.model.sample_f(draws())
        return dr.select(from_particle, mi.Float(p), mi.Float(f))

    def survival(self, from_particle: Any, tau: Any) -> Any:
        """Transmittance over ``tau``: pf from a particle, ff from a fixed point."""
        return dr.select(from_particle, self.model.pf(tau), self.model.ff(tau))

    def scatter(self, mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Scatter:
        """Phase function towards ``wo`` and a sampled direction, at collisions ``mei``."""
        context, phase = mi.PhaseFunctionContext(None), self.pointer.phase_function()
        value, pdf = phase.eval_pdf(context, mei, wo, active)
        sampled, weight, sampled_pdf = phase.sample(context, mei, u1, u2, active)
        return Scatter(self.albedo(mei, active), value, pdf, sampled, weight, sampled_pdf)


@dataclass
class Scatter:
    """Evaluated and sampled phase function at a collision, with the medium's albedo."""

    albedo: Any
    value: Any
    pdf: Any
    wo: Any
    weight: Any
    wo_pdf: Any


def scene_media(needs: SceneNeeds) -> Media | None:
    """The scene's media in which anything can collide; None if there is none."""
    pointers = needs.media
    found = (_entry(pointer, sealed=pointer in needs.sealed) for pointer in pointers)
    entries = [entry for entry in found if entry is not None]
    if not entries:
        return None
    if len(entries) == 1:
        return OneMedium(entries[0], alone=len(pointers) == 1)
    return ManyMedia(entries)


def _entry(pointer: Any, sealed: bool) -> _Entry | None:
    """What the loop needs to know of a medium; None where nothing ever collides."""
    model = getattr(pointer, "model", None)
    if model is not None:
        sigma_t, albedo = pointer.extinction(), pointer.eval_albedo
    else:
        model = models.create("exponential")
        sigma_t, albedo = _stock_extinction(pointer), _stock_albedo(pointer)
    if isinstance(model.sigma_bar, float) and model.sigma_bar == 0:
        return None
    # While a function is being frozen nothing can be read: then zero goes through the loop.
    if not dr.flag(dr.JitFlag.FreezingScope) and dr.all(dr.detach(sigma_t) == 0):
        return None
    dr.make_opaque(sigma_t)
    return _Entry(pointer, sigma_t, model, albedo, sealed)


def _stock_extinction(medium: Any) -> Any:
    """Extinction of a medium of Mitsuba's own, which must be homogeneous and grey."""
    if not medium.is_homogeneous():
        raise RuntimeError(
            "the scene holds a heterogeneous medium: nonexp_volpath does not support these yet"
        )
    if mi.has_flag(medium.phase_function().flags(), mi.PhaseFunctionFlags.Microflake):
        raise RuntimeError(
            "the scene holds a medium with a microflake phase function: "
            "nonexp_volpath does not support these yet"
        )
    sigma_t = medium.get_majorant(visible())
    if not grey(np.array(dr.detach(sigma_t))):
        raise RuntimeError(
            "the scene holds a medium whose sigma_t differs between wavelengths: "
            "nonexp_volpath does not support these yet"
        )
    return dr.gather(mi.Float, sigma_t[0], 0)


def _stock_albedo(medium: Any) -> Callable[..., Any]:
    def albedo(mei: Any, active: Any = True) -> Any:
        sigma_s, _, sigma_t = medium.get_scattering_coefficients(mei, active)
        return sigma_s / sigma_t

    return albedo


# --------------------------------------------------------------------------------------------------


class Media(ABC):
    """The media in which something can collide."""

    connects: bool
    """Collisions in some medium use next-event estimation."""
    some_sealed: bool
    """No connection from some medium can succeed."""
    all_sealed: bool
    """No connection through any medium can succeed."""

    @abstractmethod
    def at(self, pointer: Any) -> Any:
        """Location that a ``MediumPtr`` stands for."""

    def behind(self, si: Any, active: Any, location: Any, direction: Any) -> Any:
        """Location of a ray that leaves a surface in ``direction``, having come in ``location``."""
        crossing = active & si.is_medium_transition()
        return dr.select(crossing, self.at(si.target_medium(direction)), location)

    @abstractmethod
    def inside(self, location: Any) -> Any:
        """Mask of the locations that lie in a medium."""

    @abstractmethod
    def collision_connects(self, location: Any) -> Any:
        """Mask: collisions here use next-event estimation."""

    @abstractmethod
    def sealed(self, location: Any) -> Any:
        """Mask: no connection from here can succeed."""

    @abstractmethod
    def sigma_t(self, location: Any) -> Any:
        """Extinction per scene unit (undefined outside media)."""

    @abstractmethod
    def flight(self, location: Any, from_particle: Any, sampler: Any, active: Any) -> Any:
        """Optical depth of the next collision."""

    @abstractmethod
    def survival(self, location: Any, from_particle: Any, tau: Any) -> Any:
        """Transmittance over ``tau``: pf from a particle, ff from a fixed point."""

    @abstractmethod
    def scatter(self, location: Any, mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Scatter:
        """Phase function towards ``wo`` and a sampled direction, at collisions ``mei``."""


class OneMedium(Media):
    """A scene with a single medium: its location is a mask, and its functions are called as is."""

    def __init__(self, entry: _Entry, alone: bool) -> None:
        self._entry = entry
        self._alone = alone
        self.connects = entry.connects
        self.some_sealed = self.all_sealed = entry.sealed

    def at(self, pointer: Any) -> Any:
        if self._alone:
            return pointer != None  # noqa: E711
        return pointer == mi.MediumPtr(self._entry.pointer)

    def inside(self, location: Any) -> Any:
        return location

    def collision_connects(self, location: Any) -> Any:
        return mi.Bool(self.connects)

    def sealed(self, location: Any) -> Any:
        return location if self.some_sealed else mi.Bool(False)

    def sigma_t(self, location: Any) -> Any:
        return self._entry.sigma_t

    def flight(self, location: Any, from_particle: Any, sampler: Any, active: Any) -> Any:
        return self._entry.flight(from_particle, _shared_draws(lambda: sampler.next_1d(active)))

    def survival(self, location: Any, from_particle: Any, tau: Any) -> Any:
        return self._entry.survival(from_particle, tau)

    def scatter(self, location: Any, mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Scatter:
        return self._entry.scatter(mei, wo, u1, u2, active)


class ManyMedia(Media):
    """A scene with several media: a location is 0 or one more than an index into ``entries``.

    Only the media of this scene are traced, each behind one indirect call.
    """

    def __init__(self, entries: Sequence[_Entry]) -> None:
        self._entries = entries
        self.connects = any(entry.connects for entry in entries)
        self._mixed = any(entry.connects != self.connects for entry in entries)
        self._sigma_t = dr.concat([entry.sigma_t for entry in entries])
        self._draws = max(_count_draws(entry.model) for entry in entries)
        # Mitsuba numbers the objects of a type; this table leads from its number to ours.
        numbers = [int(_number(mi.MediumPtr(entry.pointer))[0]) for entry in entries]
        table = [0] * (max(numbers) + 1)
        for location, number in enumerate(numbers, 1):
            table[number] = location
        self._table = mi.UInt32(table)
        self._connects = mi.Bool([entry.connects for entry in entries])
        self._sealed = mi.Bool([entry.sealed for entry in entries])
        self.some_sealed = any(entry.sealed for entry in entries)
        self.all_sealed = all(entry.sealed for entry in entries)

    def at(self, pointer: Any) -> Any:
        number = _number(mi.MediumPtr(pointer))
        known = number < len(self._table)
        return dr.gather(mi.UInt32, self._table, number, known)

    def inside(self, location: Any) -> Any:
        return location != 0

    def collision_connects(self, location: Any) -> Any:
        if not self._mixed:
            return mi.Bool(self.connects)
        return dr.gather(mi.Bool, self._connects, location - 1, location != 0)

    def sealed(self, location: Any) -> Any:
        return dr.gather(mi.Bool, self._sealed, location - 1, location != 0)

    def sigma_t(self, location: Any) -> Any:
        return dr.gather(mi.Float, self._sigma_t, location - 1, location != 0)

    def flight(self, location: Any, from_particle: Any, sampler: Any, active: Any) -> Any:
        # A sampler cannot be advanced behind an indirect call: draw the numbers here.
        numbers = [sampler.next_1d(active) for _ in range(self._draws)]

        def call(entry: _Entry) -> Callable[..., Any]:
            def flight(from_particle: Any, numbers: list[Any], active: Any) -> Any:
                return entry.flight(from_particle, lambda: iter(numbers).__next__)

            return flight

        return self._switch(location, call, active, from_particle, numbers)

    def survival(self, location: Any, from_particle: Any, tau: Any) -> Any:
        def call(entry: _Entry) -> Callable[..., Any]:
            def survival(from_particle: Any, tau: Any, active: Any) -> Any:
                return entry.survival(from_particle, tau)

            return survival

        return self._switch(location, call, True, from_particle, tau)

    def scatter(self, location: Any, mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Scatter:
        def call(entry: _Entry) -> Callable[..., Any]:
            def scatter(mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Any:
                s = entry.scatter(mei, wo, u1, u2, active)
                return s.albedo, s.value, s.pdf, s.wo, s.weight, s.wo_pdf

            return scatter

        return Scatter(*self._switch(location, call, active, mei, wo, u1, u2))

    def _switch(self, location: Any, call: Callable[[_Entry], Any], active: Any, *args: Any) -> Any:
        targets = [call(entry) for entry in self._entries]
        return dr.switch(location - 1, targets, *args, active=(location != 0) & active)


def _number(pointer: Any) -> Any:
    return dr.reinterpret_array(mi.UInt32, pointer)


def _shared_draws(draw: Callable[[], Any]) -> Callable[[], Callable[[], Any]]:
    """Sequences that yield the same random numbers: of two laws only one is used per lane."""
    drawn: list[Any] = []

    def sequence() -> Callable[[], Any]:
        position = -1

        def following() -> Any:
            nonlocal position
            position += 1
            if position == len(drawn):
                drawn.append(draw())
            return drawn[position]

        return following

    return sequence


def _count_draws(model: Transmittance) -> int:
    """How many random numbers the model's flights take at most."""
    counts = []
    for sample in (model.sample_f, model.sample_p):
        count = 0

        def draw() -> Any:
            nonlocal count
            count += 1
            return mi.Float(0.5)

        sample(draw)
        counts.append(count)
    return max(counts)
