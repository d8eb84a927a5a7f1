"""The media of one scene as the path loop sees them.

Which medium a path is in is a *location*: nothing in a scene without media, a mask in a scene with
one, an index (0: none) in a scene with several. The loop treats it as a value to carry, compare
and pass back. Extinctions are numbers, or spectra as soon as one medium of the scene is chromatic.

What a flight needs to know of a medium is a method of :class:`Entry`; ``media.ask("survival",
location, ...)`` calls it for the medium at a location.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp import models
from nonexp.numerics.alternating import Alternation
from nonexp.numerics.laplace import AliasTable
from nonexp.plugins.density import Bounds, Density
from nonexp.plugins.spectra import grey, somewhere, visible
from nonexp.transmittance import Draw, Transmittance

from . import walk
from .jit import Numbering, opaque, recording
from .rays import Contact
from .spectral import channels


def medium_interaction(
    direction: Any, like: Any, p: Any = None, t: Any = None
) -> mi.MediumInteraction3f:
    """A ray in ``direction``, with the time and wavelengths of ``like``, and a point on it."""
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.wi, mei.time, mei.wavelengths = -direction, like.time, like.wavelengths
    mei.sh_frame = mi.Frame3f(mei.wi)
    if p is not None:
        mei.p = p
    if t is not None:
        mei.t = t
    return mei


def optical_depth(sigma_t: Any, distance: Any) -> Any:
    """``sigma_t * distance``; none where a channel's extinction is zero, however far."""
    tau = sigma_t * distance
    return tau if dr.depth_v(tau) == 1 else dr.select(sigma_t > 0, tau, 0)


# --------------------------------------------------------------------- one medium


@dataclass
class Origin:
    """Where a flight began, in scenes where some medium remembers its material."""

    start: Any
    """0 at a fixed point; at a collision 1, or 2 if that is in the second material"""
    hero: Any
    """channel that draws flights (chromatic extinction)"""
    wavelengths: Any
    """of the path"""
    ahead: Any = None
    """where the next flight begins, if this one ends at a collision, as ``start``"""


def at_particle(origin: Any) -> Any:
    """Whether a flight began at a collision; ``origin`` says just that where nothing remembers."""
    return origin.start != 0 if isinstance(origin, Origin) else origin


@dataclass
class Scatter:
    """Phase function at a collision, evaluated and sampled, with the medium's albedo."""

    albedo: Any
    value: Any
    pdf: Any
    wo: Any
    weight: Any
    wo_pdf: Any


