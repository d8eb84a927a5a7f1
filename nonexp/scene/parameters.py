"""The parameters of a scene file, and the elements that they stand in."""

from __future__ import annotations

import difflib
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import Path

import mitsuba as mi

from .messages import SceneError

__all__ = ["elements", "names", "search_folders", "substituted", "unknown"]


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


def names(path: Path, values: dict[str, str]) -> set[str]:
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


def unknown(path: Path, name: str, value: str, known: list[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    guess = f" (did you mean {close[0]!r}?)" if close else ""
    allowed = f"its parameters are {', '.join(known)}" if known else "it has no parameters"
    return f"{path} has no parameter {name!r}, given as {value!r}{guess}: {allowed}"
