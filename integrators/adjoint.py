"""Derivatives of a path that is replayed: what each event depends on, and what follows from it.

A replay makes the same random decisions as the path before, whose radiance ``total`` is known. An
event multiplies what is collected after it by factors that depend on parameters: their logarithmic
derivatives count times that rest (path replay, Vicini et al. 2021). Sampling is not differentiated.
For a flight the factor is its density or its transmittance over what it was drawn with: the
derivative of its logarithm, the *score*, is zero on average. So any constant may be taken from the
rest: the mean of the pixel's other paths makes derivatives far less noisy.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.plugins.spectra import somewhere
from nonexp.transmittance import Transmittance

from . import walk
from .media import Entry, Media, Walked, stock_extinction


def log_or_zero(value: Any) -> Any:
    """Logarithm where a value is positive, else 0; derivatives too."""
    positive = value > 0
    return dr.select(positive, dr.log(dr.select(positive, value, 1)), 0)


# --------------------------------------------------------------------- what is differentiated by


@dataclass(frozen=True)
class Wanted:
    """Kinds of parameters by which derivatives are wanted."""

    media: dict[int, frozenset[str]]
    """of the medium with this ``id()``: ``extinction``, ``law``, ``density``, ``albedo``,
    ``phase``, ``emission``"""
    surfaces: bool
    """of some BSDF"""
    emitters: bool
    """of some emitter"""


class Twin:
    """A medium with its derivatives."""

    def __init__(self, entry: Entry, kinds: frozenset[str], leaves: Leaves) -> None:
        self.entry, self.kinds = entry, kinds
        pointer = entry.pointer
        with dr.resume_grad():
            self._constant = None
            if self.scores:
                extinction = getattr(pointer, "extinction", None)
                self._extinction = extinction or stock_extinction(pointer, entry.chromatic)
                if entry.constant:
                    self._constant = leaves.of(self._extinction(somewhere()))
            self._law = entry.model
            if "law" in kinds:
                self._law = arrays_replaced(entry.model, leaves.of)
            self._albedo = None
            if "albedo" in kinds and "albedo.value.value" in mi.traverse(pointer):
                if not mi.is_spectral:
                    self._albedo = leaves.of(
                        mi.UnpolarizedSpectrum(entry.albedo(somewhere(), True))
                    )
            self._g = None
            phase = pointer.phase_function()
            if "phase" in kinds and phase.class_name() == "HGPhaseFunction":
                self._g = leaves.of(mi.traverse(phase)["g"])
            if "density" in kinds:
                assert isinstance(entry, Walked)
                self.density = entry.density.attached(mi.traverse(pointer.sigma_t)["data"].array)

    @property
    def scores(self) -> bool:
        """Flights depend on some parameter."""
        return bool(self.kinds & {"extinction", "law", "density"})

    @property
    def jumps(self) -> bool:
        """These have densities that jump."""
        return self.scores and bool(self.entry.model.jumps)

    @property
    def model(self) -> Any:
        """The law, attached."""
        return self._law if self._law is self.entry.model else _now(self._law)

    def extinction(self, mei: Any) -> Any:
        """Extinction, attached."""
        if self._constant is None:
            return self._extinction(mei)
        return _now(self._constant)

    def albedo(self, mei: Any, active: Any) -> Any:
        """Albedo, attached."""
        if self._albedo is None:
            return self.entry.albedo(mei, active)
        return _now(self._albedo)

    def phase(self, mei: Any, direction: Any, active: Any) -> Any:
        """Value of the phase function, attached.

        That of Henyey and Greenstein is evaluated here: its one parameter is then a leaf.
        """
        if self._g is None:
            value, _ = self.entry.pointer.phase_function().eval_pdf(
                mi.PhaseFunctionContext(None), mei, direction, active
            )
            return mi.UnpolarizedSpectrum(value)
        g = _now(self._g)
        square = 1 + g * (g + 2 * dr.dot(mei.wi, direction))
        return mi.UnpolarizedSpectrum((1 - g * g) / (4 * dr.pi * square * dr.sqrt(square)))

    def flight(self, from_particle: Any, collided: Any, column: Any, mei: Any) -> Any:
        """Logarithm of a flight's density, or of its transmittance, for each channel."""
        return self._flight(self.model, self.extinction(mei), from_particle, collided, column)

    def slope(self, from_particle: Any, collided: Any, column: Any, mei: Any) -> Any:
        """Derivative of :meth:`flight` by the column, not attached."""
        model = arrays_replaced(self.entry.model, dr.detach)
        column = mi.Float(dr.detach(column))
        dr.enable_grad(column)
        extinction = dr.detach(self.extinction(mei))
        logs = self._flight(model, extinction, from_particle, collided, column)
        dr.set_grad(column, 1.0)
        return dr.detach(dr.forward_to(logs))

    @staticmethod
    def _flight(
        model: Transmittance, extinction: Any, from_particle: Any, collided: Any, column: Any
    ) -> Any:
        def of(extinction: Any) -> Any:
            tau = extinction * column
            density = dr.select(from_particle, model.pp(tau), model.fp(tau))
            survival = dr.select(from_particle, model.pf(tau), model.ff(tau))
            logs = log_or_zero(extinction) + log_or_zero(density), log_or_zero(survival)
            return dr.select(collided, *logs)

        if dr.depth_v(extinction) == 1:
            return mi.UnpolarizedSpectrum(of(extinction))
        return mi.UnpolarizedSpectrum([of(channel) for channel in extinction])

    def survival(self, from_particle: Any, column: Any, mei: Any) -> Any:
        """Logarithm of the transmittance over a column, for each channel."""
        return self.flight(from_particle, mi.Bool(False), column, mei)


