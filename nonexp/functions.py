"""Functions that scene files name as ``module:function``."""

from __future__ import annotations

import importlib
import os
import re
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

__all__ = ["load_function"]

_Files = dict[str, tuple[int, int]]  # names of modules: time of change and size
_lock = threading.RLock()  # a module may make models of such functions itself
_imported: dict[Path, tuple[_Files, dict[str, ModuleType]]] = {}
"""by folder: its files at the time, and the modules that were imported from there"""


def load_function(label: str, name: Any, folders: Sequence[str] = ()) -> Callable[..., Any]:
    """The function that ``module:function`` names; the module may also lie in one of ``folders``.

    A file ``module.py`` in one of the folders comes before any other module of its name, and is
    imported anew when a Python file of the folder has changed: two scenes can have modules of the
    same name, and a scene that is loaded again finds its law as it is now.

    Raises ``ValueError`` when there is none. Importing a module runs it.
    """
    words = "a function, or a string module:function"
    if not isinstance(name, str) or not re.fullmatch(r"[\w.]+:[\w.]+", name):
        raise ValueError(f"{label} is {name!r}: it must be {words}")
    module, _, path = name.partition(":")
    beside = [folder.resolve() for folder in map(Path, folders)]
    home = next((folder for folder in beside if (folder / f"{module}.py").is_file()), None)
    try:
        with _lock:
            found: Any = _import(module, beside) if home is None else _import_from(home, module)
    except ImportError as error:
        raise ValueError(f"{label} is {name!r}: {error}") from error
    except Exception as error:
        raise ValueError(
            f"{label} is {name!r}: module {module} fails with {type(error).__name__}: {error}"
        ) from error
    for part in path.split("."):
        found = getattr(found, part, None)
    if not callable(found):
        raise ValueError(f"{label} is {name!r}: module {module} has no function {path}")
    return found


def _import(module: str, folders: Sequence[Path]) -> ModuleType:
    """Import a module, looked for in the folders first."""
    path, writes = list(sys.path), sys.dont_write_bytecode
    sys.path[:0] = [str(folder) for folder in folders]
    sys.dont_write_bytecode = True  # it would hide changes within a second
    try:
        importlib.invalidate_caches()
        return importlib.import_module(module)
    finally:
        sys.path[:], sys.dont_write_bytecode = path, writes


def _import_from(folder: Path, module: str) -> ModuleType:
    """Import a module that lies in the folder, as it is now.

    Modules of other folders that are in the way (of its name, or imported by scenes of theirs) step
    aside meanwhile. What somebody else imported from this folder is taken as it is.
    """
    files = {path.stem: _state(path) for path in folder.glob("*.py") if path.is_file()}
    then, ours = _imported.get(folder, (files, {}))
    if then != files:
        for name, old in ours.items():
            if sys.modules.get(name) is old:
                del sys.modules[name]
        ours = {}
    others = {name for _, modules in _imported.values() for name in modules}
    aside = {
        name: sys.modules.pop(name)
        for name in (others | {module}) & files.keys() & sys.modules.keys()
        if not _lies_in(sys.modules[name], folder)
    }
    sys.modules.update(ours)
    before = set(sys.modules)
    try:
        return _import(module, [folder])
    finally:
        new = files.keys() & sys.modules.keys() - before
        ours |= {name: sys.modules[name] for name in new if _lies_in(sys.modules[name], folder)}
        _imported[folder] = files, ours
        sys.modules.update(aside)


def _state(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_mtime_ns, status.st_size


def _lies_in(module: ModuleType, folder: Path) -> bool:
    file = getattr(module, "__file__", None)  # may be a link, of another folder's file
    return file is not None and Path(os.path.realpath(os.path.dirname(file))) == folder
