"""The scenes of the benchmark, and the laws of their media."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import mitsuba as mi

from .. import models
from ..models.exponential_mixture import ExponentialMixture
from ..scene.cloud import cloud
from ..scene.load import load

__all__ = [
    "LAWS",
    "MEMORY",
    "SCENES",
    "Case",
    "Filling",
    "Scene",
    "ball",
    "camera",
    "cases",
    "checkout",
    "lit",
]

LAWS: dict[str, tuple[tuple[str, dict[str, Any]], ...]] = {
    "exponential": (("exponential", {}),),
    "gamma": (("gamma", {"alpha": 0.5}),),
    "linear": (("linear", {"b": 1.0}),),
    "quadratic": (("quadratic", {}),),
    "mixed": (
        ("exponential", {}),
        ("gamma", {"alpha": 0.3}),
        ("linear", {}),
        ("quadratic", {}),
        ("davis_weinstein", {}),
        ("exponential_mixture", {}),
        ("ensemble", {"law": "gamma", "args": (2.0, 0.0, 0.5)}),
        ("power", {"n": 3.0}),
        ("erlang", {}),
        ("hard_rod", {}),
        ("pulse", {}),
        ("mixture", {}),
        ("tabulated", {"tau": (0.5, 1.0, 2.0, 4.0), "ff": (0.52, 0.25, 0.06, 0.004)}),
        ("gamma", {"alpha": 4.0}),
        ("linear", {"b": 1.72}),
        ("erlang", {"k": 8, "rate": 8.0}),
    ),
}
"""Name -> models with their parameters; the media of a scene take several models in turn."""

MEMORY = "memory"
"""In place of a law: the mixture of two materials whose mean extinction is that of the medium."""

_FACTORS, _CHORDS = (0.25, 4.0), (0.8, 0.2)


@dataclass(frozen=True)
class Filling:
    """What fills the media of a scene: a ``law`` of :data:`LAWS`, or :data:`MEMORY`; None is
    Mitsuba's own medium.

    ``properties`` are passed to Mitsuba's medium. ``channel`` makes the medium grey, with the
    extinction and the albedo of that channel. ``tracking`` is how flights pass a grid.
    """

    law: str | None
    properties: Mapping[str, Any] = field(default_factory=dict)
    channel: int | None = None
    tracking: str = "auto"

    def medium(self, number: int = 0, **parameters: Any) -> dict[str, Any]:
        """Medium ``number`` of a scene; values are numbers, or lists of one per channel."""
        values = {key: self._value(value) for key, value in parameters.items()}
        if self.law is None:
            return {"type": "homogeneous", **values, **self.properties}
        if self.law == MEMORY:
            sigma_t = values.pop("sigma_t")
            pairs = {f"sigma_t_{i}": factor * sigma_t for i, factor in enumerate(_FACTORS)}
            chord = ", ".join(map(str, _CHORDS))
            return {"type": "nonexp_binary_mixture", "chord": chord, **pairs, **values}
        return {"type": "nonexp_homogeneous", "transmittance": self._law(number), **values}

    def grid(self, volume: dict[str, Any], **parameters: Any) -> dict[str, Any]:
        """A medium whose density is a ``gridvolume``."""
        if self.law is None:
            return {"type": "heterogeneous", "sigma_t": volume, **parameters, **self.properties}
        law = {"tracking": self.tracking, "transmittance": self._law(0)}
        return {"type": "nonexp_heterogeneous", "sigma_t": volume, **law, **parameters}

    def parameters(self) -> dict[str, str]:
        """The same as parameters of the scenes in ``scenes/``, which include the medium's file."""
        if self.law is None:
            flags = {key: str(value).lower() for key, value in self.properties.items()}
            return {"medium": "../../benchmarks/media/stock", **flags}
        ((model, fields),) = LAWS[self.law]
        return {"medium": model, **{key: str(value) for key, value in fields.items()}}

    def _law(self, number: int) -> dict[str, Any]:
        assert self.law is not None
        laws = LAWS[self.law]
        model, fields = laws[number % len(laws)]
        return models.to_dict(models.create(model, **fields))

    def _value(self, value: Any) -> Any:
        if not isinstance(value, list):
            return value
        return {"type": "rgb", "value": value} if self.channel is None else value[self.channel]


