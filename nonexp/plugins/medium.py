"""The medium plugins: extinction, albedo, emission, phase function and one transmittance model.

:mod:`nonexp.plugins` reloads this module for each variant.
"""

from __future__ import annotations

from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.plugins import binary, flights, grids, values
from nonexp.plugins.density import Density, Placement
from nonexp.plugins.spectra import grey, somewhere
from nonexp.system import insides
from nonexp.transmittance import Transmittance

_SHARED = ("sigma_t", "scale", "albedo", "emission", "sample_emitters", "has_spectral_extinction")


class NonexpMedium(mi.Medium):
    """What all media share. Subclasses add what extinction is made of."""

    plugin: ClassVar[str]
    own: ClassVar[tuple[str, ...]]
    """parameters beside those that all have"""
    nested: ClassVar[tuple[str, ...]] = ("transmittance", "phase_function")
    """plugins within, which check their own values"""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self._read(props)
        self.scale = mi.Float(values.number(props, "scale", 1.0))
        self.m_has_spectral_extinction = props.get("has_spectral_extinction", True)
        self._accepted: dict[str, Any] = {}  # the last values that were not refused

    def _read(self, props: mi.Properties) -> None:
        self.transmittance = self._law(props)
        self.albedo = values.volume(props, "albedo", 0.75)
        self.emission: Any = values.source(props, "emission")

    def _law(self, props: mi.Properties) -> Any:
        """The nested law. Raises ``ValueError`` for parameters that the plugin does not have."""
        names, laws = (*_SHARED, *self.own, "phase", "transmittance"), []
        for name in props.keys():
            value: Any = props[name] if props.type(name) == mi.Properties.Type.Object else None
            if hasattr(value, "model"):
                laws.append(value)
            elif name == "phase" and not isinstance(value, mi.PhaseFunction):
                raise ValueError(f"phase is {props[name]}: it must be a nested phase function")
            elif name not in names and not isinstance(value, mi.PhaseFunction):
                raise ValueError(
                    f"{self.plugin} has no parameter {name!r}: "
                    f"its parameters are {', '.join(names)}"
                )
        if len(laws) > 1:
            raise ValueError(
                f"{self.plugin} holds {len(laws)} transmittances: it must be one at most"
            )
        if "transmittance" in props and not laws:
            raise ValueError(
                f"transmittance is {props['transmittance']!r}: it must be a nested texture "
                "of type transmittance_<model>"
            )
        return laws[0] if laws else values.make("transmittance_exponential")

    # ------------------------------------------------------------- what integrators use

    density: Density | None = None
    """Density on a grid, by which :meth:`extinction` is multiplied; None if it is constant."""

    @property
    def model(self) -> Transmittance:
        """The transmittance model."""
        model: Transmittance = self.transmittance.model
        return model

    @property
    def chromatic(self) -> bool:
        """Whether extinction differs between channels or wavelengths."""
        return self._chromatic

    @property
    def oriented(self) -> bool:
        """Whether extinction depends on the direction of a ray."""
        flags = self.phase_function().flags()
        return bool(mi.has_flag(flags, mi.PhaseFunctionFlags.Microflake))

    @property
    def emits(self) -> bool:
        """Whether it emits light."""
        return self._emits

    @property
    def largest_albedo(self) -> float:
        """The largest albedo, over space and all channels or visible wavelengths."""
        return self._largest_albedo

    def extinction(self, mei: mi.MediumInteraction3f | None = None) -> Any:
        """Extinction per scene unit, where the density is 1, of a ray with direction ``-mei.wi``.

        A number, or a spectrum at ``mei.wavelengths`` if the medium is chromatic. ``mei`` is
        needed only where the medium is chromatic in a spectral variant, or oriented.
        """
        mei = somewhere() if mei is None else mei
        sigma_t = self._spectrum(mei)
        sigma_t = sigma_t if self._chromatic else sigma_t[0]
        return sigma_t * self.phase_function().projected_area(mei) if self.oriented else sigma_t

    def eval_albedo(self, mei: mi.MediumInteraction3f, active: Any = True) -> mi.Spectrum:
        """Albedo at a collision."""
        return self.albedo.eval(mei, active)

    def eval_emission(self, mei: mi.MediumInteraction3f, active: Any = True) -> mi.Spectrum:
        """Source function at a collision: the radiance of a black body of the same emission."""
        return self.emission.eval(mei, active) if self.emission else mi.UnpolarizedSpectrum(0)

    def _spectrum(self, mei: Any) -> Any:
        """Extinction over the channels, without that of oriented particles."""
        raise NotImplementedError

    # ------------------------------------------------------------- Mitsuba's parameters

    def traverse(self, callback: mi.TraversalCallback) -> None:
        callback.put("scale", self.scale, mi.ParamFlags.Differentiable)
        callback.put("albedo", self.albedo, mi.ParamFlags.Differentiable)
        callback.put("sigma_t", self.sigma_t, mi.ParamFlags.Differentiable)
        if self.emission:
            callback.put("emission", self.emission, mi.ParamFlags.Differentiable)
        callback.put("transmittance", self.transmittance, mi.ParamFlags.Differentiable)
        super().traverse(callback)

    def parameters_changed(self, keys: list[str]) -> None:
        self._check()

    def _check(self) -> None:
        """Check all values; if they are refused, restore the last accepted ones."""
        parameters = mi.traverse(self)
        own = [k for k in parameters.keys() if k.split(".")[0] not in self.nested]
        try:
            chromatic, emission = self._check_values()
        except ValueError:
            if self._accepted:
                for key, value in self._accepted.items():
                    parameters[key] = value
                parameters.update()
            raise
        self._chromatic, self._emits = chromatic, bool(np.any(emission > 0))
        dr.make_opaque(self.scale)
        # Arrays are shared until somebody changes them: this copies no grid.
        self._accepted = {key: type(parameters[key])(parameters[key]) for key in own}

    def _check_values(self) -> tuple[bool, Any]:
        """Whether extinction differs between channels or wavelengths, and the emission over them;
        ``ValueError`` if some value is refused."""
        scale = values.check_one("scale", self.scale)
        extinction = self._check_extinction(scale)
        albedo = values.values_of("albedo", self.albedo)
        values.check_range("albedo", albedo, 1.0)
        self._largest_albedo = float(albedo.max())
        emission = np.zeros(1)
        if self.emission:
            emission = values.values_of("emission", self.emission)
            values.check_range("emission", emission, dr.inf)
        values.check_microflakes(self.phase_function())
        return not grey(extinction), emission

    def _check_extinction(self, scale: Any) -> Any:
        raise NotImplementedError

    # ------------------------------------------------------------- the exponential counterpart

    def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
        return mi.Bool(True), mi.Float(0), mi.Float(dr.inf)

    def get_majorant(self, mei: mi.MediumInteraction3f, active: Any = True) -> mi.Spectrum:
        _warn_counterpart(self.plugin)
        return mi.UnpolarizedSpectrum(self.extinction(mei) * self.model.sigma_bar) & active

    def get_scattering_coefficients(
        self, mei: mi.MediumInteraction3f, active: Any = True
    ) -> tuple[mi.Spectrum, mi.Spectrum, mi.Spectrum]:
        sigma_t = self.get_majorant(mei, active)
        return sigma_t * self.eval_albedo(mei, active), mi.UnpolarizedSpectrum(0), sigma_t

    def to_string(self) -> str:
        emission = f"  emission = {self.emission},\n" if self.emission else ""
        return (
            f"{type(self).__name__}[\n"
            f"  sigma_t = {self.sigma_t},\n"
            f"{self._shown()}"
            f"  scale = {self.scale},\n"
            f"  albedo = {self.albedo},\n"
            f"{emission}"
            f"  phase_function = {self.phase_function()},\n"
            f"  transmittance = {self.transmittance}\n"
            "]"
        )

    def _shown(self) -> str:
        return ""


