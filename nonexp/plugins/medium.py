"""The medium plugin: extinction, albedo, phase function and one transmittance model.

:mod:`nonexp.plugins` reloads this module for each variant.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.plugins.spectra import grey, somewhere, visible
from nonexp.system.insides import nested
from nonexp.system.machine import supported
from nonexp.transmittance import Transmittance

_PARAMETERS = (
    "sigma_t",
    "scale",
    "albedo",
    "sample_emitters",
    "has_spectral_extinction",
    "phase",
    "transmittance",
)


class NonexpHomogeneous(mi.Medium):
    """Plugin ``nonexp_homogeneous``: a homogeneous medium with any transmittance law.

    Optical depth is ``tau = sigma_t * scale * distance``. Parameters, with the names, defaults and
    ``mi.traverse`` paths of Mitsuba's ``homogeneous``:

    ``sigma_t`` (float, rgb or spectrum, default 1)
        Extinction per scene unit, >= 0.
    ``scale`` (float, default 1)
        Factor on the extinction, >= 0.
    ``albedo`` (float, rgb, spectrum or volume, default 0.75)
        Probability of scattering at a collision, in [0, 1].
    ``sample_emitters`` (boolean, default true)
        Whether collisions connect to emitters directly (next-event estimation).
    nested phase function (default ``isotropic``)
        Microflakes (``sggx``) multiply the extinction of a ray by their projected area along it;
        their parameters must be constant in space.
    nested ``transmittance_<model>`` (default ``transmittance_exponential``)
        The law of transmittance over optical depth.

    Mitsuba's own integrators see the exponential medium of the same mean extinction. Bad values
    raise ``ValueError`` when the scene is loaded and at ``params.update()``, which then leaves the
    medium as it was.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        laws = []
        for name in props.keys():
            value: Any = props[name] if props.type(name) == mi.Properties.Type.Object else None
            if hasattr(value, "model"):
                laws.append(value)
            elif name == "phase" and not isinstance(value, mi.PhaseFunction):
                raise ValueError(f"phase is {props[name]}: it must be a nested phase function")
            elif name not in _PARAMETERS and not isinstance(value, mi.PhaseFunction):
                raise ValueError(
                    f"nonexp_homogeneous has no parameter {name!r}: "
                    f"its parameters are {', '.join(_PARAMETERS)}"
                )
        if len(laws) > 1:
            raise ValueError(
                f"nonexp_homogeneous holds {len(laws)} transmittances: it must be one at most"
            )
        if "transmittance" in props and not laws:
            raise ValueError(
                f"transmittance is {props['transmittance']!r}: it must be a nested texture "
                "of type transmittance_<model>"
            )

        self.transmittance = laws[0] if laws else _make("transmittance_exponential")
        self.scale = mi.Float(_number(props, "scale", 1.0))
        self.sigma_t, self._factor = _extinction_volume(props)
        self.albedo = _volume(props, "albedo", 0.75)
        self.m_is_homogeneous = True
        self.m_has_spectral_extinction = props.get("has_spectral_extinction", True)
        self._accepted: dict[str, Any] = {}  # the last values that were not refused
        self._check()

    # ------------------------------------------------------------- what integrators use

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

    def extinction(self, mei: mi.MediumInteraction3f | None = None) -> Any:
        """Extinction per scene unit, ``sigma_t * scale``, of a ray with the direction ``-mei.wi``.

        A number, or a spectrum at ``mei.wavelengths`` if the medium is chromatic. ``mei`` is
        needed only where the medium is chromatic in a spectral variant, or oriented.
        """
        mei = somewhere() if mei is None else mei
        sigma_t = self.sigma_t.eval(mei) * (self.scale * self._factor)
        sigma_t = sigma_t if self._chromatic else sigma_t[0]
        return sigma_t * self.phase_function().projected_area(mei) if self.oriented else sigma_t

    def eval_albedo(self, mei: mi.MediumInteraction3f, active: Any = True) -> mi.Spectrum:
        """Albedo at a collision."""
        return self.albedo.eval(mei, active)

    # ------------------------------------------------------------- Mitsuba's parameters

    def traverse(self, callback: mi.TraversalCallback) -> None:
        callback.put("scale", self.scale, mi.ParamFlags.Differentiable)
        callback.put("albedo", self.albedo, mi.ParamFlags.Differentiable)
        callback.put("sigma_t", self.sigma_t, mi.ParamFlags.Differentiable)
        callback.put("transmittance", self.transmittance, mi.ParamFlags.Differentiable)
        super().traverse(callback)

    def parameters_changed(self, keys: list[str]) -> None:
        self._check()

    def _check(self) -> None:
        """Check all values; if they are refused, restore the last accepted ones."""
        parameters = mi.traverse(self)
        own = [k for k in parameters.keys() if k.split(".")[0] in ("scale", "sigma_t", "albedo")]
        try:
            scale = np.array(self.scale)
            sigma_t = _spectrum_of("sigma_t", self.sigma_t) * self._factor
            if scale.size != 1:
                raise ValueError(f"scale holds {scale.size} numbers: it must be one")
            _check_range("scale", scale, dr.inf)
            _check_range("sigma_t", sigma_t, dr.inf)
            with np.errstate(over="ignore"):
                _check_range("sigma_t * scale", sigma_t * scale, dr.inf)
            _check_range("albedo", _values_of("albedo", self.albedo), 1.0)
            _check_microflakes(self.phase_function())
        except ValueError:
            if self._accepted:
                for key, value in self._accepted.items():
                    parameters[key] = value
                parameters.update()
            raise
        self._chromatic = not grey(sigma_t)
        dr.make_opaque(self.scale)
        self._accepted = {key: type(parameters[key])(parameters[key]) for key in own}

    # ------------------------------------------------------------- the exponential counterpart

    def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
        return mi.Bool(True), mi.Float(0), mi.Float(dr.inf)

    def get_majorant(self, mei: mi.MediumInteraction3f, active: Any = True) -> mi.Spectrum:
        _warn_counterpart()
        return mi.UnpolarizedSpectrum(self.extinction(mei) * self.model.sigma_bar) & active

    def get_scattering_coefficients(
        self, mei: mi.MediumInteraction3f, active: Any = True
    ) -> tuple[mi.Spectrum, mi.Spectrum, mi.Spectrum]:
        sigma_t = self.get_majorant(mei, active)
        return sigma_t * self.eval_albedo(mei, active), mi.UnpolarizedSpectrum(0), sigma_t

    def to_string(self) -> str:
        return (
            "NonexpHomogeneous[\n"
            f"  sigma_t = {self.sigma_t},\n"
            f"  scale = {self.scale},\n"
            f"  albedo = {self.albedo},\n"
            f"  phase_function = {self.phase_function()},\n"
            f"  transmittance = {self.transmittance}\n"
            "]"
        )