@dataclass(frozen=True)
class Scene:
    """A scene to measure in.

    ``build`` makes it from a filling and an image size (width, height). ``tags`` decide which
    integrators compete: ``media``; ``glass`` around all media, without a lamp inside;
    ``chromatic`` extinction; ``camera inside`` the medium; ``grid``, a medium whose density varies
    in space. ``exact`` is the radiance of all pixels for a law, if known. ``spp`` is the number of
    samples per pixel of a pass, ``weight`` the share of time for its references, ``file`` its path
    below ``scenes/``, if it has one. A run that names no scene takes only the laws ``usual``, if
    they are given.
    """

    name: str
    text: str
    build: Callable[[Filling, tuple[int, int]], Any]
    laws: tuple[str, ...] = ("exponential",)
    tags: frozenset[str] = frozenset({"media"})
    size: tuple[int, int] = (64, 64)
    spp: int = 64
    max_depth: int = 64
    rr_depth: int = 5
    exact: Callable[[str], float] | None = None
    weight: float = 1.0
    file: str | None = None
    usual: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Case:
    """A scene filled with a law."""

    scene: Scene
    law: str

    @property
    def name(self) -> str:
        """For instance ``dragon-gamma``."""
        return f"{self.scene.name}-{self.law}" if "media" in self.scene.tags else self.scene.name

    @property
    def stock(self) -> bool:
        """Whether Mitsuba's own integrators can render it too."""
        return self.law == "exponential"

    @property
    def usual(self) -> bool:
        """Whether a run that names no scene measures it."""
        return self.scene.usual is None or self.law in self.scene.usual

    @property
    def mixes(self) -> bool:
        """Whether its laws are mixtures of exponentials: null collisions are exact with these."""
        return all(
            models.create(model, **fields).extinctions is not None
            for model, fields in LAWS[self.law]
        )

    def called(self, name: str) -> bool:
        """Whether ``name`` is its own or begins it (``cloud``, ``cloud-32``), or is ``all``."""
        return name == "all" or f"{self.name}-".startswith(f"{name}-")


def cases(names: tuple[str, ...] = ()) -> list[Case]:
    """The cases called by ``names``; without a name, the usual ones."""
    every = [Case(scene, law) for scene in SCENES for law in scene.laws]
    for name in names:
        if not any(case.called(name) for case in every):
            listed = ", ".join(scene.name for scene in SCENES)
            raise ValueError(
                f"scene is {name!r}: it must be all, one of {listed}, or one with its law"
            )
    return [case for case in every if (any(map(case.called, names)) if names else case.usual)]


def checkout() -> Path | None:
    """The source tree, which holds scene files and references; None if there is none."""
    here = Path(__file__).resolve().parents[2]
    return next((root for root in (here, Path.cwd()) if (root / "benchmarks/media").is_dir()), None)


# --------------------------------------------------------------------- building


def _from_file(name: str) -> Callable[[Filling, tuple[int, int]], Any]:
    def build(filling: Filling, size: tuple[int, int]) -> Any:
        root = checkout()
        if root is None:
            raise FileNotFoundError(f"scenes/{name} is not here: run in a source tree of nonexp")
        return load(root / "scenes" / name, filling.parameters(), size).scene

    return build