class NonexpHomogeneous(NonexpMedium):
    """Plugin ``nonexp_homogeneous``: a homogeneous medium with any transmittance law.

    Optical depth is ``tau = sigma_t * scale * distance``. Parameters, with the names, defaults and
    ``mi.traverse`` paths of Mitsuba's ``homogeneous``:

    ``sigma_t`` (float, rgb or spectrum, default 1)
        Extinction per scene unit, >= 0.
    ``scale`` (float, default 1)
        Factor on the extinction, >= 0.
    ``albedo`` (float, rgb, spectrum or volume, default 0.75)
        Probability of scattering at a collision, in [0, 1].
    ``emission`` (float, rgb, spectrum or volume, default none)
        Source function, a radiance >= 0: what a black body of the temperature of the particles
        emits. A collision adds ``(1 - albedo) * emission`` to the light of its path: an opaque
        medium without scattering looks like a surface of this radiance.
    ``sample_emitters`` (boolean, default true)
        Whether collisions connect to emitters directly (next-event estimation).
    nested phase function (default ``isotropic``)
        Microflakes (``sggx``) multiply the extinction of a ray by their projected area along it;
        their parameters must be constant in space.
    nested ``transmittance_<model>`` (default ``transmittance_exponential``)
        The law of transmittance over optical depth.

    Mitsuba's own integrators see the exponential medium of the same mean extinction, without its
    emission. Bad values raise ``ValueError`` when the scene is loaded and at ``params.update()``,
    which then leaves the medium as it was.
    """

    plugin = "nonexp_homogeneous"
    own = ()

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.sigma_t, self._factor = values.constant_coefficient(props, "sigma_t")
        self.m_is_homogeneous = True
        self._check()

    def _spectrum(self, mei: Any) -> Any:
        return self.sigma_t.eval(mei) * (self.scale * self._factor)

    def _check_extinction(self, scale: Any) -> Any:
        return values.check_product("sigma_t", self.sigma_t, self._factor, scale)