@dataclass(frozen=True)
class Entry(ABC):
    """One medium of a scene. ``active``, last in all methods, is the mask of an indirect call.

    ``from_particle`` says whether a flight began at a collision; where some medium of the scene
    remembers its material it is an :class:`Origin`.
    """

    pointer: Any
    """the medium in Mitsuba"""
    model: Transmittance
    """its law"""
    extinction: Callable[[Any], Any]
    """extinction per scene unit at a medium interaction: a number, a spectrum if chromatic"""
    albedo: Callable[..., Any]
    """albedo at a medium interaction"""
    sealed: bool
    """no straight line from it reaches an emitter"""
    chromatic: bool
    """extinction differs between channels or wavelengths"""
    constant: bool
    """extinction depends neither on direction nor on wavelengths that differ from path to path"""
    emission: Callable[..., Any] | None
    """source function at a medium interaction; None if it does not emit"""
    expects: bool = field(default=False, kw_only=True)
    """emission behind it counts by expectation (see :mod:`.expected`)"""
    far: float = field(default=dr.inf, kw_only=True)
    """mean free paths up to which it does"""
    keep: float | None = field(default=None, kw_only=True)
    """parameter of the rule for collisions, within [0, 1); None: all collisions count"""

    @property
    def looks(self) -> bool:
        """The transmittance up to the next surface is known, past a collision."""
        return self.expects or self.refuses

    @property
    def looks_far(self) -> bool:
        """It is, however far."""
        return self.looks and self.far == dr.inf

    @property
    def refuses(self) -> bool:
        """Some collisions are not kept."""
        return self.keep is not None

    @property
    def tracked(self) -> bool:
        """Flights are tracked by null collisions."""
        return isinstance(self, Tracked)

    @property
    def walked(self) -> bool:
        """Flights walk through the cells of a grid."""
        return isinstance(self, Walked)

    @property
    def varies(self) -> bool:
        """Density varies in space: extinction does not give the length of a flight."""
        return self.walked or self.tracked

    @property
    def bricked(self) -> bool:
        """Tracked flights have a majorant for each of many bricks."""
        return isinstance(self, TrackedGrid)

    @property
    def thins(self) -> bool:
        """Tracked flights draw a factor on the extinction."""
        return self.tracked and self.draws > 0

    @property
    def emits(self) -> bool:
        """Its particles emit light."""
        return self.emission is not None

    @property
    def remembers(self) -> bool:
        """Paths carry its material from collision to collision."""
        return isinstance(self, Binary)

    @property
    def samples(self) -> bool:
        """Collisions use next-event estimation, where it can succeed."""
        return bool(self.pointer.use_emitter_sampling())

    @property
    def connects(self) -> bool:
        """A straight connection from a collision can succeed, and is wanted."""
        return self.samples and not self.sealed

    @property
    @abstractmethod
    def draws(self) -> int:
        """How many random numbers a flight takes at most."""

    @abstractmethod
    def flight(self, from_particle: Any, numbers: Sequence[Any], active: Any) -> Any:
        """Optical depth of the next collision from random ``numbers``; if tracked, the factor on
        the extinction that this flight meets, exponential by itself."""

    @abstractmethod
    def survival(self, from_particle: Any, tau: Any, active: Any) -> Any:
        """Transmittance over ``tau``, a number or a spectrum: pf from a particle, ff from a fixed
        point; 1 if tracked."""

    @abstractmethod
    def densities(
        self, from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any, active: Any
    ) -> Any:
        """Spectrum of the densities of a flight, one per channel as if it had drawn the flight.

        ``tau``: optical depth of each channel; ``own``: extinction of each channel relative to the
        one that drew it; ``drawn``: its optical depth, if it ``collided``.
        """

    def ahead(self, origin: Origin, tau: Any, u: Any, active: Any) -> Any:
        """Where the next flight begins, as :attr:`Origin.start`, if this one collides at ``tau``:
        from a random number ``u``."""
        return mi.UInt32(1)

    def horizon(self, sigma_t: Any, active: Any) -> Any:
        """Distance up to which emission counts by expectation; 0 if it does not."""
        if not self.looks:
            return mi.Float(0)
        if self.far == dr.inf:
            return mi.Float(dr.inf)
        return mi.Float(self.far / (self.model.sigma_bar * sigma_t))

    def distance(self, o: Any, d: Any, length: Any, column: Any, active: Any) -> tuple[Any, Any]:
        """Distance along a ray over which the density integrates to ``column``, if it is not beyond
        ``length``; and the integral up to there, or to ``length``. Without units where tracked."""
        return column, length

    def column(self, o: Any, d: Any, length: Any, sigma_t: Any, active: Any) -> Any:
        """Integral of the density along a ray: times extinction ``sigma_t`` its optical depth.

        May be less where nothing arrives in any case.
        """
        return length

    @abstractmethod
    def bounds(self, ray: Any, active: Any) -> tuple[Any, Any, Any]:
        """If tracked: distances at which a ray enters and leaves the data, and the majorant of
        extinction where the density's :meth:`bound` is 1."""

    def bricks(self, ray: Any, active: Any) -> tuple[Any, Any]:
        """If tracked: origin and direction of a ray in a space where the bricks, each with a bound
        of its own, are unit cubes. Here all is one brick."""
        return mi.Point3f(0.5), mi.Vector3f(0)

    def bound(self, brick: Any, active: Any) -> Any:
        """If tracked: upper bound of the density in a brick."""
        return mi.Float(1)

    @abstractmethod
    def coefficients(self, mei: Any, majorant: Any, active: Any) -> tuple[Any, Any]:
        """If tracked: coefficients of null collisions, up to a majorant, and of extinction."""

    def scatter(
        self, mei: Any, wo: Any, u1: Any, u2: Any, start: Any = None, active: Any = True
    ) -> Scatter:
        """Phase function towards ``wo`` and a sampled direction, at collisions ``mei``, of which
        flights begin with ``start`` (as :attr:`Origin.start`)."""
        return self._scatter(self.pointer.phase_function(), self.albedo, mei, wo, u1, u2, active)

    def _scatter(
        self, phase: Any, albedo: Any, mei: Any, wo: Any, u1: Any, u2: Any, active: Any
    ) -> Scatter:
        context = mi.PhaseFunctionContext(None)
        value, pdf = phase.eval_pdf(context, mei, wo, active)
        sampled, weight, sampled_pdf = phase.sample(context, mei, u1, u2, active)
        return Scatter(albedo(mei, active), value, pdf, sampled, weight, sampled_pdf)

    def emitted(self, mei: Any, start: Any = None, active: Any = True) -> Any:
        """Light that collisions ``mei`` add to their paths."""
        if self.emission is None:
            return mi.UnpolarizedSpectrum(0)
        return mi.UnpolarizedSpectrum((1 - self.albedo(mei, active)) * self.emission(mei, active))


