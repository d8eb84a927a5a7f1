"""Reading and checking the parameters of media."""

from __future__ import annotations

import re
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.plugins.spectra import grey, visible
from nonexp.system.insides import nested
from nonexp.system.machine import supported

__all__ = [
    "check_microflakes",
    "check_one",
    "check_product",
    "check_range",
    "choice",
    "coefficient",
    "constant_coefficient",
    "make",
    "number",
    "pair",
    "source",
    "spectrum_of",
    "values_of",
    "volume",
]


def make(plugin: str, **values: Any) -> Any:
    """An instance of a plugin. Not by ``mi.load_dict``, which replaces the global file resolver
    meanwhile: scenes load in parallel, and other plugins would not find their files.
    """
    props = mi.Properties(plugin)
    for name, value in values.items():
        props[name] = value
    return mi.PluginManager.instance().create_object(props)


def number(props: mi.Properties, name: str, default: float) -> float:
    value = props.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{name} is {value!r}: it must be a number")
    return float(value)


def choice(props: mi.Properties, name: str, allowed: tuple[str, ...]) -> str:
    """One of some words, the first by default."""
    value = props.get(name, allowed[0])
    if value not in allowed:
        raise ValueError(
            f"{name} is {value!r}: it must be {', '.join(allowed[:-1])} or {allowed[-1]}"
        )
    return str(value)


def pair(props: mi.Properties, name: str) -> tuple[str, str]:
    """Names of two parameters, ``name_0`` and ``name_1``, or twice ``name``, which is then one for
    both. A string "a, b" becomes the former."""
    own = f"{name}_0", f"{name}_1"
    given = [one for one in own if one in props]
    if name in props and given:
        raise ValueError(f"{name} and {given[0]} are given: it must be one of them")
    if len(given) == 1:
        missing = own[1 - own.index(given[0])]
        raise ValueError(f"{given[0]} is given without {missing}: both must be")
    if name in props and isinstance(props[name], str):
        words = [word for word in re.split(r"[\s,;]+", props[name].strip()) if word]
        try:
            first, second = map(float, words)
        except ValueError:
            raise ValueError(
                f'{name} is {props[name]!r}: it must be two numbers, as in "0.2, 1.8"'
            ) from None
        del props[name]
        props[own[0]], props[own[1]] = first, second
        return own
    return own if given else (name, name)


def volume(props: mi.Properties, name: str, default: float) -> mi.Volume:
    """A nested volume as it is; anything else as the value of a ``constvolume``, as in Mitsuba."""
    if name not in props:
        return make("constvolume", value=default)
    if props.type(name) == mi.Properties.Type.Object and isinstance(props[name], mi.Volume):
        found = props[name]
    else:
        check_literal(props, name)
        found = make("constvolume", value=props.get_unbounded_texture(name))
    textures = nested(found, mi.Texture) if found.class_name() == "ConstVolume" else []
    if varying := [texture for texture in textures if texture.is_spatially_varying()]:
        raise ValueError(
            f"{name} is a {varying[0].class_name()}, which varies over a surface: "
            "it must be a number, rgb, spectrum or volume"
        )
    return found


def coefficient(props: mi.Properties, name: str) -> tuple[mi.Volume, float]:
    """The volume of an extinction (default 1), and a factor on its values."""
    if mi.is_spectral and name in props and props.type(name) == mi.Properties.Type.Color:
        # Mitsuba converts an rgb colour to a spectrum only within [0, 1]; grey needs no spectrum.
        rgb = np.array(props[name], dtype=float).ravel()
        check_range(name, rgb, dr.inf)
        if grey(rgb):
            return make("constvolume", value=float(rgb[0])), 1.0
        factor = max(1.0, float(rgb.max()))
        return make("constvolume", value=mi.ScalarColor3f(*(rgb / factor))), factor
    return volume(props, name, 1.0), 1.0


def constant_coefficient(props: mi.Properties, name: str) -> tuple[mi.Volume, float]:
    """:func:`coefficient`; ``ValueError`` where it varies in space."""
    found, factor = coefficient(props, name)
    if found.class_name() != "ConstVolume":
        raise ValueError(f"{name} is a {found.class_name()}: it must be constant in space")
    return found, factor


def source(props: mi.Properties, name: str) -> mi.Volume | None:
    """The volume of a radiance; None if there is none."""
    if name not in props:
        return None
    if props.type(name) == mi.Properties.Type.Object and isinstance(props[name], mi.Volume):
        return volume(props, name, 0.0)
    check_literal(props, name)
    return make("constvolume", value=props.get_emissive_texture(name, 0.0))


def check_literal(props: mi.Properties, name: str) -> None:
    """Check numbers before Mitsuba turns them into spectra, which clamp or misreport them."""
    upper = 1.0 if name.startswith("albedo") else dr.inf
    kind = props.type(name)
    if kind in (mi.Properties.Type.Color, mi.Properties.Type.Float, mi.Properties.Type.Integer):
        check_range(name, np.array(props[name], dtype=float).ravel(), upper)
    elif kind not in (mi.Properties.Type.Spectrum, mi.Properties.Type.Object):
        raise ValueError(f"{name} is {props[name]!r}: it must be a number, rgb, spectrum or volume")


def check_range(name: str, values: Any, upper: float) -> None:
    bad = values[~((values >= 0) & (values <= upper) & np.isfinite(values))]
    if bad.size:
        allowed = "a finite number >= 0" if upper == dr.inf else f"within [0, {upper:g}]"
        raise ValueError(f"{name} is {bad.flat[0]:g}: it must be {allowed}")


def check_one(name: str, value: Any) -> Any:
    """A single number >= 0."""
    found = np.array(value)
    if found.size != 1:
        raise ValueError(f"{name} holds {found.size} numbers: it must be one")
    check_range(name, found, dr.inf)
    return found


def check_product(name: str, volume: mi.Volume, factor: float, scale: Any) -> Any:
    """Values of a volume over channels or wavelengths; with ``scale`` they must be finite."""
    spectrum = spectrum_of(name, volume) * factor
    check_range(name, spectrum, dr.inf)
    with np.errstate(over="ignore"):
        check_range(f"{name} * scale", spectrum * scale, dr.inf)
    return spectrum


def check_microflakes(phase: mi.PhaseFunction) -> None:
    if not mi.has_flag(phase.flags(), mi.PhaseFunctionFlags.Microflake):
        return
    for name, value in mi.traverse(phase):
        values = np.array(value)
        if values.ndim > 1 and not np.all(values == values.reshape(-1, values.shape[-1])[0]):
            raise ValueError(f"phase.{name} varies in space: in a homogeneous medium it must not")


def spectrum_of(name: str, volume: mi.Volume) -> Any:
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


def values_of(name: str, volume: mi.Volume) -> Any:
    """All values that a volume is made of."""
    parameters = mi.traverse(volume)
    if "data" in parameters:
        return np.array(dr.detach(parameters["data"]))
    return spectrum_of(name, volume)
