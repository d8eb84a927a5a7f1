"""Scene files: loading them with parameters and an image size, and saying what is wrong in them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

from ..system import insides
from . import walk
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
        _merge_meshes(state)
        scene: Any = _in_order(mi.parser.instantiate(config, state), state.root.props)

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
        if nodes[i].type == mi.ObjectType.Sensor and not films & {
            index for _, index in _children(nodes[i].props)
        }:
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


# Properties of a mesh that end up in its vertices, and those that merged meshes must share.
_BAKED = ("to_world", "filename", "shape_index", "flip_tex_coords")
_SHARED = ("face_normals", "flip_normals")


def _merge_meshes(state: Any) -> None:
    """Merge meshes that agree in all but their vertices: 2000 render twice as fast as one.

    Mitsuba would do that itself, but leaves shapes, and the lights among them, in an order that
    differs from one loading to the next, and so do the images; and it refuses a scene where one of
    two meshes has flipped normals. Here lights stay as they are. Merged shapes lose their ids.
    """
    nodes, root = state.nodes, state.root.props
    groups: dict[Any, list[str]] = {}
    for name, index in _children(root):
        props = nodes[index].props
        if props.plugin_name() not in ("cube", "obj", "ply", "rectangle", "serialized"):
            continue
        held = {
            # The medium's name says on which side it is.
            (nodes[i].type, i, child if nodes[i].type == mi.ObjectType.Medium else "")
            for child, i in _children(props)
        }
        others = set(props.keys()) - {child for child, _ in _children(props)}
        if all(kind in (mi.ObjectType.BSDF, mi.ObjectType.Medium) for kind, *_ in held) and (
            others <= {*_BAKED, *_SHARED}
        ):
            shared = (props.get(option, False) for option in _SHARED)
            groups.setdefault((props.plugin_name(), *shared, frozenset(held)), []).append(name)
    for number, names in enumerate(groups.values()):
        if len(names) > 1:
            merged = mi.parser.SceneNode()
            merged.type = mi.ObjectType.Shape
            merged.props = mi.Properties("merge")
            for name in names:
                merged.props[name] = mi.Properties.ResolvedReference(root[name].index())
                del root[name]
            nodes.append(merged)
            root[f"{_MERGED}{number}"] = mi.Properties.ResolvedReference(len(nodes) - 1)


_MERGED = "merged_meshes_"


def _in_order(scene: mi.Scene, built: Any) -> mi.Scene:
    """The scene with its shapes in an order that is the same at each loading.

    ``built`` are the properties that the scene was built from. Files of meshes tell only when they
    are read whether they have texture coordinates and normals: of those that do not agree, Mitsuba
    makes several meshes, in an order that depends on addresses.
    """
    groups: dict[str, list[str]] = {}
    for name in built.keys():
        group = re.sub(rf"^({_MERGED}\d+)_\d+$", r"\1", name)
        groups.setdefault(group, []).append(name)
    if all(len(names) == 1 for names in groups.values()):
        return scene

    def features(name: str) -> tuple[bool, ...]:
        mesh = built[name]
        normals = insides.has_vertex_normals(mesh)
        return mesh.has_mesh_attributes(), normals, mesh.has_vertex_texcoords()

    ordered: Any = mi.Properties("scene")
    ordered.set_id(built.id())
    for names in groups.values():
        for name in sorted(names, key=features) if len(names) > 1 else names:
            ordered[name] = built[name]
    return mi.PluginManager.instance().create_object(ordered)


def _children(props: Any) -> list[tuple[str, int]]:
    """Names and node numbers of the objects that a node of a parsed scene refers to."""
    kind = mi.Properties.Type.ResolvedReference
    return [(name, props[name].index()) for name in props.keys() if props.type(name) == kind]