class Homogeneous(Entry):
    """A medium of constant density, with any law."""

    @property
    def draws(self) -> int:
        return max(_count_draws(self.model.sample_p), _count_draws(self.model.sample_f))

    def flight(self, from_particle: Any, numbers: Sequence[Any], active: Any) -> Any:
        # A lane uses only one of the two laws: both take the same numbers.
        from_particle = at_particle(from_particle)
        p = self.model.sample_p(iter(numbers).__next__)
        f = self.model.sample_f(iter(numbers).__next__)
        return dr.select(from_particle, mi.Float(p), mi.Float(f))

    def survival(self, from_particle: Any, tau: Any, active: Any) -> Any:
        from_particle = at_particle(from_particle)

        def of(tau: Any) -> Any:
            return dr.select(from_particle, self.model.pf(tau), self.model.ff(tau))

        return of(tau) if dr.depth_v(tau) == 1 else mi.UnpolarizedSpectrum([of(t) for t in tau])

    def densities(
        self, from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any, active: Any
    ) -> Any:
        model, from_particle = self.model, at_particle(from_particle)
        atom = mi.Bool(False)
        for where, probability in model.atoms:
            # Samplers return an atom as it is, and reach its value otherwise with chance zero.
            atom |= (drawn == where) & (mi.Float(probability) > 0)
        atom &= from_particle & collided

        def of(tau: Any, own: Any) -> Any:
            density = own * dr.select(from_particle, model.pp(tau), model.fp(tau))
            density = dr.select(atom, dr.select(own == 1, mi.Float(1), 0), density)
            return dr.select(collided, density, self.survival(from_particle, tau, active))

        return mi.UnpolarizedSpectrum([of(t, o) for t, o in zip(tau, own, strict=True)])

    def bounds(self, ray: Any, active: Any) -> tuple[Any, Any, Any]:
        return mi.Float(0), mi.Float(-1), mi.Float(1)

    def coefficients(self, mei: Any, majorant: Any, active: Any) -> tuple[Any, Any]:
        return mi.UnpolarizedSpectrum(0), mi.UnpolarizedSpectrum(0)


