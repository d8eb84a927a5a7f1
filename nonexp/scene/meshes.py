"""Merging the meshes of a scene, in an order that is the same at each loading."""

from __future__ import annotations

import re
from typing import Any

import mitsuba as mi

from ..system import insides

__all__ = ["children", "in_order", "merge"]

_MERGED = "merged_meshes_"
_MESHES = ("cube", "obj", "ply", "rectangle", "serialized")

# Properties of a mesh that end up in its vertices, and those in which merged meshes must agree.
_BAKED = ("to_world", "filename", "shape_index", "flip_tex_coords")
_SHARED = ("face_normals", "flip_normals")


def merge(state: Any) -> None:
    """Merge the meshes of a parsed scene that agree in all but their vertices.

    Merged, 2000 meshes render twice as fast. Mitsuba's own merging leaves shapes, and the lights
    among them, in an order that differs from one loading to the next, and so do the images; and it
    refuses a scene where one of two meshes has flipped normals. Here lights are not merged. Merged
    shapes lose their ids.
    """
    nodes, root = state.nodes, state.root.props
    bsdf, medium = mi.ObjectType.BSDF, mi.ObjectType.Medium
    groups: dict[Any, list[str]] = {}
    for name, index in children(root):
        props = nodes[index].props
        held = [(nodes[i].type, i, child) for child, i in children(props)]
        options = set(props.keys()) - {child for *_, child in held}
        if (
            props.plugin_name() in _MESHES
            and {kind for kind, *_ in held} <= {bsdf, medium}
            and options <= {*_BAKED, *_SHARED}
        ):
            # The name of a medium says on which side it is.
            parts = frozenset((i, child if kind == medium else "") for kind, i, child in held)
            shared = tuple(props.get(option, False) for option in _SHARED)
            groups.setdefault((props.plugin_name(), shared, parts), []).append(name)
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


def in_order(scene: mi.Scene, built: Any) -> mi.Scene:
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


def children(props: Any) -> list[tuple[str, int]]:
    """Names and node numbers of the objects that a node of a parsed scene refers to."""
    kind = mi.Properties.Type.ResolvedReference
    return [(name, props[name].index()) for name in props.keys() if props.type(name) == kind]