def _film(size: tuple[int, int]) -> dict[str, Any]:
    box = {"type": "box"}
    return {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": box}


def camera(size: tuple[int, int], origin: list[float], fov: float) -> dict[str, Any]:
    look = mi.ScalarTransform4f().look_at(origin, [0, 0, 0], [0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": look, "film": _film(size)}


def _parallel(size: tuple[int, int], half_width: float) -> dict[str, Any]:
    """Parallel rays along -z over a square around the axis."""
    look = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    to_world = look @ mi.ScalarTransform4f().scale([half_width, half_width, 1])
    return {"type": "orthographic", "to_world": to_world, "film": _film(size)}


def _scene(**parts: Any) -> Any:
    return mi.load_dict({"type": "scene", **parts})


def ball(medium: Any, centre: tuple[float, float, float] = (0, 0, 0), radius: float = 1) -> Any:
    """An index-matched ball."""
    null = {"type": "null"}
    centred = {"center": list(centre), "radius": radius}
    return {"type": "sphere", **centred, "bsdf": null, "interior": medium}


def lit() -> dict[str, Any]:
    """A lamp of 2 x 2 above, a grey floor below, and a faint sky."""
    place = mi.ScalarTransform4f()
    radiance = {"type": "area", "radiance": 5.0}
    lamp = place.translate([0.5, 3, 0.5]).rotate([1, 0, 0], 90)
    floor = place.translate([0, -1.2, 0]).rotate([1, 0, 0], -90).scale(4)
    return {
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": radiance},
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": {"type": "diffuse"}},
        "sky": {"type": "constant", "radiance": 0.2},
    }


def _fog_sphere(filling: Filling, size: tuple[int, int]) -> Any:
    inside = ball(filling.medium(sigma_t=4.0, albedo=0.99))
    return _scene(camera=camera(size, [0, 0.6, 4.5], 38), ball=inside, **lit())


def _chromatic(filling: Filling, size: tuple[int, int]) -> Any:
    medium = filling.medium(sigma_t=[1.0, 0.5, 0.15], scale=4.0, albedo=[0.9, 0.95, 0.98])
    return _scene(camera=camera(size, [0, 0.6, 4.5], 38), ball=ball(medium), **lit())


def _furnace(filling: Filling, size: tuple[int, int]) -> Any:
    inside = ball(filling.medium(sigma_t=2.0, albedo=1.0))
    return _scene(camera=_parallel(size, 0.7), ball=inside, sky={"type": "constant"})


SLAB_DEPTH = 0.7


def _slab(filling: Filling, size: tuple[int, int]) -> Any:
    to_world = mi.ScalarTransform4f().scale([2, 2, 0.5])
    inside = filling.medium(sigma_t=SLAB_DEPTH, albedo=0.0)
    bounds = {"type": "cube", "to_world": to_world, "bsdf": {"type": "null"}}
    slab = {**bounds, "interior": inside}
    return _scene(camera=_parallel(size, 0.9), slab=slab, sky={"type": "constant"})


def _through_slab(law: str) -> float:
    """Transmittance from surface to surface."""
    if law == MEMORY:
        first, second = (factor * SLAB_DEPTH for factor in _FACTORS)
        return float(ExponentialMixture.levermore(first, second, *_CHORDS).ff(1.0))
    ((model, fields),) = LAWS[law]
    return float(models.create(model, **fields).ff(SLAB_DEPTH))


def _cornell(filling: Filling, size: tuple[int, int]) -> Any:
    box: dict[str, Any] = mi.cornell_box()
    del box["integrator"]
    box["sensor"]["film"] = _film(size)
    return mi.load_dict(box)


def _many(filling: Filling, size: tuple[int, int]) -> Any:
    balls = {}
    for number in range(16):
        x, y = number % 4 - 1.5, number // 4 - 1.5
        medium = filling.medium(number, sigma_t=4.0 + number / 4, albedo=[0.95, 0.9, 0.8])
        balls[f"ball {number}"] = ball(medium, (0.6 * x, 0.6 * y, 0), 0.25)
    return _scene(camera=camera(size, [0, 0, 4.5], 33), **balls, **lit())


def _cloud(resolution: int, depth: float, filling: Filling, size: tuple[int, int]) -> Any:
    """A cloud in a cube of 2 x 2 x 2: ``depth`` is the mean optical depth along z, over the middle
    quarter of the cube's face."""
    density = _density(resolution)
    middle = slice(resolution // 4, resolution - resolution // 4)
    column = 2 * float(density[:, middle, middle].mean())
    place = mi.ScalarTransform4f().translate(-1).scale(2)
    volume = {"type": "gridvolume", "grid": mi.VolumeGrid(density), "to_world": place}
    bounds = {
        "type": "cube",
        "bsdf": {"type": "null"},
        "interior": filling.grid(volume, scale=depth / column, albedo=0.9),
    }
    sun = {"type": "directional", "direction": [0.75, -0.6, -0.3], "irradiance": 3.0}
    view = camera(size, [0.3, -1.1, 3.9], 25)
    return _scene(camera=view, bounds=bounds, sun=sun, sky={"type": "constant", "radiance": 0.3})


@cache
def _density(resolution: int) -> Any:
    return cloud(resolution)


# --------------------------------------------------------------------- the table

GLASS = frozenset({"media", "glass"})

GRID = frozenset({"media", "grid"})
DEPTHS = {
    (32, "thin"): 0.14,
    (32, "medium"): 1.05,
    (32, "thick"): 7.0,
    (128, "thin"): 0.07,
    (128, "medium"): 0.55,
    (128, "thick"): 3.7,
}
"""Mean optical depths of the clouds, by resolution."""
USUAL = {(32, "medium"): ("exponential",), (128, "medium"): ("gamma",)}

CLOUDS = tuple(
    Scene(
        f"cloud-{resolution}-{name}",
        f"a cloud of {resolution}^3 voxels, mean optical depth {depth:g}, in sun and sky",
        partial(_cloud, resolution, depth),
        laws=("exponential", "gamma", "linear"),
        tags=GRID,
        usual=USUAL.get((resolution, name), ()),
    )
    for (resolution, name), depth in DEPTHS.items()
)

SCENES = (
    Scene(
        "dragon",
        "a golden dragon in a glass ball of fog",
        _from_file("dragon.xml"),
        laws=("exponential", "gamma", "linear"),
        tags=GLASS,
        size=(120, 90),
        spp=32,
        weight=3,
        file="dragon.xml",
    ),
    Scene(
        "fog",
        "a room of fog with the camera inside",
        _from_file("fog.xml"),
        laws=("exponential", "linear"),
        tags=frozenset({"media", "camera inside"}),
        size=(96, 72),
        spp=32,
        file="fog.xml",
    ),
    Scene(
        "fog_sphere",
        "an index-matched ball, optical depth 8 across, albedo 0.99",
        _fog_sphere,
        laws=("exponential", "gamma", "quadratic"),
    ),
    Scene(
        "chromatic",
        "an index-matched ball whose extinction is 4, 2 and 0.6 in red, green and blue",
        _chromatic,
        laws=("exponential", "gamma"),
        tags=frozenset({"media", "chromatic"}),
    ),
    Scene(
        "furnace",
        "a ball that absorbs nothing under a sky of radiance 1: all pixels are 1",
        _furnace,
        laws=("exponential", "gamma", MEMORY),
        max_depth=-1,
        exact=lambda law: 1.0,
    ),
    Scene(
        "slab",
        "a slab that only absorbs, before a sky of radiance 1: all pixels are its transmittance",
        _slab,
        laws=("exponential", "linear", MEMORY),
        exact=_through_slab,
    ),
    Scene("cornell", "the Cornell box, without media", _cornell, tags=frozenset()),
    Scene(
        "many",
        "16 small balls with a medium each, all of one law or of 16",
        _many,
        laws=("exponential", "mixed"),
    ),
    *CLOUDS,
)
"""Every scene with every one of its laws is a case; so is a scene without media, once."""