@dataclass(frozen=True)
class Binary(Homogeneous):
    """A mixture of two materials with memory.

    Its ``extinction`` is 1: depths are distances. Changes of the material along a flight are no
    events, but summed over in closed form; the material at its end is drawn with that.
    """

    processes: Callable[[Any], Sequence[Alternation]]
    """collisions along a ray at some wavelengths: one for all channels, or one for each"""

    @property
    def draws(self) -> int:
        return 3

    def _of_hero(self, origin: Origin) -> Alternation:
        found, *others = self.processes(origin.wavelengths)
        if origin.hero is None:
            return found
        for channel, process in enumerate(others, 1):
            found = dr.select(origin.hero == channel, process, found)
        return found

    def _spectrum(self, origin: Origin, value: Callable[[Alternation], Any]) -> Any:
        """A spectrum of what each channel's process has for ``value``."""
        found = [value(process) for process in self.processes(origin.wavelengths)]
        return mi.UnpolarizedSpectrum(found[0] if len(found) == 1 else found)

    def flight(self, from_particle: Any, numbers: Sequence[Any], active: Any) -> Any:
        return self._of_hero(from_particle).flight(from_particle.start, *numbers[:3])

    def ahead(self, origin: Origin, tau: Any, u: Any, active: Any) -> Any:
        second = self._of_hero(origin).material(origin.start, tau, u)
        return dr.select(second, mi.UInt32(2), 1)

    def survival(self, from_particle: Any, tau: Any, active: Any) -> Any:
        start = from_particle.start
        if dr.depth_v(tau) == 1:
            return self._of_hero(from_particle).survival(start, tau)
        return self._spectrum(from_particle, lambda process: process.survival(start, tau[0]))

    def densities(
        self, from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any, active: Any
    ) -> Any:
        start, end = from_particle.start, from_particle.ahead - 1

        def of(process: Alternation) -> Any:
            density = process.density(start, end, tau[0])
            return dr.select(collided, density, process.survival(start, tau[0]))

        return self._spectrum(from_particle, of)

    def scatter(
        self, mei: Any, wo: Any, u1: Any, u2: Any, start: Any = None, active: Any = True
    ) -> Scatter:
        albedo = partial(self.pointer.eval_albedo_of, start == 2)
        found = [
            self._scatter(phase, albedo, mei, wo, u1, u2, active) for phase in self.pointer.phases
        ]
        return dr.select(start == 2, found[1], found[0]) if len(found) == 2 else found[0]

    def emitted(self, mei: Any, start: Any = None, active: Any = True) -> Any:
        absorbed = 1 - self.pointer.eval_albedo_of(start == 2, mei, active)
        return mi.UnpolarizedSpectrum(
            absorbed * self.pointer.eval_emission_of(start == 2, mei, active)
        )


@dataclass(frozen=True)
class Walked(Homogeneous):
    """A medium whose density lies on a grid, with any law.

    Its ``extinction`` is that where the density is 1. A flight draws an optical depth as in a
    homogeneous medium, and the integral of the density is inverted exactly.
    """

    density: Density
    reach: Any
    """optical depth from which on nothing arrives"""

    def distance(self, o: Any, d: Any, length: Any, column: Any, active: Any) -> tuple[Any, Any]:
        return walk.distance(self.density, o, d, length, column, active)

    def column(self, o: Any, d: Any, length: Any, sigma_t: Any, active: Any) -> Any:
        least = sigma_t if dr.depth_v(sigma_t) == 1 else dr.min(sigma_t)
        most = dr.select(least > 0, self.reach / least, dr.inf)
        return walk.column(self.density, o, d, length, most, active)


@dataclass(frozen=True)
class Tracked(Entry):
    """A heterogeneous medium that is tracked with null collisions; here one of Mitsuba's own,
    which is exponential.

    Its ``extinction`` is 1 everywhere, nothing is lost on its shadow rays: all that is done by
    :mod:`.tracking`, on :meth:`bounds` and :meth:`coefficients`.
    """

    @property
    def draws(self) -> int:
        return 0

    def flight(self, from_particle: Any, numbers: Sequence[Any], active: Any) -> Any:
        return mi.Float(1)

    def survival(self, from_particle: Any, tau: Any, active: Any) -> Any:
        return type(tau)(1)

    def densities(
        self, from_particle: Any, collided: Any, tau: Any, own: Any, drawn: Any, active: Any
    ) -> Any:
        return mi.UnpolarizedSpectrum(1)

    majorant: Any
    """upper bound of the extinction, in all channels: Mitsuba's own is not always one"""

    def bounds(self, ray: Any, active: Any) -> tuple[Any, Any, Any]:
        hits, near, far = self.pointer.intersect_aabb(ray)
        return dr.maximum(near, 0), dr.select(hits, far, -1), self.majorant

    def coefficients(self, mei: Any, majorant: Any, active: Any) -> tuple[Any, Any]:
        _, _, sigma_t = self.pointer.get_scattering_coefficients(mei, active)
        return dr.maximum(majorant - sigma_t, 0), sigma_t