class Jumps:
    """Where the density of a law's flights between collisions jumps.

    A jump by J at depth k adds J d(tau - k) g to the derivative of what a flight collects: tau is
    the optical depth of the place where it is k, and g what is collected after a collision there.
    """

    def __init__(self, pairs: Sequence[tuple[Any, Any]]) -> None:
        where, height = (_joined(part) for part in zip(*pairs, strict=True))
        self._where, self._height = where, dr.detach(height)
        self._choice = None
        if len(pairs) > 1:
            self._choice = mi.DiscreteDistribution(dr.abs(self._height) * dr.detach(where))

    def draw(self, u: Any) -> tuple[Any, Any]:
        """The depth of one of them, attached, and the height of that over its probability."""
        if self._choice is None:
            return self._where, self._height
        index, probability = self._choice.sample_pmf(u)
        where = dr.gather(mi.Float, self._where, index)
        return where, dr.gather(mi.Float, self._height, index) / probability


def _joined(numbers: Sequence[Any]) -> Any:
    if any(map(dr.is_array_v, numbers)):
        return dr.concat([mi.Float(number) for number in numbers])
    return mi.Float(np.array(numbers))


def arrays_replaced(thing: Any, replace: Callable[[Any], Any]) -> Any:
    """An array, or a copy of a law, with other arrays; those that leaves stand for are theirs."""
    if isinstance(thing, Leaf):
        return replace(thing.now)
    if dr.is_array_v(thing):
        return replace(thing)
    if isinstance(thing, tuple | list):
        items = [arrays_replaced(item, replace) for item in thing]
        return type(thing)(*items) if hasattr(thing, "_fields") else type(thing)(items)
    if isinstance(thing, Transmittance):
        twin = copy.copy(thing)
        for name, value in vars(thing).items():
            object.__setattr__(twin, name, arrays_replaced(value, replace))
        return twin
    return thing


def _now(thing: Any) -> Any:
    """The same with what leaves are at present."""
    return arrays_replaced(thing, lambda array: array)


class Leaf:
    """Stands, inside of a loop, for an array that depends on parameters."""

    def __init__(self, value: Any) -> None:
        self.value = value
        self.array = type(value)(dr.detach(value))
        dr.make_opaque(self.array)
        self.now = self.array
        """the same, attached for the present event"""


