"""The files that make up a scene: which they are, their checksums, and an archive of them."""

from __future__ import annotations

import hashlib
import io
import os
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi

from ..transmittance import functions
from .parse import parsed, read, resolved

__all__ = ["SceneFiles", "collect"]

_MODULE = re.compile(r"([\w.]+):[\w.]+")  # as in the parameter ff of the model custom


@dataclass(frozen=True)
class SceneFiles:
    """A scene file, and every file that it includes or refers to."""

    root: Path
    others: tuple[Path, ...]

    @property
    def folder(self) -> Path:
        """The innermost folder that holds all of them."""
        return Path(os.path.commonpath([path.parent for path in (self.root, *self.others)]))

    def digests(self) -> dict[str, str]:
        """Checksum of each file, by its name relative to the folder of the scene file."""
        return {
            Path(os.path.relpath(path, self.root.parent)).as_posix(): _digest(path)
            for path in (self.root, *self.others)
        }

    def check_movable(self) -> None:
        """Raise ``ValueError`` if the scene would not find its files again in another folder."""
        for path in (self.root, *self.others):
            if path.suffix == ".xml":
                text = path.read_text(encoding="utf-8", errors="replace")
                for other in self.others:
                    if str(other) in text:
                        raise ValueError(
                            f"{path} refers to {str(other)!r} by an absolute path: "
                            "scenes for a cluster must use relative ones"
                        )

    def pack(self) -> bytes:
        """All files as a ZIP archive, with their names relative to :attr:`folder`."""
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for path in (self.root, *self.others):
                # A date of its own would give equal files different archives.
                entry = zipfile.ZipInfo(path.relative_to(self.folder).as_posix())
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, path.read_bytes())
        return buffer.getvalue()


def collect(path: Path, parameters: Mapping[str, str]) -> SceneFiles:
    """The files of a scene, with parameters as for :func:`nonexp.scene.load.load`.

    Every ``<string>`` that is the name of a file counts as a reference to it; so does
    ``module:function``, where the module lies beside the scene file, to that and to what it
    imports from there. Raises :class:`~nonexp.scene.messages.SceneError` as ``load`` does.
    """
    root = path.resolve()
    with parsed(root, parameters) as (_, state):
        found = set(read(root, parameters).files)
        for node in state.nodes:
            for name in node.props.keys():
                if node.props.type(name) == mi.Properties.Type.String:
                    found.update(_files(node.props[name]))
    return SceneFiles(root, tuple(sorted({file.resolve() for file in found} - {root})))


def _files(value: str) -> list[Path]:
    """The files that a string in a scene stands for: one by its name, or those of a module."""
    if match := _MODULE.fullmatch(value):
        return functions.files(match[1], [Path(str(folder)) for folder in mi.file_resolver()])
    file = resolved(value)
    return [file] if os.path.isfile(file) else []


def _digest(path: Path) -> str:
    digest = hashlib.blake2b(digest_size=16)
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
