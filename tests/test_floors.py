"""The rooms of the package stand on floors: a file imports only what stands below it.

Imports are read from the source, not run: those inside functions and under ``TYPE_CHECKING`` count
like any other, and so do dotted names in strings, by which modules are imported at run time. What
importing a module runs besides, the ``__init__.py`` of the folders above it, is left out: between
rooms the floors hold for it anyway, and ``nonexp/__init__.py`` stands above everything.

docs/architecture.md describes the same rooms, and is compared with them here.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "architecture.md"

FLOORS: tuple[tuple[str, ...], ...] = (
    ("system",),
    ("numerics",),
    ("transmittance",),
    ("models",),
    ("plugins",),
    ("scene",),
    ("integrators", "images", "fitting"),
    ("rendering",),
    ("inverse",),
    ("bench", "testing"),
    ("validation",),
    ("cli",),
    ("nonexp",),
)
"""Rooms from the bottom to the top. Rooms of one floor do not know each other; ``nonexp`` is the
front door: the files directly in that folder."""

WITHOUT_MITSUBA = ("numerics", "transmittance", "models", "fitting")
"""Rooms that never import Mitsuba."""

UPWARD = {
    ("nonexp/plugins/registration.py", "integrators/volpath.py"): "Mitsuba makes the integrator by "
    "its name, when a scene asks for it; nothing of it is known below",
}
"""Arrows that run upward all the same: names in strings only, each with the reason."""

COMPUTED = {
    "nonexp/plugins/registration.py": "imports what its tables of strings name",
    "nonexp/transmittance/functions.py": "imports modules of users, which scene files name",
    "nonexp/bench/measure.py": "imports the module of a user's integrator",
}
"""Files that import modules by computed names, each with what these are. Those that import the
files beside them, by a name that begins with ``__package__``, need no mention."""

SAME_NAME = {
    ("nonexp/fitting/__init__.py", "fit"): "nonexp.fitting.fit has been the function since 0.1",
}
"""Names exported by a facade that are also modules of its folder, each with the reason."""

IMPORTERS = {"import_module", "__import__", "run_module", "spec_from_file_location"}
"""Functions that import a module by its name."""


# ------------------------------------------------------------------------------ reading


@dataclass(frozen=True)
class Arrow:
    """A file imports another, or a package from elsewhere."""

    file: str
    line: int
    to: str
    by_name: bool = False
    """in a string, not by an import statement"""
    deferred: bool = False
    """inside a function"""

    def __str__(self) -> str:
        how = "names" if self.by_name else "imports"
        return f"{self.file}, line {self.line}, {how} {self.to}"


@dataclass
class Imports:
    """The imports of one file, or of all."""

    arrows: list[Arrow] = field(default_factory=list)
    """to files of the package"""
    outside: list[Arrow] = field(default_factory=list)
    """to other packages"""
    faults: list[str] = field(default_factory=list)
    """of modules that do not exist, or that cannot be read"""
    wanted: list[tuple[str, int, str, str]] = field(default_factory=list)
    """names that a file imports from another: file, line, name, the other file"""
    computed: set[str] = field(default_factory=set)
    """files that import modules of computed names"""


class House(Imports):
    """All imports of a set of files."""

    def __init__(self, sources: Mapping[str, str]) -> None:
        super().__init__()
        self.sources = sources
        files = frozenset(sources)
        for file, text in sorted(sources.items()):
            found = read(file, text, files)
            self.arrows += found.arrows
            self.outside += found.outside
            self.faults += found.faults
            self.wanted += found.wanted
            self.computed |= found.computed


@cache
def parsed(text: str) -> ast.Module:
    return ast.parse(text)


@cache
def names_in(text: str) -> frozenset[str]:
    """All names that a file binds, local ones too; a star if it imports another file's."""
    found: set[str] = set()
    for node in ast.walk(parsed(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return frozenset(found)


@cache
def read(file: str, text: str, files: frozenset[str]) -> Imports:
    """The imports of one file among these."""
    reader = Reader(file, files)
    reader.visit(parsed(text))
    return reader.found


def module_of(file: str) -> str:
    """Dotted name of a file's module."""
    parts = PurePosixPath(file).with_suffix("").parts
    dotted = ".".join(parts if parts[0] == "nonexp" else ("nonexp", *parts))
    return dotted.removesuffix(".__init__")


def room_of(file: str) -> str:
    parts = PurePosixPath(file).parts
    return parts[1] if parts[0] == "nonexp" and len(parts) > 2 else parts[0]


class Reader(ast.NodeVisitor):
    """Reads the imports of one file."""

    def __init__(self, file: str, files: frozenset[str]) -> None:
        self.found, self.file, self.depth = Imports(), file, 0
        self.files = {module_of(name): name for name in files}
        module = module_of(file)
        self.package = module if file.endswith("__init__.py") else module.rpartition(".")[0]

    def arrow(self, line: int, to: str, by_name: bool = False) -> None:
        if to != self.file:
            self.found.arrows.append(Arrow(self.file, line, to, by_name, self.depth > 0))

    def module(self, line: int, name: str, by_name: bool = False) -> None:
        """An import of the module of that name."""
        top = name.partition(".")[0]
        if name in self.files:
            self.arrow(line, self.files[name], by_name)
        elif top == "nonexp":
            self.found.faults.append(f"{self.file}, line {line}: there is no module {name}")
        elif top == "integrators":
            self.found.faults.append(
                f"{self.file}, line {line}: {name} is installed as nonexp.{name}"
            )
        else:
            self.found.outside.append(Arrow(self.file, line, top, by_name, self.depth > 0))

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            self.module(node.lineno, alias.name)
            if alias.name.startswith("nonexp.") and alias.asname is None:
                self.module(node.lineno, "nonexp")  # the name that it binds

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        base = self.absolute("." * node.level + (node.module or ""))
        for alias in node.names:
            inner = f"{base}.{alias.name}"
            self.module(node.lineno, inner if inner in self.files else base)
            if base in self.files and inner not in self.files:
                self.found.wanted.append((self.file, node.lineno, alias.name, self.files[base]))

    def absolute(self, name: str) -> str:
        """The full name of a module that may be given relative to this file."""
        level = len(name) - len(name.lstrip("."))
        if not level:
            return name
        above = self.package.split(".")
        return ".".join([*above[: len(above) - level + 1], *filter(None, [name[level:]])])

    def visit_Call(self, node: ast.Call) -> None:
        function = node.func
        name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
        if name in IMPORTERS:
            given = node.args[0] if node.args else None
            if isinstance(given, ast.Constant) and isinstance(given.value, str):
                self.module(node.lineno, self.absolute(given.value), by_name=True)
                return
            if self.beside(given):
                for other in sorted(self.files.values()):
                    path = PurePosixPath(other)
                    if path.parent == PurePosixPath(self.file).parent and path.stem != "__init__":
                        self.arrow(node.lineno, other, by_name=True)
                return
            self.found.computed.add(self.file)
            if self.file not in COMPUTED:
                self.found.faults.append(
                    f"{self.file}, line {node.lineno}, imports a module of a computed name: "
                    "name the file in COMPUTED, with what it imports"
                )
        self.generic_visit(node)

    def beside(self, name: ast.expr | None) -> bool:
        """Whether a computed name is that of a file in the same folder: f"{__package__}.{name}"."""
        if not isinstance(name, ast.JoinedStr) or len(name.values) < 2:
            return False
        first, dot = name.values[:2]
        own = {"__package__", "__name__"} if self.file.endswith("__init__.py") else {"__package__"}
        return (
            isinstance(first, ast.FormattedValue)
            and ast.unparse(first.value) in own
            and isinstance(dot, ast.Constant)
            and dot.value == "."
        )

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):  # docstrings are prose
            self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str) and re.fullmatch(r"nonexp(\.\w+)+(:\w+)?", node.value):
            name = node.value.partition(":")[0]
            while name not in self.files:
                name = name.rpartition(".")[0]
            if name != "nonexp":
                self.arrow(node.lineno, self.files[name], by_name=True)

    def _inside(self, node: ast.AST) -> None:
        self.depth += 1
        self.generic_visit(node)
        self.depth -= 1

    visit_FunctionDef = visit_AsyncFunctionDef = visit_Lambda = _inside


