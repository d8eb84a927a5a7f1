"""The media of one scene as the path loop sees them.

Which medium a path is in is a *location*: nothing in a scene without media, a mask in a scene with
one, an index (0: none) in a scene with several. The loop treats it as a value to carry, compare
and pass back. Extinctions are numbers, or spectra as soon as one medium of the scene is chromatic.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from nonexp.transmittance.choice import replayed

from .entries import Entry, Scatter, Tracked, entry_of
from .jit import Numbering
from .scene_needs import SceneNeeds

__all__ = ["Media", "Scatter", "scene_media"]


def scene_media(needs: SceneNeeds) -> Media | None:
    """The scene's media in which anything can collide; None if there is none."""
    pointers = needs.media
    found = (entry_of(pointer, sealed=pointer in needs.sealed) for pointer in pointers)
    entries = [entry for entry in found if entry is not None]
    if not entries:
        return None
    if len(entries) == 1:
        return OneMedium(entries[0], alone=len(pointers) == 1)
    return ManyMedia(entries)


class Media(ABC):
    """The media in which something can collide."""

    def __init__(self, entries: Sequence[Entry]) -> None:
        self.entries = tuple(entries)
        """The media themselves."""
        self.connects = any(entry.connects for entry in entries)
        """Collisions in some medium use next-event estimation."""
        self.samples = any(entry.samples for entry in entries)
        """Likewise, were nothing sealed."""
        self.some_sealed = any(entry.sealed for entry in entries)
        """No connection from some medium can succeed."""
        self.all_sealed = all(entry.sealed for entry in entries)
        """No connection through any medium can succeed."""
        self.chromatic = any(entry.chromatic for entry in entries)
        """Extinction of some medium differs between channels or wavelengths."""
        self.tracks = any(isinstance(entry, Tracked) for entry in entries)
        """Some medium is heterogeneous: flights through it are tracked step by step."""

    def _spread(self, extinction: Any) -> Any:
        """An extinction as this scene needs it: a number, or a spectrum."""
        return mi.UnpolarizedSpectrum(extinction) if self.chromatic else mi.Float(extinction)

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
    def collision_samples(self, location: Any) -> Any:
        """Mask: likewise, were nothing sealed."""

    @abstractmethod
    def sealed(self, location: Any) -> Any:
        """Mask: no connection from here can succeed."""

    @abstractmethod
    def tracked(self, location: Any) -> Any:
        """Mask: flights here are tracked step by step."""

    @abstractmethod
    def sigma_t(self, location: Any, mei: Any) -> Any:
        """Extinction per scene unit of a ray with the direction ``-mei.wi`` (undefined outside
        media, 1 where flights are tracked)."""

    @abstractmethod
    def flight(self, location: Any, from_particle: Any, sampler: Any, active: Any) -> Any:
        """Optical depth of the next collision; infinite where flights are tracked."""

    @abstractmethod
    def survival(self, location: Any, from_particle: Any, tau: Any) -> Any:
        """Transmittance over ``tau``: pf from a particle, else ff; 1 where flights are tracked."""

    @abstractmethod
    def densities(
        self, location: Any, from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any
    ) -> Any:
        """Spectrum of the densities of a flight, one per channel as if it had drawn the flight.

        ``tau``: optical depth of each channel; ``own``: extinction of each channel relative to the
        one that drew it; ``drawn``: its optical depth, if it ``collided``.
        """

    @abstractmethod
    def bounds(self, location: Any, ray: Any) -> tuple[Any, Any, Any]:
        """Where flights are tracked: distances at which a ray enters and leaves the medium's data,
        and the majorant of extinction."""

    @abstractmethod
    def coefficients(self, location: Any, mei: Any, active: Any) -> tuple[Any, Any]:
        """Where flights are tracked: coefficients of null collisions and of extinction."""

    @abstractmethod
    def scatter(self, location: Any, mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Scatter:
        """Phase function towards ``wo`` and a sampled direction, at collisions ``mei``."""


class OneMedium(Media):
    """A scene with a single medium: its location is a mask, and its functions are called as is."""

    def __init__(self, entry: Entry, alone: bool) -> None:
        super().__init__([entry])
        self._entry = entry
        self._alone = alone

    def at(self, pointer: Any) -> Any:
        if self._alone:
            return pointer != None  # noqa: E711
        return pointer == mi.MediumPtr(self._entry.pointer)

    def inside(self, location: Any) -> Any:
        return location

    def collision_connects(self, location: Any) -> Any:
        return mi.Bool(self.connects)

    def collision_samples(self, location: Any) -> Any:
        return mi.Bool(self.samples)

    def sealed(self, location: Any) -> Any:
        return location if self.some_sealed else mi.Bool(False)

    def tracked(self, location: Any) -> Any:
        return location if self.tracks else mi.Bool(False)

    def sigma_t(self, location: Any, mei: Any) -> Any:
        return self._spread(self._entry.extinction(mei))

    def flight(self, location: Any, from_particle: Any, sampler: Any, active: Any) -> Any:
        return self._entry.flight(from_particle, replayed(lambda: sampler.next_1d(active)))

    def survival(self, location: Any, from_particle: Any, tau: Any) -> Any:
        return self._entry.survival(from_particle, tau)

    def densities(
        self, location: Any, from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any
    ) -> Any:
        return self._entry.densities(from_particle, collided, tau, own, drawn)

    def bounds(self, location: Any, ray: Any) -> tuple[Any, Any, Any]:
        return self._entry.bounds(ray)

    def coefficients(self, location: Any, mei: Any, active: Any) -> tuple[Any, Any]:
        return self._entry.coefficients(mei, active)

    def scatter(self, location: Any, mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Scatter:
        return self._entry.scatter(mei, wo, u1, u2, active)


class ManyMedia(Media):
    """A scene with several media: a location is 0 or one more than an index into ``entries``.

    Only the media of this scene are traced, each behind one indirect call.
    """

    def __init__(self, entries: Sequence[Entry]) -> None:
        super().__init__(entries)
        self._mixed = any(entry.connects != self.connects for entry in entries)
        self._constant = all(entry.constant for entry in entries)
        if self._constant:
            self._sigma_t = self._gathered([self._spread(e.extinction(None)) for e in entries])
        self._draws = max(_count_draws(entry) for entry in entries)
        self._numbering = Numbering([mi.MediumPtr(entry.pointer) for entry in entries])
        self._connects = mi.Bool([entry.connects for entry in entries])
        self._samples = mi.Bool([entry.samples for entry in entries])
        self._sealed = mi.Bool([entry.sealed for entry in entries])
        self._tracked = mi.Bool([isinstance(entry, Tracked) for entry in entries])

    def at(self, pointer: Any) -> Any:
        return self._numbering.of(mi.MediumPtr(pointer))

    def inside(self, location: Any) -> Any:
        return location != 0

    def collision_connects(self, location: Any) -> Any:
        if not self._mixed:
            return mi.Bool(self.connects)
        return dr.gather(mi.Bool, self._connects, location - 1, location != 0)

    def collision_samples(self, location: Any) -> Any:
        return dr.gather(mi.Bool, self._samples, location - 1, location != 0)

    def sealed(self, location: Any) -> Any:
        return dr.gather(mi.Bool, self._sealed, location - 1, location != 0)

    def tracked(self, location: Any) -> Any:
        return dr.gather(mi.Bool, self._tracked, location - 1, location != 0)

    def sigma_t(self, location: Any, mei: Any) -> Any:
        if self._constant:
            return dr.gather(type(self._sigma_t), self._sigma_t, location - 1, location != 0)

        def call(entry: Entry) -> Callable[..., Any]:
            return lambda mei, active: self._spread(entry.extinction(mei))

        return self._switch(location, call, True, mei)

    def flight(self, location: Any, from_particle: Any, sampler: Any, active: Any) -> Any:
        # A sampler cannot be advanced behind an indirect call: draw the numbers here.
        numbers = [sampler.next_1d(active) for _ in range(self._draws)]

        def call(entry: Entry) -> Callable[..., Any]:
            def flight(from_particle: Any, numbers: list[Any], active: Any) -> Any:
                return entry.flight(from_particle, lambda: iter(numbers).__next__)

            return flight

        return self._switch(location, call, active, from_particle, numbers)

    def survival(self, location: Any, from_particle: Any, tau: Any) -> Any:
        def call(entry: Entry) -> Callable[..., Any]:
            def survival(from_particle: Any, tau: Any, active: Any) -> Any:
                return entry.survival(from_particle, tau)

            return survival

        return self._switch(location, call, True, from_particle, tau)

    def densities(
        self, location: Any, from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any
    ) -> Any:
        def call(entry: Entry) -> Callable[..., Any]:
            def densities(
                from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any, active: Any
            ) -> Any:
                return entry.densities(from_particle, collided, tau, own, drawn)

            return densities

        return self._switch(location, call, True, from_particle, collided, tau, own, drawn)

    def bounds(self, location: Any, ray: Any) -> tuple[Any, Any, Any]:
        def call(entry: Entry) -> Callable[..., Any]:
            def bounds(ray: Any, active: Any) -> Any:
                return entry.bounds(ray)

            return bounds

        found: tuple[Any, Any, Any] = self._switch(location, call, True, ray)
        return found

    def coefficients(self, location: Any, mei: Any, active: Any) -> tuple[Any, Any]:
        def call(entry: Entry) -> Callable[..., Any]:
            def coefficients(mei: Any, active: Any) -> Any:
                return entry.coefficients(mei, active)

            return coefficients

        found: tuple[Any, Any] = self._switch(location, call, active, mei)
        return found

    def scatter(self, location: Any, mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Scatter:
        def call(entry: Entry) -> Callable[..., Any]:
            def scatter(mei: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Any:
                s = entry.scatter(mei, wo, u1, u2, active)
                return s.albedo, s.value, s.pdf, s.wo, s.weight, s.wo_pdf

            return scatter

        return Scatter(*self._switch(location, call, active, mei, wo, u1, u2))

    def _switch(self, location: Any, call: Callable[[Entry], Any], active: Any, *args: Any) -> Any:
        targets = [call(entry) for entry in self.entries]
        return dr.switch(location - 1, targets, *args, active=(location != 0) & active)

    def _gathered(self, extinctions: list[Any]) -> Any:
        if not self.chromatic:
            return dr.concat(extinctions)
        parts = zip(*extinctions, strict=True)
        return mi.UnpolarizedSpectrum([dr.concat(list(part)) for part in parts])


def _count_draws(entry: Entry) -> int:
    """How many random numbers the medium's flights take at most."""
    count = 0

    def draw() -> Any:
        nonlocal count
        count += 1
        return mi.Float(0.5)

    entry.flight(mi.Bool(False), replayed(draw))
    return count
