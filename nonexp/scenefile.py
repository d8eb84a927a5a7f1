"""Scene files: loading them with parameters and an image size, and saying what is wrong in them."""

from __future__ import annotations

import difflib
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi

from . import models, scenewalk

__all__ = [
    "LoadedScene",
    "SceneError",
    "elements",
    "explain",
    "load",
    "search_folders",
    "substituted",
]


class SceneError(ValueError):
    """A scene cannot be loaded; the message is one sentence for the user."""


@dataclass(frozen=True)
class LoadedScene:
    """A scene, and the plugin names of its integrators (outermost first)."""

    scene: mi.Scene
    integrators: tuple[str, ...]

    def exponential_counterpart(self) -> str | None:
        """The integrator, if it shows the scene's nonexp media as exponential ones; else None."""
        if not self.integrators or any(name.startswith("nonexp_") for name in self.integrators):
            return None
        media = scenewalk.media(self.scene)
        held = any(type(medium).__name__.startswith("Nonexp") for medium in media)
        return self.integrators[0] if held else None


def load(
    path: Path, parameters: Mapping[str, str], size: tuple[int, int] | None = None
) -> LoadedScene:
    """Load a scene file for the variant that is set.

    ``parameters`` replace the file's ``<default>`` values; ``size`` (width, height) replaces the
    size of every film, and scales crop windows with it. Raises :class:`SceneError`.
    """
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise SceneError(f"scene file {str(path)!r} {what}: it must be a Mitsuba scene (.xml)")
    known = _parameters(path, dict(parameters))
    for name, value in parameters.items():
        if name not in known:
            raise SceneError(_unknown_parameter(path, name, value, sorted(known)))

    core: Any = mi  # whose stubs know no file resolvers
    resolver = core.file_resolver()
    core.set_file_resolver(_with_folder(resolver, path.parent))
    try:
        config = mi.parser.ParserConfig(mi.variant() or "")
        config.merge_meshes = False
        state: Any = mi.parser.parse_file(config, str(path), **parameters)
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
        mi.parser.transform_all(config, state)
        _merge_meshes(state)
        scene: Any = mi.parser.instantiate(config, state)
    except SceneError:
        raise
    except Exception as error:
        raise SceneError(explain(error, parameters)) from error
    finally:
        core.set_file_resolver(resolver)

    if not scene.sensors():
        raise SceneError(f"scene file {str(path)!r} has no sensor: add a <sensor> to render from")
    if not integrators:
        raise SceneError(
            f"scene file {str(path)!r} has no integrator: add one, such as "
            '<integrator type="nonexp_volpath"/>'
        )
    return LoadedScene(scene, integrators)


def _with_folder(resolver: Any, folder: Path) -> Any:
    copy: Any = mi.FileResolver(resolver)
    copy.prepend(str(folder))
    return copy


def _resize(state: Any, size: tuple[int, int]) -> None:
    """Set the size of all films of a parsed scene, and give one to sensors without a film."""
    nodes = state.nodes
    films = {i for i, node in enumerate(nodes) if node.type == mi.ObjectType.Film}
    for i in films:
        _resize_film(nodes[i].props, size)
    for i in range(len(nodes)):
        if nodes[i].type == mi.ObjectType.Sensor and not films & _children(nodes[i].props):
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


def _merge_meshes(state: Any) -> None:
    """Make one of the meshes that agree in all but their vertices: 2000 render twice as fast.

    Mitsuba would do that itself, but leaves shapes, and the lights among them, in an order that
    differs from one loading to the next, and so do the images. Here lights stay as they are.
    """
    nodes, root = state.nodes, state.root.props
    alike: dict[Any, list[str]] = {}
    for name in root.keys():
        if root.type(name) != mi.Properties.Type.ResolvedReference:
            continue
        props = nodes[root[name].index()].props
        if props.plugin_name() not in ("cube", "obj", "ply", "rectangle", "serialized"):
            continue
        held = sorted(
            (str(nodes[props[child].index()].type), props[child].index(), child)
            for child in props.keys()
            if props.type(child) == mi.Properties.Type.ResolvedReference
        )
        kinds = {kind for kind, _, _ in held}
        if kinds <= {str(mi.ObjectType.BSDF), str(mi.ObjectType.Medium)}:
            medium = str(mi.ObjectType.Medium)
            shared = tuple((kind, i, child if kind == medium else "") for kind, i, child in held)
            key = (props.plugin_name(), props.get("face_normals", False), shared)
            alike.setdefault(key, []).append(name)
    for number, names in enumerate(alike.values()):
        if len(names) > 1:
            merged = mi.parser.SceneNode()
            merged.type = mi.ObjectType.Shape
            merged.props = mi.Properties("merge")
            for name in names:
                merged.props[name] = mi.Properties.ResolvedReference(root[name].index())
                del root[name]
            nodes.append(merged)
            root[f"merged_meshes_{number}"] = mi.Properties.ResolvedReference(len(nodes) - 1)


def _children(props: Any) -> set[int]:
    kind = mi.Properties.Type.ResolvedReference
    return {props[name].index() for name in props.keys() if props.type(name) == kind}


# --------------------------------------------------------------------- parameters of a file