SOURCES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for folder in ("nonexp", "integrators")
    for path in sorted((ROOT / folder).rglob("*.py"))
}
HOUSE = House(SOURCES)


# ------------------------------------------------------------------------------ the rules


def upward(house: House) -> Iterator[str]:
    """Imports of what does not stand below, and files in rooms without a floor."""
    floor = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
    for room in sorted({room_of(file) for file in house.sources} - floor.keys()):
        yield f"nonexp/{room}/ has no floor: add it to FLOORS"
    for arrow in house.arrows:
        here, there = room_of(arrow.file), room_of(arrow.to)
        allowed = arrow.by_name and (arrow.file, arrow.to) in UPWARD
        if {here, there} <= floor.keys() and here != there and not allowed:
            if floor[there] >= floor[here]:
                below = ", ".join(room for rooms in FLOORS[: floor[here]] for room in rooms)
                yield f"{arrow}: {here} may import only {below or 'nothing'}"


def circles(house: House) -> Iterator[str]:
    """Shortest circles through files that import each other, each told once."""
    told: set[str] = set()
    onward: dict[str, dict[str, Arrow]] = {file: {} for file in house.sources}
    for arrow in house.arrows:
        if (arrow.file, arrow.to) not in UPWARD:
            onward[arrow.file].setdefault(arrow.to, arrow)
    for start in sorted(onward):
        circle = _circle(onward, start)
        if circle and not told & {arrow.file for arrow in circle}:
            told |= {arrow.file for arrow in circle}
            yield "a circle: " + "; ".join(map(str, circle))