class NonexpHeterogeneous(NonexpMedium):
    """Plugin ``nonexp_heterogeneous``: a medium whose density varies in space, with any law.

    Extinction is ``extinction * scale * sigma_t(x)``, optical depth its integral along a ray, and
    the law applies to that: one depth is drawn per flight, and the exact integral is inverted. A
    scene written for Mitsuba's ``heterogeneous`` loads with only the type of its medium changed.
    Parameters:

    ``sigma_t`` (volume, or float, rgb or spectrum; default 1)
        Density on a grid, a ``gridvolume``: trilinear or ``nearest`` filter, any wrap mode and
        ``to_world``. All its values must be >= 0. It is zero outside of the cube that ``to_world``
        makes of the unit cube. The wrap mode only decides what interpolation sees beyond the
        outermost voxels. With three channels, these must be multiples of one grid. A
        ``constvolume`` or a value is a density that is the same everywhere.
    ``filename`` (string)
        A grid file in place of ``sigma_t``: Mitsuba's ``.vol``, NumPy's ``.npy`` or ``.npz``,
        OpenVDB's ``.vdb`` (needs ``pip install "nonexp[vdb]"``) or NanoVDB's ``.nvdb``. An array
        has the axes z, y, x and fills the unit cube; the last two know where they lie. It goes
        with ``field`` (string: name of a grid or array, where the file holds several),
        ``to_world``, ``filter_type`` and ``wrap_mode``, as of ``gridvolume``.
    ``extinction`` (float, rgb or spectrum, default 1)
        Extinction per scene unit where the density is 1; a colour makes it differ between channels.
    ``scale`` (float, default 1)
        Factor on the extinction, >= 0.
    ``tracking`` (``auto``, ``regular`` or ``delta``, default ``auto``)
        How flights and shadow rays pass the grid. ``regular``: a walk from cell to cell, exact, for
        any law. ``delta``: an extinction drawn per flight, and null collisions; for laws that are
        mixtures of exponentials (``exponential``, ``gamma``, ``exponential_mixture``, ``ensemble``
        and mixtures of these). Both give the same image; ``auto`` takes what is faster, which
        ``nonexp info`` shows.
    ``albedo``, ``emission``, ``sample_emitters``, phase function, ``transmittance_<model>``
        As of ``nonexp_homogeneous``.

    Mitsuba's own integrators see the exponential medium of the same mean extinction, without its
    emission. Bad values raise ``ValueError`` when the scene is loaded and at ``params.update()``,
    which then leaves the medium as it was.
    """

    plugin = "nonexp_heterogeneous"
    own = ("extinction", "tracking", *grids.PARAMETERS)

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.sigma_t, factor = grids.density_volume(props)
        self.coefficient, own = values.constant_coefficient(props, "extinction")
        self._factor = factor * own
        self._ratios, self._most = np.ones(1), 1.0
        self._seen: tuple[int, ...] = ()
        self._placement: Placement | None = None
        self._prepared: Any = None
        self.choice = flights.Choice(None, None, "")
        self._wanted = values.choice(props, "tracking", flights.TRACKING)
        if self.sigma_t.class_name() == "GridVolume":
            grids.check_density(self.sigma_t)
            self._placement = Placement.of(self.sigma_t)
        self.m_is_homogeneous = self._placement is None
        self._check()

    def _spectrum(self, mei: Any) -> Any:
        spectrum = self.coefficient.eval(mei) * (self.scale * self._factor)
        if self._placement is None:
            return spectrum * self.sigma_t.eval(mei)
        if len(self._ratios) == 1:
            return spectrum
        return spectrum * mi.UnpolarizedSpectrum(*map(float, self._ratios))

    def traverse(self, callback: mi.TraversalCallback) -> None:
        super().traverse(callback)
        callback.put("extinction", self.coefficient, mi.ParamFlags.Differentiable)

    def _check_extinction(self, scale: Any) -> Any:
        extinction = values.check_product("extinction", self.coefficient, self._factor, scale)
        if self._placement is None:
            return extinction * values.check_product("sigma_t", self.sigma_t, 1.0, scale)
        data = mi.traverse(self.sigma_t)["data"]
        if insides.variables(data) != self._seen:
            most = grids.check_density(self.sigma_t)
            channel, ratios = grids.channels_of(self.sigma_t)
            self.density = Density(self.sigma_t, self._placement, channel)
            self._ratios, self._most = ratios, most
            self._seen = insides.variables(data)
        with np.errstate(over="ignore"):
            product = np.float32(scale * self._most) * extinction.astype(np.float32)
            values.check_range("sigma_t * extinction * scale", product, dr.inf)
        self._prepare(extinction * self._ratios.max())
        if len(self._ratios) == 1:
            return extinction
        return extinction.reshape(len(self._ratios), -1) * self._ratios[:, None]

    @property
    def most(self) -> float:
        """The largest density."""
        return self._most

    @property
    def ratios(self) -> Any:
        """The channels of the grid as multiples of its density."""
        return self._ratios

    @property
    def tracked(self) -> bool:
        """Flights draw an extinction and null collisions; else they walk through the grid."""
        return self.choice.extinctions is not None

    def _prepare(self, extinction: Any) -> None:
        """What integrators need to know of the law and the grid, made as often as these change."""
        assert self.density is not None
        largest = float(extinction.max() * np.array(self.scale)[0])
        choice = flights.Choice.of(self._wanted, self.density, self.model, largest)
        changed = self._prepared is not self.model or self.tracked != bool(choice.extinctions)
        self.choice = choice
        if changed:
            self._prepared = self.model
            self.reach = dr.opaque(mi.Float, flights.reach(self.model))
            self.mixing = flights.mixing(choice.extinctions) if choice.extinctions else (None, None)
        # Where functions are frozen Dr.Jit looks for what they read here.
        tables = [array for law in self.mixing if law for array in law.arrays(mi.Float)]
        bounds = choice.bounds.arrays() if choice.bounds else []
        self._held = [*self.density.arrays(), self.reach, *tables, *bounds]

    def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
        if self.density is None:
            return super().intersect_aabb(ray)
        return self.sigma_t.bbox().ray_intersect(ray)

    def get_majorant(self, mei: mi.MediumInteraction3f, active: Any = True) -> mi.Spectrum:
        return super().get_majorant(mei, active) * self._most

    def get_scattering_coefficients(
        self, mei: mi.MediumInteraction3f, active: Any = True
    ) -> tuple[mi.Spectrum, mi.Spectrum, mi.Spectrum]:
        majorant = self.get_majorant(mei, active)
        if self.density is None:
            return majorant * self.eval_albedo(mei, active), mi.UnpolarizedSpectrum(0), majorant
        share = self.density.lookup(mei.p, active) / self._most
        sigma_t = majorant * share
        return sigma_t * self.eval_albedo(mei, active), majorant - sigma_t, sigma_t

    def _shown(self) -> str:
        return f"  extinction = {self.coefficient},\n"


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
    medium as it was. Images have no derivatives by these parameters.
    """

    plugin = "nonexp_binary_mixture"
    own = ()
    nested = ("phase_function", "phase_0", "phase_1")
    remembers = True
    """A path carries its material."""

    def __init__(self, props: mi.Properties) -> None:
        binary.check_names(props, self.plugin)
        phases = binary.phases(props)
        self._blend = None
        if len(phases) == 2:
            # A medium of Mitsuba's has one phase function: that of the exponential counterpart.
            self._blend = values.make("blendphase", weight=0.5, a=phases[0], b=phases[1])
            props["phase"] = self._blend
        super().__init__(props)
        self.phases = phases or (self.phase_function(),)
        self.m_is_homogeneous = True
        self._check()

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
        flag = mi.ParamFlags.NonDifferentiable
        callback.put("scale", self.scale, flag)
        for name in ("sigma_t", "chord", "albedo", "emission"):
            for i, value in enumerate(getattr(self, name)):
                if value is not None:
                    callback.put(f"{name}_{i}", value, flag)
        for i, phase in enumerate(self.phases):
            callback.put(f"phase_{i}" if self._blend else "phase_function", phase, flag)

    def _check_values(self) -> tuple[bool, Any]:
        scale = values.check_one("scale", self.scale)
        extinctions, emissions, shares, largest = [], [np.zeros(1)], [], 0.0
        for i in (0, 1):
            extinctions.append(
                values.check_product(f"sigma_t_{i}", self.sigma_t[i], self._factor[i], scale)
            )
            chord = binary.check_chord(f"chord_{i}", self.chord[i])
            shares.append(chord)
            name = f"albedo_{i}"
            albedo = values.values_of(name, self.albedo[i])
            values.check_range(name, albedo, 1.0)
            largest = max(largest, float(albedo.max()))
            if self.emission[i] is not None:
                name = f"emission_{i}"
                emissions.append(values.values_of(name, self.emission[i]))
                values.check_range(name, emissions[-1], dr.inf)
        binary.check_phases(self.phases, self.plugin)
        if self._blend:
            self._blend_phases(extinctions, np.array(shares))
        self._largest_albedo = largest
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
        _warn_counterpart(self.plugin)
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


_warned = False


def _warn_counterpart(plugin: str) -> None:
    global _warned
    if not _warned:
        _warned = True
        mi.Log(
            mi.LogLevel.Warn,
            f"A Mitsuba integrator asked {plugin} for its coefficients: if this medium is "
            "in the rendered scene, it shows its exponential counterpart of the same mean "
            "extinction. Use the integrator nonexp_volpath for the medium's own law.",
        )
