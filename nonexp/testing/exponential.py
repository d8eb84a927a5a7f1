"""An integrator in exponential media against Mitsuba's ``volpath``, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from ..system.machine import check_variant
from .faults import Fault
from .scenes import ball, perspective, scene, stock
from .statistics import Agreement, assert_same, passes, sampled

__all__ = [
    "CASES",
    "COUNT",
    "GRID",
    "KINDS",
    "MATRIX",
    "POWER",
    "Verdict",
    "check_integrator",
    "light",
    "lobe",
    "nested",
    "verdicts",
]

GRID = 6
"""A film is divided into GRID x GRID blocks."""

Make = Callable[..., dict[str, Any]]
"""Makes a medium from its parameters."""


def light(kind: str) -> dict[str, Any]:
    if kind == "area":
        place = mi.ScalarTransform4f().translate([0.5, 2.5, 0.5]).rotate([1, 0, 0], 90)
        return {
            "type": "rectangle",
            "to_world": place,
            "emitter": {"type": "area", "radiance": 4.0},
        }
    return {
        "point": {"type": "point", "position": [1, 2.5, 1.5], "intensity": 10.0},
        "spot": {
            "type": "spot",
            "to_world": mi.ScalarTransform4f().look_at([1, 3, 1], [0, 0, 0], [0, 0, 1]),
            "intensity": 20.0,
            "cutoff_angle": 30,
        },
        "directional": {"type": "directional", "direction": [-0.3, -1, -0.4], "irradiance": 2.0},
        "constant": {"type": "constant"},
    }[kind]


def floor() -> dict[str, Any]:
    place = mi.ScalarTransform4f().translate([0, -1.2, 0]).rotate([1, 0, 0], -90).scale(3)
    return {"type": "rectangle", "to_world": place, "bsdf": {"type": "diffuse"}}


def lobe(make: Callable[..., Any], bsdf: str, emitter: str) -> dict[str, Any]:
    inside = make(
        sigma_t=1.5,
        albedo={"type": "rgb", "value": [0.9, 0.7, 0.4]},
        phase={"type": "hg", "g": 0.4},
    )
    return {
        "sensor": perspective([0, 0.6, 4], [0, 0, 0]),
        "lobe": ball(inside, bsdf),
        "floor": floor(),
        "emitter": light(emitter),
    }


def nested(make: Callable[..., Any], second: Callable[..., Any]) -> dict[str, Any]:
    """A glass ball and a gold ball inside an index-matched fog ball, in a closed room of light."""
    glass = ball(second(sigma_t=4.0, albedo=0.9), "dielectric", 0.35)
    place = mi.ScalarTransform4f()
    fog = make(sigma_t=0.8, albedo=0.95)
    return {
        "sensor": perspective([0, 0.6, 4], [0, 0, 0]),
        "fog": {"type": "ref", "id": "fog_medium"},
        "fog_medium": {**fog, "id": "fog_medium"},
        "outer": {
            "type": "sphere",
            "bsdf": {"type": "null"},
            "interior": {"type": "ref", "id": "fog_medium"},
        },
        "glass": {
            **glass,
            "to_world": place.translate([-0.4, 0, 0.2]),
            "exterior": {"type": "ref", "id": "fog_medium"},
        },
        "gold": {
            "type": "sphere",
            "to_world": place.translate([0.4, -0.1, 0]).scale(0.3),
            "bsdf": {"type": "roughconductor", "material": "Au", "alpha": 0.2},
        },
        "floor": floor(),
        "emitter": light("area"),
        "sky": {"type": "constant", "radiance": 0.3},
    }


def instances(make: Callable[..., Any]) -> dict[str, Any]:
    """Two index-matched fog balls that exist only as instances."""
    place = mi.ScalarTransform4f()
    group = {"type": "shapegroup", "shape": ball(make(sigma_t=2.0, albedo=0.9), radius=0.6)}
    copies = {
        f"copy {i}": {
            "type": "instance",
            "group": {"type": "ref", "id": "group"},
            "to_world": place.translate([x, 0, 0]),
        }
        for i, x in enumerate((-0.7, 0.7))
    }
    camera = perspective([0, 0.6, 4], [0, 0, 0])
    return {"group": group, **copies, "sensor": camera, "floor": floor(), "sun": light("point")}


def lamp_in_lobe(make: Callable[..., Any]) -> dict[str, Any]:
    """Smooth glass around a medium in which light is found, after all, by connections."""
    parts = lobe(make, "dielectric", "constant")
    bulb = {"type": "area", "radiance": 20.0}
    parts["bulb"] = {"type": "sphere", "center": [0.3, 0.2, 0], "radius": 0.1, "emitter": bulb}
    return parts


def fog_room(make: Callable[..., Any], emitter: str) -> dict[str, Any]:
    """The camera stands in the medium that fills a room."""
    room = {"type": "cube", "flip_normals": True, "to_world": mi.ScalarTransform4f().scale(4)}
    return {
        "fog": {**make(sigma_t=0.3, albedo=0.8), "id": "fog"},
        "sensor": {
            **perspective([0, 0, 3.5], [0, 0, 0], 70),
            "medium": {"type": "ref", "id": "fog"},
        },
        "room": room,
        "object": {"type": "sphere", "radius": 0.8, "bsdf": {"type": "plastic"}},
        "emitter": light(emitter),
    }


CASES: dict[str, Callable[..., dict[str, Any]]] = {
    **{
        f"{bsdf}-{emitter}": lambda make, bsdf=bsdf, emitter=emitter: lobe(make, bsdf, emitter)
        for bsdf in ("null", "dielectric", "roughdielectric")
        for emitter in ("area", "point", "constant")
    },
    "null-spot": lambda make: lobe(make, "null", "spot"),
    "null-directional": lambda make: lobe(make, "null", "directional"),
    "nested": lambda make: nested(make, make),
    "instances": instances,
    "lamp in lobe": lamp_in_lobe,
    "camera inside, area": lambda make: fog_room(make, "area"),
    "camera inside, point": lambda make: fog_room(make, "point"),
}


# Relative bias that a case finds with a probability above 0.9. Light that a lobe focuses on its way
# to or from a small emitter is heavy-tailed: weaker.
POWER = {
    "null-constant": 0.006,
    "dielectric-constant": 0.006,
    "dielectric-area": 0.05,
    "roughdielectric-area": 0.05,
    "roughdielectric-point": 0.15,
    "nested": 0.015,
    "camera inside, area": 0.03,
    "camera inside, point": 0.04,
}


# Paths a block in each of 64 passes, as many as that takes.
COUNT = {
    "null-area": 1024,
    "null-spot": 1024,
    "null-constant": 128,
    "dielectric-point": 1024,
    "dielectric-constant": 256,
    "roughdielectric-point": 1024,
    "nested": 64,
    "camera inside, area": 640,
    "camera inside, point": 1024,
}

MATRIX = tuple(case for case in CASES if case != "dielectric-point")
"""The cases for integrators of others: all but the one in which ``volpath`` finds light by chance
alone, so that better integrators differ."""


# --------------------------------------------------------------------- faults by name


def _with(**changes: Any) -> Make:
    return lambda **kw: stock(**{**kw, **changes})


def _twice(**kw: Any) -> dict[str, Any]:
    """Albedo counted twice."""
    albedo = kw["albedo"]
    if isinstance(albedo, dict):
        return stock(**{**kw, "albedo": {**albedo, "value": [a * a for a in albedo["value"]]}})
    return stock(**{**kw, "albedo": albedo**2})


KINDS: dict[str, tuple[Make, dict[str, Any]]] = {
    "missing albedo (the image is that of albedo 1)": (_with(albedo=1.0), {}),
    "albedo counted twice": (_twice, {}),
    "albedo counted as 0 (nothing scatters)": (_with(albedo=0.0), {}),
    "missing phase function (the image is that of isotropic scattering)": (
        _with(phase={"type": "isotropic"}),
        {},
    ),
    "missing medium (the image is that without one)": (_with(sigma_t=1e-9), {}),
    "light scatters once at most": (stock, {"max_depth": 2}),
}
"""Kinds of faults: the image is that of another medium, or with another option."""


@dataclass(frozen=True)
class Verdict:
    """What a case said of an integrator."""

    case: str
    within: float
    """relative bias that it finds"""
    agreement: Agreement | None = None
    fault: str | None = None
    """what is wrong; None: nothing"""


def verdicts(
    integrator: str | dict[str, Any],
    *,
    medium: str = "homogeneous",
    cases: Sequence[str] | None = None,
    seed: int = 1,
) -> Iterator[Verdict]:
    """Compare an integrator with ``volpath`` case by case, as :func:`check_integrator` does."""
    cases = MATRIX if cases is None else cases
    unknown = [case for case in cases if case not in CASES]
    if unknown:
        raise ValueError(f"case is {unknown[0]!r}: it must be one of {', '.join(CASES)}")
    if mi.variant() is None:
        mi.set_variant(check_variant(None))
        mi.set_log_level(mi.LogLevel.Error)
    given = {"type": integrator} if isinstance(integrator, str) else integrator
    diagnosed = False

    def make(**kw: Any) -> dict[str, Any]:
        return {"type": medium, **kw}

    for case in cases:
        within, build = POWER.get(case, 0.012), CASES[case]
        ours, theirs = scene(given, **build(make)), scene("volpath", **build(stock))
        count = COUNT.get(case, 512)

        def run(count: int, ours: Any = ours, theirs: Any = theirs) -> tuple[Any, Any]:
            return passes(ours, count, seed, GRID), passes(theirs, count, seed + 1, GRID)

        a, b = sampled(run, within, count, 16 * count)
        try:
            yield Verdict(case, within, assert_same(a, b, within))
        except AssertionError as error:
            kind = None if diagnosed else _kind(case, a, count, seed)
            diagnosed = True
            fault = str(error) if kind is None else f"{kind}: {error}"
            yield Verdict(case, within, None, fault)


def _kind(case: str, image: Any, count: int, seed: int) -> str | None:
    """The kind of fault that explains an image; None if none does."""
    for name, (make, options) in KINDS.items():
        other = scene({"type": "volpath", **options}, **CASES[case](make))
        try:
            assert_same(image, passes(other, count, seed + 2, GRID), 1.0)
        except AssertionError:
            continue
        return name
    return None


def check_integrator(
    integrator: str | dict[str, Any],
    *,
    medium: str = "homogeneous",
    cases: Sequence[str] | None = None,
    seed: int = 1,
) -> list[Verdict]:
    """Check that an integrator renders exponential media as Mitsuba's ``volpath`` does.

    ``integrator`` is the name of a registered plugin, or its dictionary; ``medium`` the plugin
    that it takes the place of ``homogeneous`` with; ``cases`` chooses some. The cases:
    index-matched, smooth and rough boundaries under area, point, spot, directional and constant
    lights; nested glass and metal; instances; a lamp inside glass; a camera inside the medium. Each
    compares 36 blocks of 64 passes, Welch's test corrected for their number, with as many samples
    as it takes to find a bias of 0.6 to 5 % (of 15 % where rough glass focuses a point light).
    Returns what each said.

    Raises ``AssertionError`` that names the cases that differ and, where it is known, the kind of
    fault (missing albedo, missing phase function, ...); ``ValueError`` for an unknown case.

    >>> from nonexp.testing import check_integrator
    >>> check_integrator("my_volpath")  # doctest: +SKIP
    """
    found = list(verdicts(integrator, medium=medium, cases=cases, seed=seed))
    faults = [f"{verdict.case}: {verdict.fault}" for verdict in found if verdict.fault]
    if faults:
        raise Fault("\n".join(faults))
    return found
