"""Scene files as Mitsuba's parser understands them, and the little that it does not keep."""

from __future__ import annotations

import contextlib
import difflib
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi

from .messages import SceneError, explain

__all__ = ["Text", "parsed", "read", "resolved", "substituted"]

_core: Any = mi  # whose stubs know no file resolvers
_RESERVED = ("config", "filename")  # arguments of mi.parser.parse_file, which takes ours beside


@contextlib.contextmanager
def parsed(path: Path, parameters: Mapping[str, str]) -> Iterator[tuple[Any, Any]]:
    """Mitsuba's ``ParserConfig`` and ``ParserState`` of a scene file.

    Meanwhile ``mi.file_resolver()`` finds the scene's files. Raises :class:`SceneError` for what
    is wrong in the file, also where Mitsuba finds out inside the ``with`` statement.
    """
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise SceneError(f"scene file {str(path)!r} {what}: it must be a Mitsuba scene (.xml)")
    for name in parameters:
        if name in _RESERVED:
            raise SceneError(f"parameter {name!r} cannot be given: Mitsuba reserves that name")
    before = _core.file_resolver()
    _core.set_file_resolver(_within(before, path.parent))
    try:
        config = mi.parser.ParserConfig(mi.variant() or "")
        try:
            state = mi.parser.parse_file(config, str(path), **parameters)
        except Exception:
            _check_parameters(path, parameters)
            raise
        yield config, state
    except SceneError:
        raise
    except Exception as error:
        raise SceneError(explain(error, parameters)) from error
    finally:
        _core.set_file_resolver(before)


@dataclass
class Text:
    """What a scene file and the files that it includes say, and Mitsuba's parser does not keep."""

    files: list[Path] = field(default_factory=list)
    """the XML files, also included ones without an object, and files of spectra"""
    parameters: set[str] = field(default_factory=set)
    """names of the parameters"""


def read(path: Path, parameters: Mapping[str, str]) -> Text:
    """Read a scene file and those that it includes, without Mitsuba's parser.

    Raises :class:`SceneError` for an include that does not exist, ``ET.ParseError`` for what is
    not XML.
    """
    values, found = dict(parameters), Text()

    def visit(file: Path, resolver: Any) -> None:
        found.files.append(file)
        for element in ET.parse(file).iter():
            for raw in element.attrib.values():
                found.parameters.update(re.findall(r"(?<!\\)\$(\w+)", raw))
            text = {name: substituted(raw, values) for name, raw in element.attrib.items()}
            if element.tag == "default" and "name" in text:
                found.parameters.add(text["name"])
                values.setdefault(text["name"], text.get("value", ""))
            elif element.tag == "path" and "value" in text:
                beside = file.parent / text["value"]
                folder = beside if beside.exists() else resolved(text["value"], resolver)
                resolver.prepend(str(folder))
            elif element.tag == "include" and "filename" in text:
                inner = _within(resolver, file.parent)
                included = resolved(text["filename"], inner)
                if not included.exists():
                    raise SceneError(_missing(file, element.attrib["filename"], values))
                visit(included, inner)
            elif element.tag == "spectrum" and "filename" in text:
                found.files.append(resolved(text["filename"], resolver))

    visit(path, _within(_core.file_resolver(), path.parent))
    return found


def substituted(text: str, values: Mapping[str, str]) -> str:
    """``text`` with ``$name`` replaced by the value of that parameter, long names first."""
    for name in sorted(values, key=len, reverse=True):
        if f"${name}" in text:
            literal = values[name].replace("\\", r"\\")
            text = re.sub(rf"(?<!\\)\${re.escape(name)}", literal, text)
    return text


def resolved(name: str, resolver: Any = None) -> Path:
    """Where a file resolver, by default Mitsuba's present one, finds a file."""
    return Path(str((resolver or _core.file_resolver()).resolve(name)))


def _within(resolver: Any, folder: Path) -> Any:
    copy: Any = mi.FileResolver(resolver)
    copy.prepend(str(folder))
    return copy


# --------------------------------------------------------------------- messages


def _check_parameters(path: Path, parameters: Mapping[str, str]) -> None:
    """Raise :class:`SceneError` for a parameter that the scene does not have."""
    try:
        known = sorted(read(path, parameters).parameters)
    except (ET.ParseError, OSError, LookupError, RecursionError):
        return  # Mitsuba's parser says what is wrong
    for name, value in parameters.items():
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            guess = f" (did you mean {close[0]!r}?)" if close else ""
            allowed = f"its parameters are {', '.join(known)}" if known else "it has no parameters"
            given = f"{path} has no parameter {name!r}, given as {value!r}"
            raise SceneError(f"{given}{guess}: {allowed}")


def _missing(path: Path, filename: str, values: Mapping[str, str]) -> str:
    """An ``<include>`` names a file that does not exist."""
    target = path.parent / substituted(filename, values)
    files = sorted(file.stem for file in target.parent.glob(f"*{target.suffix}") if file.is_file())
    allowed = f"it must be one of {', '.join(files)}" if files else "that folder has no scene files"
    name = Path(filename).stem.removeprefix("$")
    if name in values and Path(filename).name == f"${name}{target.suffix}":
        return f"{name} is {values[name]!r}: {allowed} (files of {target.parent})"
    return f"{path} includes {filename!r}, and {target} does not exist: {allowed}"
