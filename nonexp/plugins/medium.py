"""The medium plugins: extinction, albedo, emission, phase function and one transmittance model.

:mod:`nonexp.plugins` reloads this module for each variant.
"""

from __future__ import annotations

from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.plugins import flights, grids, values
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
        values.check_range("albedo", values.values_of("albedo", self.albedo), 1.0)
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
        warn_counterpart(self.plugin)
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
        self.choice = flights.Choice(None, "")
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
    def tracked(self) -> bool:
        """Flights draw an extinction and null collisions; else they walk through the grid."""
        return self.choice.extinctions is not None

    def _prepare(self, extinction: Any) -> None:
        """What integrators need to know of the law and the grid, made as often as these change."""
        assert self.density is not None
        largest = float(extinction.max() * np.array(self.scale)[0])
        choice = flights.Choice.of(self._wanted, self.density, self.model, largest)
        if self._prepared is not self.model or self.choice.reason != choice.reason:
            self._prepared, self.choice = self.model, choice
            self.reach = dr.opaque(mi.Float, flights.reach(self.model))
            self.mixing = flights.mixing(choice.extinctions) if choice.extinctions else (None, None)
        # Where functions are frozen Dr.Jit looks for what they read here.
        tables = [array for law in self.mixing if law for array in law.arrays(mi.Float)]
        self._held = [*self.density.arrays(), self.reach, *tables]

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


_warned = False


def warn_counterpart(plugin: str) -> None:
    global _warned
    if not _warned:
        _warned = True
        mi.Log(
            mi.LogLevel.Warn,
            f"A Mitsuba integrator asked {plugin} for its coefficients: if this medium is "
            "in the rendered scene, it shows its exponential counterpart of the same mean "
            "extinction. Use the integrator nonexp_volpath for the medium's own law.",
        )
