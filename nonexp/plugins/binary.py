"""The medium plugin of two materials with memory.

:mod:`nonexp.plugins` reloads this module for each variant.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.plugins import values
from nonexp.plugins.medium import NonexpMedium, warn_counterpart
from nonexp.plugins.spectra import grey, somewhere

_PAIRS = ("sigma_t", "albedo", "chord", "emission", "phase")
_OTHERS = ("scale", "sample_emitters", "has_spectral_extinction")
_CHORDS = 1e-30, 1e30


class NonexpBinaryMixture(NonexpMedium):
    """Plugin ``nonexp_binary_mixture``: a random mixture of two materials, with memory.

    Along a ray two exponential materials alternate in chords of independent, exponentially
    distributed lengths (a Markov mixture). A path carries its material from one collision to the
    next: the material changes along the ray, never at a collision. This is chord-length sampling,
    alias the Levermore-Pomraning model. A path that enters through a boundary or leaves a surface
    is in material i with the probability of its share of the volume,
    ``chord_i / (chord_0 + chord_1)``: so far transmittance is that of
    ``exponential_mixture`` by ``ExponentialMixture.levermore``. Parameters, each of the first five
    a pair: a string "a, b", or one for each material, with ``_0`` and ``_1`` behind its name, or
    one for both:

    ``sigma_t`` (float, rgb or spectrum; no default)
        Extinction of a material per scene unit, >= 0. 0 is void.
    ``chord`` (float, no default)
        Mean length of the chords in a material, in scene units, within [1e-30, 1e30].
    ``albedo`` (float, rgb, spectrum or volume, default 0.75)
        Probability of scattering at a collision, in [0, 1].
    ``emission`` (float, rgb, spectrum or volume, default none)
        Source function, a radiance >= 0, as of ``nonexp_homogeneous``.
    nested phase functions ``phase_0`` and ``phase_1``, or one (default ``isotropic``)
        Not microflakes.
    ``scale`` (float, default 1)
        Factor on both extinctions, >= 0; not on the chords.
    ``sample_emitters`` (boolean, default true)
        Whether collisions connect to emitters directly (next-event estimation).

    Mitsuba's own integrators see the exponential medium of the same mean extinction and mean
    scattering (chords so short that they cannot be told apart), without its emission. Bad values
    raise ``ValueError`` when the scene is loaded and at ``params.update()``, which then leaves the
    medium as it was.
    """

    plugin = "nonexp_binary_mixture"
    own = ()
    nested = ("phase_function", "phase_0", "phase_1")
    remembers = True
    """A path carries its material."""

    def __init__(self, props: mi.Properties) -> None:
        self._check_names(props)
        phases = _phases(props)
        self._blend = None
        if len(phases) == 2:
            # A medium of Mitsuba's has one phase function: that of the exponential counterpart.
            self._blend = values.make("blendphase", weight=0.5, a=phases[0], b=phases[1])
            props["phase"] = self._blend
        super().__init__(props)
        self.phases = phases or (self.phase_function(),)
        self.m_is_homogeneous = True
        self._check()

    def _check_names(self, props: mi.Properties) -> None:
        names = (*_PAIRS, *_OTHERS)
        allowed = {*names, *(f"{pair}_{i}" for pair in _PAIRS for i in (0, 1))}
        for name in props.keys():
            found = props[name] if props.type(name) == mi.Properties.Type.Object else None
            phase = isinstance(found, mi.PhaseFunction)
            if name.startswith("phase") and name in allowed and not phase:
                raise ValueError(f"{name} is {props[name]}: it must be a nested phase function")
            if name not in allowed and not phase:
                raise ValueError(
                    f"{self.plugin} has no parameter {name!r}: its parameters are "
                    f"{', '.join(names)}"
                )
        for name in ("sigma_t", "chord"):
            if name not in props and f"{name}_0" not in props and f"{name}_1" not in props:
                raise ValueError(
                    f'{name} is missing: it must be two numbers, as in "0.2, 1.8", '
                    f"or {name}_0 and {name}_1"
                )

    def _read(self, props: mi.Properties) -> None:
        extinctions = [values.constant_coefficient(props, n) for n in values.pair(props, "sigma_t")]
        self.sigma_t = tuple(volume for volume, _ in extinctions)
        self._factor = tuple(factor for _, factor in extinctions)
        self.chord = tuple(
            mi.Float(values.number(props, name, 1.0)) for name in values.pair(props, "chord")
        )
        self.albedo = tuple(values.volume(props, n, 0.75) for n in values.pair(props, "albedo"))
        self.emission = tuple(values.source(props, n) for n in values.pair(props, "emission"))

    # ------------------------------------------------------------- what integrators use

    def extinctions(self, mei: mi.MediumInteraction3f | None = None) -> tuple[Any, Any]:
        """Extinction of each material: numbers, or spectra if the medium is chromatic."""
        mei = somewhere() if mei is None else mei
        found = [
            volume.eval(mei) * (self.scale * factor)
            for volume, factor in zip(self.sigma_t, self._factor, strict=True)
        ]
        return (found[0], found[1]) if self.chromatic else (found[0][0], found[1][0])

    @property
    def shares(self) -> tuple[Any, Any]:
        """Share of the volume of each material."""
        total = self.chord[0] + self.chord[1]
        return self.chord[0] / total, self.chord[1] / total

    @property
    def oriented(self) -> bool:
        return False

    def extinction(self, mei: mi.MediumInteraction3f | None = None) -> Any:
        """Mean extinction."""
        return self._mean(self.extinctions(mei))

    def eval_albedo(self, mei: mi.MediumInteraction3f, active: Any = True) -> mi.Spectrum:
        """Mean albedo, over all collisions."""
        sigma_t = self.extinctions(mei)
        albedo = [volume.eval(mei, active) for volume in self.albedo]
        mean = mi.UnpolarizedSpectrum(self._mean(sigma_t))
        scattered = self._mean(tuple(s * a for s, a in zip(sigma_t, albedo, strict=True)))
        return dr.select(mean > 0, scattered / mean, 0)

    def eval_albedo_of(self, second: Any, mei: mi.MediumInteraction3f, active: Any = True) -> Any:
        """Albedo at a collision in the first or the ``second`` material."""
        first, other = (volume.eval(mei, active) for volume in self.albedo)
        return dr.select(second, other, first)

    def eval_emission_of(self, second: Any, mei: mi.MediumInteraction3f, active: Any = True) -> Any:
        """Source function at a collision in the first or the ``second`` material."""
        if self.emission[0] is None:
            return mi.UnpolarizedSpectrum(0)
        first, other = (volume.eval(mei, active) for volume in self.emission)
        return dr.select(second, other, first)

    def _mean(self, pair: tuple[Any, Any]) -> Any:
        return self.shares[0] * pair[0] + self.shares[1] * pair[1]

    # ------------------------------------------------------------- Mitsuba's parameters

    def traverse(self, callback: mi.TraversalCallback) -> None:
        flag = mi.ParamFlags.Differentiable
        callback.put("scale", self.scale, flag)
        for name in ("sigma_t", "chord", "albedo", "emission"):
            for i, value in enumerate(getattr(self, name)):
                if value is not None:
                    callback.put(f"{name}_{i}", value, flag)
        for i, phase in enumerate(self.phases):
            callback.put(f"phase_{i}" if self._blend else "phase_function", phase, flag)

    def _check_values(self) -> tuple[bool, Any]:
        scale = values.check_one("scale", self.scale)
        extinctions, emissions, shares = [], [np.zeros(1)], []
        for i in (0, 1):
            extinctions.append(
                values.check_product(f"sigma_t_{i}", self.sigma_t[i], self._factor[i], scale)
            )
            name, (least, most) = f"chord_{i}", _CHORDS
            chord = values.check_one(name, self.chord[i])
            if not least <= chord.item() <= most:
                raise ValueError(
                    f"{name} is {chord.item():g}: it must be within [{least:g}, {most:g}]"
                )
            shares.append(chord.item())
            name = f"albedo_{i}"
            values.check_range(name, values.values_of(name, self.albedo[i]), 1.0)
            if self.emission[i] is not None:
                name = f"emission_{i}"
                emissions.append(values.values_of(name, self.emission[i]))
                values.check_range(name, emissions[-1], dr.inf)
        for phase in self.phases:
            if mi.has_flag(phase.flags(), mi.PhaseFunctionFlags.Microflake):
                raise ValueError(
                    f"phase is a {phase.class_name()}: in {self.plugin} it must not be a microflake"
                )
        if self._blend:
            self._blend_phases(extinctions, np.array(shares))
        chromatic = not all(map(grey, extinctions))
        return chromatic, np.concatenate([np.ravel(values) for values in emissions])

    def _blend_phases(self, extinctions: list[Any], shares: Any) -> None:
        """The mean phase function of all scattering, for the exponential counterpart."""
        scattering = [
            shares[i]
            * np.mean(extinctions[i])
            * np.mean(values.values_of(f"albedo_{i}", self.albedo[i]))
            for i in (0, 1)
        ]
        parameters = mi.traverse(self._blend)
        total = sum(scattering)
        parameters["weight.value.value"] = scattering[1] / total if total > 0 else 0.5
        parameters.update()

    # ------------------------------------------------------------- the exponential counterpart

    def get_majorant(self, mei: mi.MediumInteraction3f, active: Any = True) -> mi.Spectrum:
        warn_counterpart(self.plugin)
        return mi.UnpolarizedSpectrum(self.extinction(mei)) & active

    def to_string(self) -> str:
        def shown(name: str) -> str:
            pair = getattr(self, name)
            return "".join(f"  {name}_{i} = {value},\n" for i, value in enumerate(pair))

        emission = shown("emission") if self.emission[0] is not None else ""
        phases = ", ".join(str(phase) for phase in self.phases)
        return (
            f"{type(self).__name__}[\n{shown('sigma_t')}{shown('chord')}{shown('albedo')}"
            f"{emission}  scale = {self.scale},\n  phase_functions = {phases}\n]"
        )


def _phases(props: mi.Properties) -> tuple[Any, ...]:
    """The phase functions of the two materials, taken out of ``props``; none if it is one or no
    phase function for both."""
    found = [
        name
        for name in list(props.keys())
        if props.type(name) == mi.Properties.Type.Object
        and isinstance(props[name], mi.PhaseFunction)
    ]
    own = [name for name in ("phase_0", "phase_1") if name in found]
    if len(own) == 1:
        missing = "phase_1" if own == ["phase_0"] else "phase_0"
        raise ValueError(f"{own[0]} is given without {missing}: both must be")
    if own and len(found) > 2:
        other = next(name for name in found if name not in own)
        raise ValueError(f"{other} and {own[0]} are given: it must be one of them")
    phases = tuple(props[name] for name in own)
    for name in own:
        del props[name]
    return phases