def _circle(onward: Mapping[str, Mapping[str, Arrow]], start: str) -> list[Arrow]:
    """The shortest way along arrows from a file back to it; empty if there is none."""
    ways: dict[str, list[Arrow]] = {start: []}
    queue = [start]
    for file in queue:
        for to, arrow in onward[file].items():
            if to == start:
                return [*ways[file], arrow]
            if to not in ways:
                ways[to] = [*ways[file], arrow]
                queue.append(to)
    return []


def named(house: House) -> Iterator[str]:
    """Imports that cannot be followed, and exceptions that nothing needs."""
    yield from house.faults
    for file, line, name, to in house.wanted:
        if name != "*" and not {name, "*"} & names_in(house.sources[to]):
            yield f"{file}, line {line}: there is no {name} in {to}"
    for file in COMPUTED.keys() - house.computed:
        yield f"{file} imports no module of a computed name: take it out of COMPUTED"
    by_name = {(arrow.file, arrow.to) for arrow in house.arrows if arrow.by_name}
    for file, to in UPWARD.keys() - by_name:
        yield f"{file} does not name {to}: take it out of UPWARD"


def mitsuba(house: House) -> Iterator[str]:
    """Imports of Mitsuba where it is not known, or before LLVM has been chosen."""
    door = "nonexp/__init__.py"
    chosen = next(
        node.lineno
        for node in parsed(house.sources[door]).body
        if isinstance(node, ast.Expr) and "select_llvm()" in ast.unparse(node)
    )
    first = [door]  # what runs before that line
    for file in first:
        for arrow in house.arrows:
            early = file != door or arrow.line < chosen
            if arrow.file == file and early and not arrow.deferred and arrow.to not in first:
                first.append(arrow.to)
    for arrow in house.outside:
        room = room_of(arrow.file)
        if arrow.to == "mitsuba" and room in WITHOUT_MITSUBA:
            yield f"{arrow}: {room} works without Mitsuba"
        if arrow.to in ("mitsuba", "drjit") and arrow.file in first[1:] and not arrow.deferred:
            yield f"{arrow} before LLVM is chosen: import it inside a function"


def at_import(node: ast.AST) -> Iterator[ast.AST]:
    """What is evaluated when a file is imported: all but the bodies of functions."""
    yield node
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from at_import(child)


