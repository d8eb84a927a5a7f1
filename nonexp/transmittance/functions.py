"""Functions that scene files name as ``module:function``, and modules of users."""

from __future__ import annotations

import contextlib
import importlib
import os
import re
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from modulefinder import ModuleFinder
from pathlib import Path
from types import ModuleType
from typing import Any

__all__ = ["files", "load_function", "load_module"]

_lock = threading.RLock()  # a module may create models of such functions itself
_imported: dict[Path, dict[str, tuple[ModuleType, tuple[int, int]]]] = {}
"""by folder: the modules imported from there, with the state of their files when they were"""


def load_function(label: str, name: Any, folders: Sequence[str] = ()) -> Callable[..., Any]:
    """The function that ``module:function`` names; the module may also lie in one of ``folders``.

    A module in one of the folders takes precedence over any other of its name, and so does what it
    imports from there: two scenes can have modules of the same name. It is imported anew when one
    of these files has changed, so that a scene loaded again finds its law as it is now. Packages
    that the program has imported itself are not replaced.

    The modules keep their own names (not unique ones, under which ``importlib`` could load them
    side by side), since they import each other by these, and since functions are shown, written
    and pickled as ``module:function``.

    Raises ``ValueError`` when there is none. Importing a module runs it.
    """
    words = "a function, or a string module:function"
    if not isinstance(name, str) or not re.fullmatch(r"[\w.]+:[\w.]+", name):
        raise ValueError(f"{label} is {name!r}: it must be {words}")
    module, _, path = name.partition(":")
    found: Any = _load(f"{label} is {name!r}", module, folders)
    for part in path.split("."):
        found = getattr(found, part, None)
    if not callable(found):
        raise ValueError(f"{label} is {name!r}: module {module} has no function {path}")
    return found


def load_module(label: str, name: str, folders: Sequence[str] = ()) -> ModuleType:
    """The module of that name, as :func:`load_function` imports it; raises ``ValueError``."""
    if not re.fullmatch(r"\w+(\.\w+)*", name):
        raise ValueError(f"{label} is {name!r}: it must be the name of a module")
    return _load(f"{label} is {name!r}", name, folders)


def _load(label: str, module: str, folders: Sequence[str]) -> ModuleType:
    beside = [folder.resolve() for folder in map(Path, folders)]
    home = _home(module, beside)
    try:
        with _lock:
            return _import(module, beside) if home is None else _import_from(home, module)
    except ImportError as error:
        raise ValueError(f"{label}: {error}") from error
    except Exception as error:
        raise ValueError(
            f"{label}: module {module} fails with {type(error).__name__}: {error}"
        ) from error


def files(module: str, folders: Iterable[Path]) -> list[Path]:
    """The files that a module in one of the folders is made of: it, and what it imports there.

    Finds the imports by reading, without running them. Empty for a module from elsewhere.
    """
    beside = [folder.resolve() for folder in folders]
    if (home := _home(module, beside)) is None:
        return []
    finder = ModuleFinder([str(home)])
    with contextlib.suppress(ImportError, SyntaxError):  # reported when it is imported
        finder.import_hook(module)
    named: list[Any] = [getattr(found, "__file__", None) for found in finder.modules.values()]
    path = home / module.replace(".", "/")
    named += [file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()]
    return sorted({Path(name).resolve() for name in named if name})


def _home(module: str, folders: Iterable[Path]) -> Path | None:
    return next((folder for folder in folders if _holds(folder, module)), None)


def _import(module: str, folders: Sequence[Path]) -> ModuleType:
    """Import a module, looked for in the folders first."""
    path, writes = list(sys.path), sys.dont_write_bytecode
    sys.path[:0] = [str(folder) for folder in folders]
    sys.dont_write_bytecode = True  # bytecode would hide changes within a second
    try:
        importlib.invalidate_caches()
        return importlib.import_module(module)
    finally:
        sys.path[:], sys.dont_write_bytecode = path, writes


def _holds(folder: Path, module: str) -> bool:
    """Whether a module is a file of the folder, or of a package in it that is free to import."""
    if (folder / f"{module}.py").is_file():
        return True
    top = module.partition(".")[0]
    taken = top in sys.modules and not any(top in names for names in _imported.values())
    return not taken and (folder / top / "__init__.py").is_file()


def _import_from(folder: Path, module: str) -> ModuleType:
    """Import a module that lies in the folder, as it is now.

    Modules of other places, but no packages, step aside meanwhile if they have the name of a file
    in the folder; so does what was imported for another folder. What the program itself imported
    from this folder is used.
    """
    ours = _imported.get(folder, {})
    if any(_state(old) != state for old, state in ours.values()):
        for name, (old, _) in ours.items():
            if sys.modules.get(name) is old:
                del sys.modules[name]
        ours = {}
    names = {file.stem for file in folder.glob("*.py")} - sys.stdlib_module_names
    names = {name for name in names if not hasattr(sys.modules.get(name), "__path__")} | {module}
    names.update(name for home, held in _imported.items() if home != folder for name in held)
    aside = {
        name: sys.modules.pop(name)
        for name in names & sys.modules.keys()
        if not _lies_in(sys.modules[name], folder)
    }
    sys.modules.update({name: old for name, (old, _) in ours.items()})
    before = set(sys.modules)
    try:
        return _import(module, [folder])
    finally:
        for name in sys.modules.keys() - before:
            new = sys.modules[name]
            if name.partition(".")[0] not in before and _lies_in(new, folder):
                ours[name] = new, _state(new)
        _imported[folder] = ours
        sys.modules.update(aside)


def _state(module: ModuleType) -> tuple[int, int]:
    """Modification time and size of a module's file; zeros where it is gone."""
    try:
        status = os.stat(str(module.__file__))
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size


def _lies_in(module: ModuleType, folder: Path) -> bool:
    """Whether a module's file, which may be a link, is in the folder or in a package of it."""
    file = getattr(module, "__file__", None)
    if file is None:
        return False
    home = Path(os.path.realpath(os.path.dirname(file)))
    return "site-packages" not in home.parts and (home == folder or folder in home.parents)
