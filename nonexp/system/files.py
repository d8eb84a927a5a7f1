"""Writing files: the old file stays until the new one is complete and on disk."""

from __future__ import annotations

import contextlib
import glob
import os
import time
from collections.abc import Iterator
from pathlib import Path

__all__ = ["check_writable", "remove_leftovers", "replacing", "sync_folder", "write_text"]

_LEFT_OVER = 86400.0
"""Seconds after which a temporary file belongs to a process that was killed."""


@contextlib.contextmanager
def replacing(*targets: Path, backup: Path | None = None) -> Iterator[tuple[Path, ...]]:
    """Give temporary names to write to; at the end of the block the files replace ``targets``.

    They lie in the same folders, and are forced to disk before they replace anything; ``backup``
    becomes what the first target was before. If the block, or forcing to disk, fails, the targets
    stay as they were and nothing else is left.
    """
    aside = tuple(_aside(target) for target in targets)
    try:
        yield aside
        for path in aside:
            _sync(path, os.O_RDWR)
        if backup is not None and targets[0].exists():
            os.replace(targets[0], backup)
        for path, target in zip(aside, targets, strict=True):
            os.replace(path, target)
        for folder in {target.parent for target in targets}:
            sync_folder(folder)
    finally:
        for path in aside:
            path.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> Path:
    """Write or replace a text file (UTF-8); returns the path."""
    with replacing(path) as (aside,):
        aside.write_text(text, encoding="utf-8")
    return path


def check_writable(path: Path, *beside: Path, name: str = "output") -> None:
    """Raise ``OSError`` unless ``path`` and the files ``beside`` it can be written.

    The message calls ``path`` by ``name``. Leaves no trace, and existing files alone.
    """
    said = f"{name} is {str(path)!r}"
    if not path.parent.is_dir():
        raise OSError(f"{said}: its folder {str(path.parent)!r} does not exist")
    for target in (path, *beside):
        if target.is_dir():
            raise OSError(f"{said}: {'it' if target == path else repr(str(target))} is a folder")
        aside = _aside(target)
        try:
            with open(aside, "xb"):
                pass
            os.unlink(aside)
        except OSError as error:
            raise OSError(
                f"{said}: its folder {str(path.parent)!r} must be writable ({error.strerror})"
            ) from error


def remove_leftovers(*targets: Path) -> None:
    """Remove temporary files beside ``targets`` that killed runs left more than a day ago."""
    for target in targets:
        for path in target.parent.glob(f".{glob.escape(target.name)}.*.part"):
            with contextlib.suppress(OSError):
                if time.time() - path.stat().st_mtime > _LEFT_OVER:
                    path.unlink()


def sync_folder(folder: Path) -> None:
    """Force the names in a folder to disk, on systems that can do so."""
    if hasattr(os, "O_DIRECTORY"):
        _sync(folder, os.O_RDONLY | os.O_DIRECTORY)


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _aside(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.urandom(8).hex()}.part")