def variants(house: House) -> Iterator[str]:
    """Classes derived from Mitsuba's live in modules that registration evaluates for each variant:
    these are reached by name, never imported. Those inside functions are made when these run."""
    registration = "nonexp/plugins/registration.py"
    anew = {arrow.to for arrow in house.arrows if arrow.file == registration and arrow.by_name}
    for arrow in house.arrows:
        if arrow.to in anew and not arrow.by_name:
            yield f"{arrow}, which is evaluated anew for each variant: reach it by name"
    for file, text in house.sources.items():
        for node in at_import(parsed(text)):
            if isinstance(node, ast.ClassDef) and file not in anew:
                if any(ast.unparse(base).startswith(("mi.", "mitsuba.")) for base in node.bases):
                    yield (
                        f"{file}, line {node.lineno}: class {node.name} derives from a class of "
                        f"one variant, but {registration} does not name the file"
                    )


def facades(house: House) -> Iterator[str]:
    """Names that an ``__init__.py`` binds although they are modules beside it, modules that its
    docstring lists but that do not exist, and a front door that opens the command."""
    used = set()
    for file, text in house.sources.items():
        if not file.endswith("__init__.py"):
            continue
        tree = parsed(text)
        package = module_of(file)
        modules = {module_of(other) for other in house.sources}
        for name, line, origin in _bound(tree, package):
            own = f"{package}.{name}"
            if own in modules and origin != own:
                if (file, name) not in SAME_NAME:
                    yield f"{file}, line {line}: {name} is also the module {own}"
                used.add((file, name))
        for name in re.findall(r"^``(\w+)``  ", ast.get_docstring(tree) or "", re.MULTILINE):
            if f"{package}.{name}" not in modules:
                yield f"{file}: its docstring lists {name}, which is not a module of it"
    for file, name in SAME_NAME.keys() - used:
        yield f"{file} does not export {name}: take it out of SAME_NAME"
    for arrow in house.arrows:
        if arrow.file == "nonexp/__init__.py" and room_of(arrow.to) in (
            "bench",
            "cli",
            "testing",
            "validation",
        ):
            yield f"{arrow}: import nonexp loads neither the command nor what it alone needs"


def _bound(tree: ast.Module, package: str) -> Iterator[tuple[str, int, str]]:
    """Names that a facade binds, with the line, and the module beside it that each one is."""
    for node in tree.body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                whole = node.module is None and node.level == 1
                yield alias.asname or alias.name, node.lineno, f"{package}.{alias.name}" * whole
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node.lineno, ""
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                if isinstance(target, ast.Name):
                    yield target.id, node.lineno, ""


RULES = (upward, circles, named, mitsuba, variants, facades)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_rule_holds(rule: type) -> None:
    found = list(rule(HOUSE))
    assert not found, "\n".join(found)


# ------------------------------------------------------------------------------ planted faults


GAMMA = "nonexp/models/gamma.py"
PASSES, RENDER = "nonexp/rendering/passes.py", "nonexp/rendering/render.py"
INSIDE = "def later():\n    "

