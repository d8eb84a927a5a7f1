"""Reading and checking the parameters of a medium of two materials."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from nonexp.plugins import values

__all__ = ["check_chord", "check_names", "check_phases", "phases"]

_PAIRS = ("sigma_t", "albedo", "chord", "emission", "phase")
_OTHERS = ("scale", "sample_emitters", "has_spectral_extinction")
_CHORDS = 1e-30, 1e30


def check_names(props: mi.Properties, plugin: str) -> None:
    """Refuse parameters that the plugin does not have, and the want of those that it must have."""
    names = (*_PAIRS, *_OTHERS)
    allowed = {*names, *(f"{pair}_{i}" for pair in _PAIRS for i in (0, 1))}
    for name in props.keys():
        found = props[name] if props.type(name) == mi.Properties.Type.Object else None
        phase = isinstance(found, mi.PhaseFunction)
        if name.startswith("phase") and name in allowed and not phase:
            raise ValueError(f"{name} is {props[name]}: it must be a nested phase function")
        if name not in allowed and not phase:
            raise ValueError(
                f"{plugin} has no parameter {name!r}: its parameters are {', '.join(names)}"
            )
    for name in ("sigma_t", "chord"):
        if name not in props and f"{name}_0" not in props and f"{name}_1" not in props:
            raise ValueError(
                f'{name} is missing: it must be two numbers, as in "0.2, 1.8", '
                f"or {name}_0 and {name}_1"
            )


def check_chord(name: str, value: Any) -> float:
    """A mean chord length."""
    chord, (least, most) = values.check_one(name, value).item(), _CHORDS
    if not least <= chord <= most:
        raise ValueError(f"{name} is {chord:g}: it must be within [{least:g}, {most:g}]")
    return float(chord)


def check_phases(phases: tuple[Any, ...], plugin: str) -> None:
    for phase in phases:
        if mi.has_flag(phase.flags(), mi.PhaseFunctionFlags.Microflake):
            raise ValueError(
                f"phase is a {phase.class_name()}: in {plugin} it must not be a microflake"
            )


def phases(props: mi.Properties) -> tuple[Any, ...]:
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
    taken = tuple(props[name] for name in own)
    for name in own:
        del props[name]
    return taken