class Leaves:
    """All of these.

    Derivatives inside of a loop end there. In forward mode their tangents go in before it. In
    backward mode each path collects its own, event by event, and what all have collected is passed
    on after the loop.
    """

    def __init__(self, mode: dr.ADMode) -> None:
        self._forward = mode == dr.ADMode.Forward
        self._leaves: list[Leaf] = []

    def of(self, value: Any) -> Any:
        """The stand-in of an array, which is itself where nothing depends on parameters."""
        if not dr.grad_enabled(value):
            return value
        leaf = Leaf(value)
        if self._forward:
            dr.enable_grad(leaf.now)
            tangent = dr.forward_to(value, flags=dr.ADFlag.ClearInterior)
            dr.set_grad(leaf.now, dr.detach(tangent))
        self._leaves.append(leaf)
        return leaf

    def none(self) -> tuple[Any, ...]:
        """What a path has collected at its start, in backward mode."""
        return tuple(dr.zeros(type(leaf.array)) for leaf in self._leaves)

    def renew(self, active: Any) -> None:
        """Begin to collect, in backward mode: each path by itself (as wide as ``active``)."""
        if self._forward:
            return
        for leaf in self._leaves:
            leaf.now = dr.select(active, leaf.array, dr.ones(type(leaf.array)))
            dr.enable_grad(leaf.now)

    def collected(self, so_far: tuple[Any, ...]) -> tuple[Any, ...]:
        """What paths have collected, and what has come since :meth:`renew`."""
        found = []
        for before, leaf in zip(so_far, self._leaves, strict=True):
            found.append(before + dr.grad(leaf.now))
            dr.clear_grad(leaf.now)
        self.release()
        return tuple(found)

    def release(self) -> None:
        """Keep nothing of a loop that may have ended."""
        if not self._forward:
            for leaf in self._leaves:
                leaf.now = leaf.array

    def pass_on(self, collected: tuple[Any, ...]) -> None:
        """What all paths have collected."""
        dr.eval(collected)  # together: a sum evaluates what it adds
        gradients = [_total(dr.detach(part)) for part in collected]
        dr.eval(gradients)
        with dr.resume_grad():
            for gradient, leaf in zip(gradients, self._leaves, strict=True):
                dr.backward_from(leaf.value * gradient)


def _total(value: Any) -> Any:
    """Sum over all paths, for each channel."""
    return dr.sum(value) if dr.depth_v(value) == 1 else type(value)(*map(dr.sum, value))


# --------------------------------------------------------------------- one event


@dataclass
class Record:
    """What an event depends on; the parts that it has not are None."""

    before: Any
    """radiance collected before it"""
    flight: tuple[Any, ...] | None = None
    """location, origin, whether it collided, column, medium interaction, mask, and where it began
    and its length"""
    done: Any = None
    """the flight ends here (None: all do)"""
    weight: Any = None
    """the throughput where it began, with the balance of the channels at its end"""
    emissions: list[tuple[Any, ...]] = field(default_factory=list)
    """factor, emitter, surface, mask of each"""
    glow: tuple[Any, ...] | None = None
    """throughput, location, medium interaction, mask"""
    phase: tuple[Any, ...] | None = None
    """location, medium interaction, direction of the connection, new one, mask"""
    surface: tuple[Any, ...] | None = None
    """BSDF, surface, direction of the connection, new one, mask"""
    link: tuple[Any, ...] | None = None
    """contribution, the factor beside the value, the value, the factor beside the emitter's light,
    that as a function, mask"""
    shares: list[Callable[..., Any]] = field(default_factory=list)
    """what the transmittance of the connection depends on"""