PLANTED = (
    (upward, GAMMA, "from ..rendering import passes", PASSES),
    (upward, GAMMA, INSIDE + "from ..rendering.passes import plan", PASSES),
    (upward, GAMMA, "from nonexp.plugins import install", "nonexp/plugins/__init__.py"),
    (upward, GAMMA, "import nonexp.scene.walk as walk", "nonexp/scene/walk.py"),
    (upward, GAMMA, "import nonexp.numerics.special", "nonexp/__init__.py"),
    (upward, GAMMA, "from .. import render", "nonexp/__init__.py"),
    (upward, GAMMA, INSIDE + "import nonexp", "nonexp/__init__.py"),
    (upward, GAMMA, "from .. import parameters", "nonexp/parameters.py"),
    (upward, GAMMA, "if TYPE_CHECKING:\n    from ..images.image import Image", "images/image.py"),
    (upward, GAMMA, 'import_module("nonexp.scene.walk")', "nonexp/scene/walk.py"),
    (upward, GAMMA, 'importlib.import_module("..scene.walk", __package__)', "scene/walk.py"),
    (upward, GAMMA, 'TABLE = {"a": ("nonexp.scene.walk", "objects")}', "nonexp/scene/walk.py"),
    (upward, GAMMA, 'WHERE = "nonexp.scene.walk:objects"', "nonexp/scene/walk.py"),
    (upward, "integrators/jit.py", "from .. import rendering", "nonexp/rendering/__init__.py"),
    (upward, "integrators/jit.py", "from ..images import exr", "nonexp/images/exr.py"),
    (upward, "nonexp/fitting/fit.py", "from ..images import exr", "nonexp/images/exr.py"),
    (upward, RENDER, "from .. import cli", "nonexp/cli/__init__.py"),
    (upward, "nonexp/plugins/registration.py", "from ..integrators import volpath", "volpath.py"),
    (circles, GAMMA, "from . import names", "nonexp/models/__init__.py"),
    (circles, GAMMA, "from .mixture import Mixture", "nonexp/models/mixture.py"),
    (circles, GAMMA, INSIDE + "from nonexp.models.mixture import Mixture", "models/mixture.py"),
    (circles, "nonexp/numerics/elementary.py", "from .special import x", "numerics/special.py"),
    (circles, "nonexp/numerics/elementary.py", "from . import select", "numerics/__init__.py"),
    (circles, "nonexp/cli/render.py", "from . import main", "nonexp/cli/"),
    (circles, PASSES, "x = 1\nfrom .render import render", RENDER),
    (named, GAMMA, INSIDE + "from ..numerics.gone import x", "nonexp.numerics.gone"),
    (named, GAMMA, INSIDE + "from ..numerics.special import gone", "gone in nonexp/numerics/"),
    (named, GAMMA, "import integrators.volpath", "nonexp.integrators.volpath"),
    (circles, "nonexp/scene/messages.py", 'import_module(f"{__package__}.{x}")', "scene/files.py"),
    (named, GAMMA, "import_module(name)", "computed"),
    (named, GAMMA, 'import_module(f"{__name__}.{name}")', "computed"),
    (named, GAMMA, 'import_module(f"nonexp.{name}")', "computed"),
    (mitsuba, GAMMA, INSIDE + "import mitsuba as mi", "mitsuba"),
    (mitsuba, "nonexp/fitting/plot.py", "from mitsuba import Bitmap", "mitsuba"),
    (mitsuba, "nonexp/system/machine.py", "import drjit as dr", "drjit"),
    (mitsuba, "nonexp/system/version.py", "from mitsuba import Bitmap", "mitsuba"),
    (variants, "integrators/report.py", "from .volpath import NonexpVolpath", "volpath.py"),
    (variants, "integrators/report.py", "class Mine(mi.Texture):\n    pass", "class Mine"),
    (facades, "nonexp/images/__init__.py", "from .compare import compare", "nonexp.images.compare"),
    (facades, "nonexp/rendering/__init__.py", "def render(): ...", "nonexp.rendering.render"),
    (facades, "nonexp/__init__.py", "from . import cli", "nonexp/cli/__init__.py"),
)


def planted(rule: type, sources: Mapping[str, str]) -> list[str]:
    """What a rule finds beyond what it finds without these sources."""
    return sorted(set(rule(House({**SOURCES, **sources}))) - set(rule(HOUSE)))


@pytest.mark.parametrize("rule, file, code, other", PLANTED)
def test_planted_fault_is_named(rule: type, file: str, code: str, other: str) -> None:
    """The sentence names the file, the line and what must not be imported."""
    text = SOURCES[file] + code + "\n"
    (sentence,) = planted(rule, {file: text})
    assert file in sentence and other in sentence
    added = range(SOURCES[file].count("\n") + 1, text.count("\n") + 1)
    assert any(re.search(rf"line {line}\b", sentence) for line in added)


def test_new_room_needs_a_floor() -> None:
    (sentence,) = planted(upward, {"nonexp/attic/junk.py": "from .. import models\n"})
    assert "nonexp/attic/" in sentence


def test_circle_of_three_files() -> None:
    circle = {
        "nonexp/system/a.py": "from . import b\n",
        "nonexp/system/b.py": "\nfrom .c import x\n",
        "nonexp/system/c.py": "\n\ndef f():\n    from nonexp.system.a import y\n",
    }
    (sentence,) = planted(circles, circle)
    assert sentence == (
        "a circle: nonexp/system/a.py, line 1, imports nonexp/system/b.py; "
        "nonexp/system/b.py, line 2, imports nonexp/system/c.py; "
        "nonexp/system/c.py, line 4, imports nonexp/system/a.py"
    )