# --------------------------------------------------------------------------------------------------


def _make(plugin: str, **values: Any) -> Any:
    """An instance of a plugin. Not by ``mi.load_dict``, which replaces the global file resolver
    meanwhile: scenes load in parallel, and other plugins would not find their files.
    """
    props = mi.Properties(plugin)
    for name, value in values.items():
        props[name] = value
    return mi.PluginManager.instance().create_object(props)


def _number(props: mi.Properties, name: str, default: float) -> float:
    value = props.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{name} is {value!r}: it must be a number")
    return float(value)


def _volume(props: mi.Properties, name: str, default: float) -> mi.Volume:
    """A nested volume as it is; anything else as the value of a ``constvolume``, as in Mitsuba."""
    if name not in props:
        return _make("constvolume", value=default)
    if props.type(name) == mi.Properties.Type.Object and isinstance(props[name], mi.Volume):
        volume = props[name]
    else:
        _check_literal(props, name)
        volume = _make("constvolume", value=props.get_unbounded_texture(name))
    textures = nested(volume, mi.Texture) if volume.class_name() == "ConstVolume" else []
    if varying := [texture for texture in textures if texture.is_spatially_varying()]:
        raise ValueError(
            f"{name} is a {varying[0].class_name()}, which varies over a surface: "
            "it must be a number, rgb, spectrum or volume"
        )
    return volume