@dataclass(frozen=True)
class TrackedGrid(Tracked):
    """A medium whose density lies on a grid, with a law ``T = E[exp(-S tau)]``.

    A flight draws S and is exponential with that factor on the extinction, so that null collisions
    hold. From a particle S is drawn in proportion to itself.
    """

    density: Density
    factor: Callable[[Any], Any]
    """extinction where the density is 1"""
    blocks: Bounds
    """upper bounds of the density"""
    law_f: AliasTable | None
    """of S, from a fixed point; None if S is always 1"""
    law_p: AliasTable | None

    @property
    def draws(self) -> int:
        return 2 if self.law_f else 0

    def flight(self, from_particle: Any, numbers: Sequence[Any], active: Any) -> Any:
        if not (self.law_f and self.law_p):
            return mi.Float(1)
        u1, u2 = numbers[:2]
        return dr.select(at_particle(from_particle), self.law_p(u1, u2), self.law_f(u1, u2))

    def bounds(self, ray: Any, active: Any) -> tuple[Any, Any, Any]:
        near, far = walk.interval(self.density, ray.o, ray.d)
        factor = self.factor(medium_interaction(ray.d, ray))
        return near, far, factor if dr.depth_v(factor) == 1 else dr.max(factor)

    def bricks(self, ray: Any, active: Any) -> tuple[Any, Any]:
        p, d = self.density.index(ray.o), self.density.index_step(ray.d)
        return mi.Point3f(p * self.blocks.scale), mi.Vector3f(d * self.blocks.scale)

    def bound(self, brick: Any, active: Any) -> Any:
        return self.blocks.of(brick, active)

    def coefficients(self, mei: Any, majorant: Any, active: Any) -> tuple[Any, Any]:
        sigma_t = mi.UnpolarizedSpectrum(self.factor(mei)) * self.density.lookup(mei.p, active)
        return dr.maximum(majorant - sigma_t, 0), sigma_t


def entry_of(pointer: Any, sealed: bool, regular: bool = False) -> Entry | None:
    """The entry of a medium; None where nothing ever collides. ``regular``: grids are walked."""
    if getattr(pointer, "remembers", False):
        return _binary(pointer, sealed)
    model = getattr(pointer, "model", None)
    if model is not None:
        if isinstance(model.sigma_bar, float) and model.sigma_bar == 0:
            return None
        chromatic, oriented = pointer.chromatic, pointer.oriented
        extinction, albedo, density = pointer.extinction, pointer.eval_albedo, pointer.density
        emission = pointer.eval_emission if pointer.emits else None
        if density is not None and pointer.most == 0:
            return None
    else:
        emission = density = None
        model, albedo = models.create("exponential"), partial(_stock_albedo, pointer)
        if not pointer.is_homogeneous():
            return _tracked(pointer, model, albedo, sealed)
        oriented = bool(
            mi.has_flag(pointer.phase_function().flags(), mi.PhaseFunctionFlags.Microflake)
        )
        chromatic = not grey(np.array(dr.detach(_majorant_of(pointer, visible()))))
        extinction = stock_extinction(pointer, chromatic)
    constant = not oriented and not (chromatic and mi.is_spectral)
    if constant:
        value = extinction(somewhere())
        if _vanishes(value):
            return None
        dr.make_opaque(value)
        extinction = partial(_always, value)
    common = pointer, model, extinction, albedo, sealed, chromatic, constant, emission
    if density is None:
        return Homogeneous(*common)
    if regular or not pointer.tracked:
        return Walked(*common, density, pointer.reach)
    unit = partial(_always, mi.Float(1))
    return TrackedGrid(
        pointer, model, unit, albedo, sealed, chromatic, True, emission, None, density, extinction,
        pointer.choice.bounds, *pointer.mixing,
    )  # fmt: skip


def _binary(pointer: Any, sealed: bool) -> Entry | None:
    def processes(wavelengths: Any) -> list[Alternation]:
        extinctions = pointer.extinctions(somewhere(wavelengths))
        if not pointer.chromatic:
            return [Alternation.of(extinctions, pointer.chord)]
        first, second = extinctions
        return [Alternation.of((first[k], second[k]), pointer.chord) for k in range(channels())]

    found = processes
    if not (pointer.chromatic and mi.is_spectral):
        if all(map(_vanishes, pointer.extinctions())):
            return None
        constant = processes(550.0)
        dr.make_opaque(constant)
        found = partial(_always, constant)
    return Binary(
        pointer, models.create("exponential"), partial(_always, mi.Float(1)), pointer.eval_albedo,
        sealed, pointer.chromatic, True, pointer.eval_emission if pointer.emits else None, found,
    )  # fmt: skip


