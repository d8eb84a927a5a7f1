"""Scene files: loading them with parameters and an image size, and saying what is wrong in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

from . import meshes, walk
from .messages import SceneError
from .parse import parsed

__all__ = ["LoadedScene", "load"]


@dataclass(frozen=True)
class LoadedScene:
    """A scene, and the plugin names of its integrators (outermost first)."""

    scene: mi.Scene
    integrators: tuple[str, ...]

    def exponential_counterpart(self) -> str | None:
        """The integrator, if it shows the scene's nonexp media as exponential ones; else None."""
        if not self.integrators or any(name.startswith("nonexp_") for name in self.integrators):
            return None
        media = walk.media(self.scene)
        held = any(type(medium).__name__.startswith("Nonexp") for medium in media)
        return self.integrators[0] if held else None


def load(
    path: Path, parameters: Mapping[str, str], size: tuple[int, int] | None = None
) -> LoadedScene:
    """Load a scene file for the variant that is set.

    ``parameters`` replace the file's ``<default>`` values; ``size`` (width, height) replaces the
    size of every film, and scales crop windows with it. Raises :class:`SceneError`.
    """
    with parsed(path, parameters) as (config, state):
        if state.root.type != mi.ObjectType.Scene:
            raise SceneError(
                f"scene file {str(path)!r} holds a {state.root.props.plugin_name()}, "
                "not a scene: its root element must be <scene>"
            )
        if size is not None:
            _resize(state, size)
        integrators = tuple(
            node.props.plugin_name()
            for node in state.nodes
            if node.type == mi.ObjectType.Integrator
        )
        config.merge_meshes = False
        mi.parser.transform_all(config, state)
        meshes.merge(state)
        scene = meshes.in_order(mi.parser.instantiate(config, state), state.root.props)

    if not scene.sensors():
        raise SceneError(f"scene file {str(path)!r} has no sensor: add a <sensor> to render from")
    if not integrators:
        raise SceneError(
            f"scene file {str(path)!r} has no integrator: add one, such as "
            '<integrator type="nonexp_volpath"/>'
        )
    return LoadedScene(scene, integrators)


def _resize(state: Any, size: tuple[int, int]) -> None:
    """Set the size of all films of a parsed scene, and give one to sensors without a film."""
    nodes = state.nodes
    films = {i for i, node in enumerate(nodes) if node.type == mi.ObjectType.Film}
    for i in films:
        _resize_film(nodes[i].props, size)
    for i in range(len(nodes)):
        held = {index for _, index in meshes.children(nodes[i].props)}
        if nodes[i].type == mi.ObjectType.Sensor and not films & held:
            film = mi.parser.SceneNode()
            film.type = mi.ObjectType.Film
            film.props = mi.Properties("hdrfilm")
            _resize_film(film.props, size)
            nodes.append(film)
            nodes[i].props["film"] = mi.Properties.ResolvedReference(len(nodes) - 1)


def _resize_film(film: Any, size: tuple[int, int]) -> None:
    before = (film.get("width", 768), film.get("height", 576))
    for axis, extent in enumerate(("width", "height")):
        film[extent] = size[axis]
        crop, offset = f"crop_{extent}", f"crop_offset_{'xy'[axis]}"
        if crop in film:
            film[crop] = max(1, film[crop] * size[axis] // before[axis])
        if offset in film:
            film[offset] = min(film[offset] * size[axis] // before[axis], size[axis] - 1)
