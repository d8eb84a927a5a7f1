"""Writing files such that the old one stays until the new one is complete and on disk."""

from __future__ import annotations

import contextlib
import glob
import os
import time
from collections.abc import Iterator
from pathlib import Path

__all__ = ["check_writable", "remove_leftovers", "replacing", "sync_folder", "write_text"]

_RUN = os.urandom(4).hex()  # in a container every run may have the same number of process


@contextlib.contextmanager
def replacing(*targets: Path, backup: Path | None = None) -> Iterator[tuple[Path, ...]]:
    """Give names to write to; at the end of the block these files take the places of ``targets``.

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
    """Write or replace a text file (UTF-8); the path."""
    with replacing(path) as (aside,):
        aside.write_text(text, encoding="utf-8")
    return path


def check_writable(path: Path, *beside: Path) -> None:
    """Raise ``OSError``, about the output ``path``, unless it and ``beside`` can be written.

    Leaves no trace, and existing files alone.
    """
    if not path.parent.is_dir():
        raise OSError(f"output is {str(path)!r}: its folder {str(path.parent)!r} does not exist")
    for target in (path, *beside):
        if target.is_dir():
            what = "it" if target == path else repr(str(target))
            raise OSError(f"output is {str(path)!r}: {what} is a folder")
        try:
            with open(_aside(target), "xb"):
                pass
            os.unlink(_aside(target))
        except OSError as error:
            raise OSError(
                f"output is {str(path)!r}: its folder {str(path.parent)!r} must be writable "
                f"({error.strerror})"
            ) from error


def remove_leftovers(*targets: Path) -> None:
    """Remove what runs that were killed have left beside ``targets``, more than a minute ago."""
    for target in targets:
        for path in target.parent.glob(f".{glob.escape(target.name)}.*.*.part"):
            pid, run = path.name.split(".")[-3:-1]
            with contextlib.suppress(OSError):
                if time.time() - path.stat().st_mtime > 60 and not _is_running(pid, run):
                    path.unlink()


def _is_running(pid: str, run: str) -> bool:
    try:
        if int(pid) == os.getpid():
            return run == _RUN
        os.kill(int(pid), 0)
    except ValueError:
        return True  # not one of ours
    except ProcessLookupError:
        return False
    return True


def sync_folder(folder: Path) -> None:
    """Force the names in a folder to disk, where the system knows of that."""
    if hasattr(os, "O_DIRECTORY"):
        _sync(folder, os.O_RDONLY | os.O_DIRECTORY)


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _aside(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.{_RUN}.part")