def _tracked(pointer: Any, model: Transmittance, albedo: Any, sealed: bool) -> Entry | None:
    majorant = pointer.get_majorant(somewhere())[0]
    if _vanishes(majorant):
        return None
    parameters = mi.traverse(pointer)
    if "sigma_t.data" in parameters:
        chromatic = np.shape(parameters["sigma_t.data"])[-1] > 1
    else:
        values = np.array(dr.detach(pointer.get_scattering_coefficients(visible())[2]))
        chromatic = not grey(values)
        if not recording():
            # In spectral variants Mitsuba takes the mean of a spectrum made of a colour for its
            # maximum. Between the wavelengths looked at it may be a little higher.
            most = float(values.max()) * (1.01 if chromatic and mi.is_spectral else 1)
            majorant = opaque(mi.Float, max(most, float(dr.detach(majorant)[0])))
    unit = partial(_always, mi.Float(1))
    return Tracked(pointer, model, unit, albedo, sealed, chromatic, True, None, majorant)


def _count_draws(sample: Callable[[Draw], Any]) -> int:
    count = 0

    def draw() -> Any:
        nonlocal count
        count += 1
        return mi.Float(0.5)

    sample(draw)
    return count


def _vanishes(extinction: Any) -> bool:
    """While a function is being frozen nothing can be read: then zero goes through the loop."""
    return not recording() and bool(dr.all(dr.detach(extinction) == 0, axis=None))


def _always(value: Any, _mei: Any) -> Any:
    return value


def _majorant_of(medium: Any, mei: Any) -> Any:
    mei.wi = mi.Vector3f(0, 0, 1)
    return medium.get_majorant(mei)


def _stock_extinction(medium: Any, chromatic: bool, mei: Any) -> Any:
    sigma_t = medium.get_majorant(mei)
    return sigma_t if chromatic else sigma_t[0]


def stock_extinction(medium: Any, chromatic: bool) -> Callable[[Any], Any]:
    """Extinction of a medium of Mitsuba's own at an interaction."""
    return partial(_stock_extinction, medium, chromatic)


def _stock_albedo(medium: Any, mei: Any, active: Any = True) -> Any:
    sigma_s, _, sigma_t = medium.get_scattering_coefficients(mei, active)
    return mi.UnpolarizedSpectrum(dr.select(sigma_t > 0, sigma_s / sigma_t, 0))


def _kept(entry: Entry) -> float:
    return 1.0 if entry.keep is None else entry.keep


# --------------------------------------------------------------------- all media of a scene


def scene_media(
    pointers: Sequence[Any],
    sealed: Sequence[Any],
    everywhere: bool = False,
    regular: bool = False,
    expected: Sequence[Expected] = (),
) -> Media | None:
    """Those of some media in which anything can collide; None if there is none.

    No straight line from the ``sealed`` ones reaches an emitter. ``everywhere``: the only one is
    bounded by its grid alone. ``regular``: grids are walked. ``expected``: in these, draws give way
    to expected values.
    """
    found = (entry_of(pointer, pointer in sealed, regular) for pointer in pointers)
    entries = [_expecting(entry, expected) for entry in found if entry is not None]
    if not entries:
        return None
    if everywhere:
        return Everywhere(entries[0], alone=True)
    if len(entries) == 1:
        return OneMedium(entries[0], alone=len(pointers) == 1)
    return ManyMedia(entries)


@dataclass(frozen=True)
class Expected:
    """A medium in which draws give way to expected values."""

    medium: Any
    emission: bool
    """as :attr:`Entry.expects`"""
    far: float
    """as :attr:`Entry.far`"""
    keep: float | None
    """as :attr:`Entry.keep`"""


def _expecting(entry: Entry, expected: Sequence[Expected]) -> Entry:
    """An entry that knows of expected values, if its flights know their transmittance."""
    for one in expected:
        if one.medium == entry.pointer and not entry.tracked:
            return replace(entry, expects=one.emission, far=one.far, keep=one.keep)
    return entry