def elements(
    path: Path, values: dict[str, str], folders: list[Path] | None = None
) -> Iterator[tuple[Path, ET.Element]]:
    """Every element of a scene file and of those that it includes, with the file it stands in.

    ``values`` are the parameters given; the defaults met on the way join them, and the folders of
    ``<path>`` elements join ``folders``, where files are looked for, in front. Raises
    :class:`SceneError` for an include that does not exist, ``ET.ParseError`` for what is not XML.
    """
    if folders is None:
        folders = search_folders(path)
    for element in ET.parse(path).iter():
        text = {name: substituted(value, values) for name, value in element.attrib.items()}
        if element.tag == "default" and "name" in text:
            values.setdefault(text["name"], text.get("value", ""))
        yield path, element
        if element.tag == "path" and "value" in text:
            places = (path.parent, *folders)
            found = (folder / text["value"] for folder in places)
            folders[:0] = [next((place for place in found if place.is_dir()), path.parent)]
        if element.tag == "include" and "filename" in element.attrib:
            included = _included(path, element.attrib["filename"], values, folders)
            yield from elements(included, values, folders)


def search_folders(path: Path) -> list[Path]:
    """Where Mitsuba looks for the files of a scene file: its own folder, then the usual ones."""
    return [path.parent, *(Path(str(folder)) for folder in mi.file_resolver())]


def substituted(text: str, values: Mapping[str, str]) -> str:
    """``text`` with ``$name`` replaced by the value of that parameter, long names first."""
    for name in sorted(values, key=len, reverse=True):
        if f"${name}" in text:
            literal = values[name].replace("\\", r"\\")
            text = re.sub(rf"(?<!\\)\${re.escape(name)}", literal, text)
    return text


def _parameters(path: Path, values: dict[str, str]) -> set[str]:
    """Names of the parameters that a scene file and the files it includes refer to.

    A file that is not XML makes all of ``values`` known: Mitsuba's parser says what is wrong.
    """
    names = set()
    try:
        for _, element in elements(path, values):
            for value in element.attrib.values():
                names.update(re.findall(r"\$(\w+)", value))
            if element.tag == "default" and "name" in element.attrib:
                names.add(element.attrib["name"])
    except SceneError:
        raise
    except (ET.ParseError, OSError, ValueError):
        return names | set(values)
    return names


def _included(path: Path, filename: str, values: Mapping[str, str], folders: list[Path]) -> Path:
    """File that an ``<include>`` names. Raises :class:`SceneError` if it does not exist."""
    used = [name for name in re.findall(r"\$(\w+)", filename) if name in values]
    name = substituted(filename, values)
    for folder in (path.parent, *folders):
        if (folder / name).is_file():
            return folder / name
    target = path.parent / name
    files = sorted(file.stem for file in target.parent.glob(f"*{target.suffix}") if file.is_file())
    allowed = f"it must be one of {', '.join(files)}" if files else "that folder has no scene files"
    folder = target.parent
    if len(used) == 1 and Path(filename).name == f"${used[0]}{target.suffix}":
        raise SceneError(f"{used[0]} is {values[used[0]]!r}: {allowed} (files of {folder})")
    raise SceneError(f"{path} includes {filename!r}, and {target} does not exist: {allowed}")


def _unknown_parameter(path: Path, name: str, value: str, known: list[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    guess = f" (did you mean {close[0]!r}?)" if close else ""
    allowed = f"its parameters are {', '.join(known)}" if known else "it has no parameters"
    return f"{path} has no parameter {name!r}, given as {value!r}{guess}: {allowed}"


# --------------------------------------------------------------------- Mitsuba's messages


_PREFIX = re.compile(r"\[\w+\.(?:cpp|h|mm):\d+\] ")
_PLACE = re.compile(r"(?:At|While loading|Error while loading) (\S+) \(line (\d+), col \d+\): ")
_CAUSE = re.compile(r"^(?:\w+\.)*\w*(?:Error|Exception|Warning|Interrupt): ", re.MULTILINE)
_UNUSED = re.compile(
    r'Found \d+ unreferenced propert\w+ in \w+ plugin of type "(\w+)":\s+- \w+ "(\w+)": (.*)'
)
_NO_PLUGIN = re.compile(r'failed to instantiate (\w+) plugin of type "(\w+)":.* not found!$')


def explain(error: BaseException, parameters: Mapping[str, str] | None = None) -> str:
    """One sentence out of an exception that Mitsuba raised while loading or rendering.

    Drops source positions in Mitsuba, and Python tracebacks down to the last cause; keeps the
    place in the scene file.
    """
    text = _PREFIX.sub("", str(error)).strip() or type(error).__name__
    places = _PLACE.findall(text)
    place = f"{places[-1][0]}, line {places[-1][1]}: " if places else ""
    if "Traceback (most recent call last)" in text and (causes := list(_CAUSE.finditer(text))):
        text = text[causes[-1].end() :]
    elif match := _UNUSED.search(text):
        plugin, name, value = match.groups()
        text = f"{plugin} has no parameter {name!r}, given as {value}: remove it or correct it"
        model = models.registry.get(plugin.removeprefix("transmittance_"))
        fields = ", ".join(getattr(model, "__dataclass_fields__", ()))
        text += f" (its parameters are {fields})" if fields else ""
    elif match := _NO_PLUGIN.search(text):
        text = f"{match[1]} {match[2]!r} is unknown"
        if match[2].startswith("transmittance_"):
            text += f": it must be one of {', '.join(f'transmittance_{n}' for n in models.names())}"
        else:
            text += ": it must be the name of a Mitsuba or nonexp plugin"
    text = " ".join(_PLACE.sub("", text).split())
    for name, value in (parameters or {}).items():
        if f'"{value}"' in text:
            text += f" (from -D {name}={value})"
    return place + text