def test_exceptions_that_nothing_needs_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    before = {*named(HOUSE), *facades(HOUSE)}
    monkeypatch.setitem(COMPUTED, GAMMA, "nothing")
    monkeypatch.setitem(UPWARD, (GAMMA, RENDER), "nothing")
    monkeypatch.setitem(SAME_NAME, ("nonexp/images/__init__.py", "exr"), "nothing")
    assert len({*named(HOUSE), *facades(HOUSE)} - before) == 3


# ------------------------------------------------------------------------------ the page


TEXT = PAGE.read_text(encoding="utf-8")


def section(text: str, heading: str) -> str:
    """What stands under a heading, up to the next of its rank."""
    rank = re.match("#+", heading)
    assert rank is not None
    found = re.search(
        rf"^{re.escape(heading)}(?!\S)[^\n]*\n(.*?)(?=^#{{1,{len(rank[0])}}} |\Z)",
        text,
        re.M | re.S,
    )
    assert found is not None, f"docs/architecture.md has no heading {heading}"
    return found[1]


def table(text: str) -> list[list[str]]:
    """The rows of the first table, without its head."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def quoted(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def test_page_has_the_floors() -> None:
    rows = table(section(TEXT, "## Floors"))
    assert [tuple(quoted(row[0])) for row in rows] == list(reversed(FLOORS))
    for row in rows:
        knows = dict(zip(quoted(row[0]), row[2].split(", "), strict=True))
        for room in knows:
            assert (knows[room] == "no") == (room in WITHOUT_MITSUBA), room


ROOMS = [room for rooms in FLOORS for room in rooms]


@pytest.mark.parametrize("room", ROOMS)
def test_page_has_every_file(room: str) -> None:
    rows = table(section(TEXT, f"### `{room}`"))
    folder = ROOT if room in ("nonexp", "integrators") else ROOT / "nonexp"
    files = {
        path.relative_to(folder / room).as_posix()
        for path in (folder / room).glob("*.py" if room == "nonexp" else "**/*.py")
    }
    told = [name for row in rows for name in quoted(row[0])]
    assert sorted(told) == sorted(files)
    assert all(len(row) == 2 and row[1] for row in rows)


def test_page_names_the_exceptions() -> None:
    """Every arrow that may not be, and every exception, is on the page."""
    rules = section(TEXT, "## Arrows that may not be")
    for file, to in UPWARD:
        assert f"`{file}`" in rules and f"`{to}`" in rules
    for file in COMPUTED:
        assert f"`{file}`" in rules
    for file, name in SAME_NAME:
        assert f"`{file}`" in rules and f"`{name}`" in rules
    for room in WITHOUT_MITSUBA:
        assert f"`{room}`" in rules


def defined(body: Iterable[ast.stmt], prefix: str = "") -> Iterator[str]:
    """Names of functions, classes, methods and assigned names."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield prefix + node.name
            yield from defined(node.body, f"{prefix}{node.name}.")
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from (prefix + target.id for target in targets if isinstance(target, ast.Name))


FINDINGS = table(section(TEXT, "## Where to find things"))


@pytest.mark.parametrize("question, file, names", FINDINGS)
def test_things_are_where_the_page_says(question: str, file: str, names: str) -> None:
    (path,) = quoted(file)
    tree = parsed((ROOT / path).read_text(encoding="utf-8"))
    missing = set(quoted(names)) - set(defined(tree.body))
    assert not missing, f"{question} {path} does not define {', '.join(sorted(missing))}"


def test_paths_of_the_page_exist() -> None:
    for name in quoted(re.sub(r"^```.*?^```$", "", TEXT, flags=re.MULTILINE | re.DOTALL)):
        if re.fullmatch(r"[\w./-]+", name) and "/" in name:
            folders = (ROOT, *(ROOT / "nonexp" / room for room in ROOMS))
            assert any((folder / name).exists() for folder in folders), name