class Media(ABC):
    """The media in which something can collide."""

    def __init__(self, entries: Sequence[Entry]) -> None:
        self.entries = tuple(entries)
        self.connects = self.any("connects")
        """Collisions in some medium use next-event estimation."""
        self.chromatic = self.any("chromatic")
        """Extinction of some medium differs between channels or wavelengths."""
        self.tracks = self.any("tracked")
        """Flights through some medium are tracked by null collisions."""
        self.thins = self.any("thins")
        """Of these, some draw a factor on the extinction."""
        self.walks = self.any("walked")
        """Flights through some medium walk through a grid."""
        self.remembers = self.any("remembers")
        """Paths through some medium carry its material."""
        self.looks = self.any("looks")
        """Transmittances up to the next surface are of use in some medium."""
        self.refuses = self.any("refuses")
        """Some medium does not keep all collisions."""
        self._draws = max(entry.draws for entry in entries)

    def any(self, fact: str) -> bool:
        """Whether a fact, a boolean attribute of :class:`Entry`, holds for some medium."""
        return any(getattr(entry, fact) for entry in self.entries)

    def all(self, fact: str) -> bool:
        """Whether it holds for all media."""
        return all(getattr(entry, fact) for entry in self.entries)

    # ------------------------------------------------------------- locations

    @abstractmethod
    def at(self, pointer: Any) -> Any:
        """Location that a ``MediumPtr`` stands for."""

    @abstractmethod
    def inside(self, location: Any) -> Any:
        """Mask of the locations that lie in a medium."""

    def behind(
        self, si: Any, active: Any, location: Any, direction: Any, contact: Contact | None = None
    ) -> Any:
        """Location of a ray that leaves a surface in ``direction``, having come in ``location``.

        Where surfaces coincide, ``contact`` has all of them.
        """
        crossing = active & si.is_medium_transition()
        beyond = dr.select(crossing, self.at(si.target_medium(direction)), location)
        if contact is None:
            return beyond
        return dr.select(
            active & contact.several, self._through(contact, location, direction), beyond
        )

    def _through(self, contact: Contact, location: Any, direction: Any) -> Any:
        """Location beyond all surfaces in one place, each of which leads from one medium to
        another: those are passed in the order in which they fit together."""
        steps = []
        for si, there in contact.surfaces:
            through = dr.dot(si.n, direction) * dr.dot(si.n, contact.d) > 0
            crossed = there & through & si.is_medium_transition()
            before, after = (self.at(si.target_medium(d)) for d in (-direction, direction))
            steps.append([crossed, before, after])
        beyond, fits = location, mi.Bool(False)
        for _ in steps:
            for step in steps:
                left, before, after = step
                taken = left & (before == beyond)
                beyond = dr.select(taken, after, beyond)
                fits |= taken
                step[0] = left & ~taken
        # What began in a medium without saying so: as behind a single surface.
        for left, _, after in reversed(steps):
            beyond = dr.select(left & ~fits, after, beyond)
        return beyond

    def where(self, fact: str, location: Any) -> Any:
        """Mask of the locations in media for which a fact holds."""
        if not self.any(fact):
            return mi.Bool(False)
        return self.inside(location) if self.all(fact) else self._mixed(fact, location)

    def holds(self, fact: str, location: Any) -> Any:
        """Whether a fact holds at locations that lie in media; anything at others."""
        return mi.Bool(True) if self.all(fact) else self.where(fact, location)

    @abstractmethod
    def _mixed(self, fact: str, location: Any) -> Any:
        """Mask of the locations for which a fact holds that differs between media."""

    @abstractmethod
    def keep(self, location: Any) -> Any:
        """:attr:`Entry.keep` at locations in media; 1 where all collisions count."""

    # ------------------------------------------------------------- what is asked there

    @abstractmethod
    def _each(self, question: Callable[..., Any], location: Any, *args: Any, active: Any) -> Any:
        """``question(entry, *args, active=...)`` for the medium at each location."""

    def ask(self, name: str, location: Any, *args: Any, active: Any = True) -> Any:
        """What a method of :class:`Entry` answers for the medium at each location."""

        def question(entry: Entry, *args: Any, active: Any) -> Any:
            return getattr(entry, name)(*args, active=active)

        return self._each(question, location, *args, active=active)

    def sigma_t(self, location: Any, mei: Any) -> Any:
        """Extinction per scene unit of a ray with the direction ``-mei.wi`` (undefined outside
        media, 1 where flights are tracked)."""

        def question(entry: Entry, mei: Any, active: Any) -> Any:
            return self._spread(entry.extinction(mei))

        return self._each(question, location, mei, active=True)

    def flight(self, location: Any, from_particle: Any, sampler: Any, active: Any) -> Any:
        """Optical depth of the next collision; infinite where flights are tracked."""
        # A sampler cannot be advanced behind an indirect call: the numbers are drawn here.
        numbers = [sampler.next_1d(active) for _ in range(self._draws)]
        return self.ask("flight", location, from_particle, numbers, active=active)

    def origin(self, start: Any, wavelengths: Any, hero: Any = None) -> Any:
        """What is asked of flights from ``start``: that itself, whether they began at a collision,
        or with memory an :class:`Origin`."""
        if not self.remembers:
            return start
        return Origin(mi.UInt32(start), hero, wavelengths if mi.is_spectral else None)

    def _spread(self, extinction: Any) -> Any:
        """An extinction as this scene needs it: a number, or a spectrum."""
        return mi.UnpolarizedSpectrum(extinction) if self.chromatic else mi.Float(extinction)