def _extinction_volume(props: mi.Properties) -> tuple[mi.Volume, float]:
    """The volume of ``sigma_t``, and a factor on its values."""
    if mi.is_spectral and "sigma_t" in props and props.type("sigma_t") == mi.Properties.Type.Color:
        # Mitsuba converts an rgb colour to a spectrum only within [0, 1]; grey needs no spectrum.
        rgb = np.array(props["sigma_t"], dtype=float).ravel()
        _check_range("sigma_t", rgb, dr.inf)
        if grey(rgb):
            return _make("constvolume", value=float(rgb[0])), 1.0
        factor = max(1.0, float(rgb.max()))
        return _make("constvolume", value=mi.ScalarColor3f(*(rgb / factor))), factor
    volume = _volume(props, "sigma_t", 1.0)
    if volume.class_name() != "ConstVolume":
        raise ValueError(f"sigma_t is a {volume.class_name()}: it must be constant in space")
    return volume, 1.0


def _check_literal(props: mi.Properties, name: str) -> None:
    """Check numbers before Mitsuba turns them into spectra, which clamp or misreport them."""
    upper = 1.0 if name == "albedo" else dr.inf
    kind = props.type(name)
    if kind in (mi.Properties.Type.Color, mi.Properties.Type.Float, mi.Properties.Type.Integer):
        _check_range(name, np.array(props[name], dtype=float).ravel(), upper)
    elif kind not in (mi.Properties.Type.Spectrum, mi.Properties.Type.Object):
        raise ValueError(f"{name} is {props[name]!r}: it must be a number, rgb, spectrum or volume")


def _check_range(name: str, values: Any, upper: float) -> None:
    bad = values[~((values >= 0) & (values <= upper) & np.isfinite(values))]
    if bad.size:
        allowed = "a finite number >= 0" if upper == dr.inf else f"within [0, {upper:g}]"
        raise ValueError(f"{name} is {bad.flat[0]:g}: it must be {allowed}")


def _check_microflakes(phase: mi.PhaseFunction) -> None:
    if not mi.has_flag(phase.flags(), mi.PhaseFunctionFlags.Microflake):
        return
    for name, value in mi.traverse(phase):
        values = np.array(value)
        if values.ndim > 1 and not np.all(values == values.reshape(-1, values.shape[-1])[0]):
            raise ValueError(f"phase.{name} varies in space: in a homogeneous medium it must not")


def _spectrum_of(name: str, volume: mi.Volume) -> Any:
    """Values over the channels, or over the visible wavelengths."""
    try:
        return np.array(dr.detach(volume.eval(visible())))
    except RuntimeError as error:
        if mi.is_spectral:
            raise
        kinds = ", ".join(texture.class_name() for texture in nested(volume, mi.Texture))
        spectral = ", ".join(v for v in mi.variants() if "spectral" in v and supported(v))
        raise ValueError(
            f"{name} is a spectrum over wavelengths ({kinds}), of which variant {mi.variant()} "
            f"has none: give a number or rgb, or use {spectral}"
        ) from error


def _values_of(name: str, volume: mi.Volume) -> Any:
    """All values that a volume is made of."""
    parameters = mi.traverse(volume)
    if "data" in parameters:
        return np.array(dr.detach(parameters["data"]))
    return _spectrum_of(name, volume)


_warned = False


def _warn_counterpart() -> None:
    global _warned
    if not _warned:
        _warned = True
        mi.Log(
            mi.LogLevel.Warn,
            "A Mitsuba integrator asked nonexp_homogeneous for its coefficients: if this medium is "
            "in the rendered scene, it shows its exponential counterpart of the same mean "
            "extinction. Use the integrator nonexp_volpath for the medium's own law.",
        )