class Adjoint:
    """Collects the derivatives of replayed paths."""

    def __init__(
        self,
        mode: dr.ADMode,
        total: Any,
        delta: Any,
        baseline: Any,
        wanted: Wanted,
    ) -> None:
        self.mode, self.total, self.delta, self.baseline = mode, total, delta, baseline
        self.wanted, self.leaves = wanted, Leaves(mode)
        self.twins: list[Twin] = []

    def begin(self, media: Media | None) -> None:
        """Look at the media of the scene, before its loop."""
        for entry in media.entries if media else ():
            kinds = self.wanted.media.get(id(entry.pointer), frozenset())
            self.twins.append(Twin(entry, kinds, self.leaves))
        if media and media.remembers and any(twin.kinds for twin in self.twins):
            raise ValueError(
                "no derivative by parameters of media in a scene with a medium that has memory: "
                "use nonexp.inverse.differences"
            )

    def start(self) -> Any:
        """The derivative that a path has collected: of the radiance, or backward by leaves."""
        return mi.Spectrum(0) if self.mode == dr.ADMode.Forward else self.leaves.none()

    @property
    def scores(self) -> bool:
        """Some flights depend on parameters."""
        return any(twin.scores for twin in self.twins)

    @property
    def forces(self) -> bool:
        """Some of these have densities that jump."""
        return any(twin.jumps for twin in self.twins)

    def jumping(self, media: Media, location: Any) -> Iterator[tuple[Twin, Any]]:
        """Their media, and the masks of the locations in them."""
        return ((twin, here) for twin, here in self._places(None, media, location) if twin.jumps)

    def _wants(self, *kinds: str) -> bool:
        return any(twin.kinds & set(kinds) for twin in self.twins)

    def add(self, tangent: Any, term: Any) -> Any:
        """Count one attached term."""
        if not dr.grad_enabled(term):
            self.leaves.release()
            return tangent
        if self.mode == dr.ADMode.Forward:
            return mi.Spectrum(tangent + dr.detach(dr.forward_to(term)))
        dr.backward_from(self.delta * term)
        return self.leaves.collected(tangent)

    def _of_media(self, kinds: set[str], media: Media, location: Any, question: Any) -> Any:
        """``question(twin, mask)`` for the medium at each location, 0 where nothing depends."""
        result: Any = mi.UnpolarizedSpectrum(0)
        for twin, here in self._places(kinds, media, location):
            result = dr.select(here, question(twin, here), result)
        return result

    def _places(
        self, kinds: set[str] | None, media: Media, location: Any
    ) -> Iterator[tuple[Twin, Any]]:
        """The media with such parameters (None: all), and the masks of the locations in them."""
        for number, twin in enumerate(self.twins, 1):
            if kinds is None or twin.kinds & kinds:
                alone = len(self.twins) == 1
                yield twin, media.inside(location) if alone else location == number

    def share(self, media: Media, mei: Any, weight: Any) -> Callable[..., Any]:
        """What counts the derivative of a transmittance, ``weight`` times its logarithm's."""

        def visit(
            tangent: Any,
            location: Any,
            from_particle: Any,
            column: Any,
            here: Any,
            start: Any,
            length: Any,
        ) -> Any:
            with dr.resume_grad():
                self.leaves.renew(here)
                column = dr.detach(dr.select(here & dr.isfinite(column), column, 1))
                line = start, -mei.wi, length
                never = mi.Bool(False)
                tangent = self._densities(
                    media, tangent, location, from_particle, never, column, mei, here, line, weight
                )
                logs = self._of_media(
                    {"extinction", "law"},
                    media,
                    location,
                    lambda twin, _: twin.survival(from_particle, column, mei),
                )
                return self.add(tangent, dr.select(here, dr.detach(weight) * logs, 0))

        return visit

    def _densities(
        self,
        media: Media,
        tangent: Any,
        location: Any,
        from_particle: Any,
        collided: Any,
        column: Any,
        mei: Any,
        here: Any,
        line: tuple[Any, Any, Any],
        weight: Any,
    ) -> Any:
        """Count derivatives by the densities of grids along a line, ``weight`` times those of the
        logarithm of a flight's density or of a transmittance."""
        for twin, within in self._places({"density"}, media, location):
            within = within & here
            slope = dr.detach(weight) * twin.slope(from_particle, collided, column, mei)
            tangent = self.spread(tangent, twin, within, slope, line)
        return tangent

    def spread(
        self, tangent: Any, twin: Twin, within: Any, slope: Any, line: tuple[Any, Any, Any]
    ) -> Any:
        """Count derivatives by the density along a line, ``slope`` times those of its integral."""
        slope = dr.select(within, slope, 0)
        o, d, length = (dr.detach(part) for part in line)
        if self.mode == dr.ADMode.Forward:
            change = walk.spread(twin.density, o, d, length, None, within)
            return mi.Spectrum(tangent + slope * change)
        counted = dr.sum(self.delta * slope)
        walk.spread(twin.density, o, d, length, counted, within & (counted != 0))
        return tangent

    def after(
        self,
        media: Media | None,
        tangent: Any,
        record: Record,
        radiance: Any,
        carried: Any,
        active: Any,
    ) -> Any:
        """Count an event of the ``active`` paths, after which ``radiance`` is collected.

        ``carried`` is the throughput at its beginning.
        """
        rest, later = self.total - record.before, self.total - radiance
        terms: Any = mi.Spectrum(0)
        with dr.resume_grad():
            self.leaves.renew(active)
            if media and record.flight and self.scores:
                location, from_particle, collided, column, mei, inside, *line = record.flight
                column = dr.detach(dr.select(inside & dr.isfinite(column), column, 1))
                scores = self._of_media(
                    {"extinction", "law"},
                    media,
                    location,
                    lambda twin, _: twin.flight(from_particle, collided, column, mei),
                )
                done = mi.Bool(True) if record.done is None else record.done
                scored = dr.select(done, rest, radiance - record.before)
                if self.baseline is not None:
                    scored -= dr.select(done, record.weight * self.baseline, 0)
                terms += dr.select(inside, dr.detach(scored) * scores, 0)
                o, length = line
                tangent = self._densities(
                    media,
                    tangent,
                    location,
                    from_particle,
                    collided,
                    column,
                    mei,
                    inside,
                    (o, -mei.wi, length),
                    scored,
                )
                ends = self._of_media(
                    {"density"},
                    media,
                    location,
                    lambda twin, mask: mi.UnpolarizedSpectrum(
                        log_or_zero(twin.density.lookup(dr.fma(-mei.wi, length, o), mask))
                    ),
                )
                terms += dr.select(inside & collided, dr.detach(scored) * ends, 0)
            if media and record.glow and self._wants("albedo", "emission"):
                throughput, location, mei, here = record.glow
                light = self._of_media(
                    {"albedo", "emission"},
                    media,
                    location,
                    lambda twin, mask: twin.entry.emitted(mei, active=here & mask),
                )
                terms += dr.select(here, dr.detach(throughput) * light, 0)
            if self.wanted.emitters:
                for factor, emitter, si, lit in record.emissions:
                    terms += dr.select(lit, dr.detach(factor) * emitter.eval(si, lit), 0)
            value = None
            if media and record.phase and self._wants("albedo", "phase"):
                terms, value = self._phase(media, record, terms, later, carried)
            if record.surface and self.wanted.surfaces:
                terms, at_surface, on = self._surface(record, terms, later)
                value = at_surface if value is None else dr.select(on, at_surface, value)
            if record.link:
                terms += self._link(record, value)
            tangent = self.add(tangent, terms)
        if record.link and self.scores:
            contribution = record.link[0]
            for share in record.shares:
                tangent = share(tangent, contribution)
        return tangent

    def _phase(
        self, media: Media, record: Record, terms: Any, later: Any, carried: Any
    ) -> tuple[Any, Any]:
        """Of collisions: by what is collected later, and the value towards the connection."""
        assert record.phase
        location, mei, wo, onward, here = record.phase
        wo, onward = dr.detach(wo), dr.detach(onward)

        def phase(direction: Any) -> Any:
            return self._of_media(
                {"albedo", "phase"},
                media,
                location,
                lambda twin, mask: twin.phase(mei, direction, here & mask),
            )

        albedo = self._of_media(
            {"albedo", "phase"}, media, location, lambda twin, mask: twin.albedo(mei, mask)
        )
        if self._wants("albedo"):
            terms += dr.select(here, dr.detach(later) * log_or_zero(albedo), 0)
        if self._wants("phase"):
            scored = later
            if self.baseline is not None:
                scored = later - carried * dr.detach(albedo) * self.baseline
            terms += dr.select(here, dr.detach(scored) * log_or_zero(phase(onward)), 0)
        touched = self._of_media(
            {"albedo", "phase"}, media, location, lambda twin, mask: mi.UnpolarizedSpectrum(1)
        )
        value = albedo * phase(wo)
        if record.link:
            value = dr.select(here & (touched[0] > 0), value, dr.detach(record.link[2]))
        return terms, value

    def _surface(self, record: Record, terms: Any, later: Any) -> tuple[Any, Any, Any]:
        """The same of surfaces."""
        assert record.surface
        bsdf, si, wo, onward, on = record.surface
        context = mi.BSDFContext()
        value = bsdf.eval(context, si, dr.detach(onward), on)
        terms += dr.select(on, dr.detach(later) * log_or_zero(value), 0)
        return terms, bsdf.eval(context, si, dr.detach(wo), on), on

    def _link(self, record: Record, value: Any) -> Any:
        """A connection, but for its transmittance."""
        assert record.link
        _, factor, _, onward, light, here = record.link
        terms: Any = mi.Spectrum(0)
        if value is not None:
            terms += dr.select(here, dr.detach(factor) * value, 0)
        if self.wanted.emitters:
            terms += dr.select(here, dr.detach(onward) * light(), 0)
        return terms


def leave_one_out(total: Any, count: int) -> Any:
    """For each path the mean radiance of the other ``count - 1`` paths of its pixel."""
    dr.eval(total)
    base = type(total)(0)
    for k in range(len(total)):
        sums = dr.block_reduce(dr.ReduceOp.Add, total[k], count)
        base[k] = (dr.repeat(sums, count) - total[k]) / (count - 1)
    return base