class OneMedium(Media):
    """A scene with a single medium: its location is a mask, and its methods are called as is."""

    def __init__(self, entry: Entry, alone: bool) -> None:
        super().__init__([entry])
        self._alone = alone

    def at(self, pointer: Any) -> Any:
        if self._alone:
            return pointer != None  # noqa: E711
        return pointer == mi.MediumPtr(self.entries[0].pointer)

    def inside(self, location: Any) -> Any:
        return location

    def _mixed(self, fact: str, location: Any) -> Any:
        raise AssertionError("a single medium has no facts that differ")

    def keep(self, location: Any) -> Any:
        return opaque(mi.Float, _kept(self.entries[0]))

    def _each(self, question: Callable[..., Any], location: Any, *args: Any, active: Any) -> Any:
        return question(self.entries[0], *args, active=active)


class Everywhere(OneMedium):
    """A single medium on a grid: rays are always in it, and meet density where that is."""

    def at(self, pointer: Any) -> Any:
        return mi.Bool(True)

    def inside(self, location: Any) -> Any:
        return mi.Bool(True)

    def behind(
        self, si: Any, active: Any, location: Any, direction: Any, contact: Contact | None = None
    ) -> Any:
        return location


class ManyMedia(Media):
    """A scene with several media: a location is 0 or one more than an index into ``entries``.

    Only the media of this scene are traced, each behind one indirect call.
    """

    def __init__(self, entries: Sequence[Entry]) -> None:
        super().__init__(entries)
        self._numbering = Numbering([mi.MediumPtr(entry.pointer) for entry in entries])
        self._sigma_t = self._extinctions() if self.all("constant") else None

    def _extinctions(self) -> Any:
        values = [self._spread(entry.extinction(None)) for entry in self.entries]
        if not self.chromatic:
            return dr.concat(values)
        parts = zip(*values, strict=True)
        return mi.UnpolarizedSpectrum([dr.concat(list(part)) for part in parts])

    def at(self, pointer: Any) -> Any:
        return self._numbering.of(mi.MediumPtr(pointer))

    def inside(self, location: Any) -> Any:
        return location != 0

    def sigma_t(self, location: Any, mei: Any) -> Any:
        if self._sigma_t is None:
            return super().sigma_t(location, mei)
        return self._gathered(self._sigma_t, location)

    def _mixed(self, fact: str, location: Any) -> Any:
        facts = mi.Bool([getattr(entry, fact) for entry in self.entries])
        return self._gathered(facts, location)

    def keep(self, location: Any) -> Any:
        return self._gathered(mi.Float([_kept(entry) for entry in self.entries]), location)

    def _gathered(self, values: Any, location: Any) -> Any:
        return dr.gather(type(values), values, location - 1, location != 0)

    def _each(self, question: Callable[..., Any], location: Any, *args: Any, active: Any) -> Any:
        targets = [partial(question, entry) for entry in self.entries]
        return dr.switch(location - 1, targets, *args, active=(location != 0) & active)
