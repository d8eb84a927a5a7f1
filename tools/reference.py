"""Write the reference pages of docs/ from the docstrings and from the help of the command line.

.venv/bin/python tools/reference.py           docs/models.md, plugins.md, python.md, cli.md

The test suite fails when a page is not what this would write.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
from cyclopts import App
from cyclopts.argument import Argument
from docstrings import field_docs, inline, manual

import nonexp
from nonexp import fitting, images, inverse, models, parameters, rendering, testing
from nonexp.cli import app as command_line
from nonexp.fitting import plot as plotting
from nonexp.plugins import registration

DOCS = Path(__file__).resolve().parent.parent / "docs"


def fence(language: str, text: str) -> str:
    return f"```{language}\n{text}\n```"


def table(head: tuple[str, str], rows: list[tuple[str, str]]) -> str:
    lines = [head, ("---", "---"), *rows]
    return "\n".join("| " + " | ".join(c.replace("|", "\\|") for c in row) + " |" for row in lines)


def in_python(value: Any, indent: int = 0) -> str:
    """A scene dictionary as ruff would lay it out."""
    line = json.dumps(value)
    if not isinstance(value, dict) or indent + len(line) <= 96:
        return line
    margin = " " * (indent + 4)
    items = [f"{margin}{json.dumps(k)}: {in_python(v, indent + 4)}," for k, v in value.items()]
    return "\n".join(["{", *items, " " * indent + "}"])


# --------------------------------------------------------------------------------- docs/models.md

MODELS = """\
# Models

Written by `tools/reference.py` from the docstrings of `nonexp/models/`; `nonexp models`
prints the short form, `nonexp plot MODEL` draws one. `T` is the transmittance between two points
that are not correlated with the scatterers, over optical depth `tau`; `sigma_bar = -T'(0)` the
mean extinction per unit of it. [accuracy.md](accuracy.md) has the errors in single precision,
[theory.md](theory.md) what the functions mean, [gallery.md](gallery.md) a picture of each model.

Every model is a texture `transmittance_<model>`, nested in a medium,
`nonexp_homogeneous` or `nonexp_heterogeneous` ([plugins.md](plugins.md)), from XML or, the second
form, from a dictionary of `mi.load_dict`."""


def models_page() -> str:
    links = ", ".join(f"[{key}](#{key})" for key in models.names())
    return "\n\n".join([MODELS, links + ".", *(_model(key) for key in models.names())]) + "\n"


def _model(key: str) -> str:
    cls = models.registry[key]
    model = models.create(key, **cls.examples[0])
    rows = []
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        name, _, doc = parameters.describe(field).partition(": ")
        rows.append((f"`{name}`", inline(doc)))
    return "\n\n".join(
        [
            f"## {key}",
            manual(cls),
            table(("parameter", "meaning"), rows) if rows else "No parameters.",
            f"`sigma_bar` = {float(model.sigma_bar):g} for",
            fence("xml", models.to_xml(model)),
            fence("python", in_python(models.to_dict(model))),
        ]
    )


# -------------------------------------------------------------------------------- docs/plugins.md

PLUGINS = """\
# Plugins

Written by `tools/reference.py` from the docstrings. `import nonexp` makes these known to
Mitsuba, in every `llvm_*` and `cuda_*` variant but the polarised ones, whether the variant is set
before or after. In scenes they stand beside all of Mitsuba's own plugins.

There are two media: `nonexp_homogeneous`, and `nonexp_heterogeneous` for a density on a grid.
Examples are given in XML and as a dictionary. `nonexp cloud cloud.npz` and `nonexp cloud cloud.vol`
make the files that the examples of the latter name."""

EXAMPLES: dict[str, tuple[str, dict[str, Any]]] = {
    "nonexp_homogeneous": (
        """\
<medium type="nonexp_homogeneous" name="interior">
    <rgb name="sigma_t" value="1.5, 2, 3"/>
    <float name="albedo" value="0.9"/>
    <phase type="hg"> <float name="g" value="0.6"/> </phase>
    <texture type="transmittance_gamma" name="transmittance">
        <float name="alpha" value="0.5"/>
    </texture>
</medium>""",
        {
            "type": "nonexp_homogeneous",
            "sigma_t": {"type": "rgb", "value": [1.5, 2, 3]},
            "albedo": 0.9,
            "phase": {"type": "hg", "g": 0.6},
            "transmittance": {"type": "transmittance_gamma", "alpha": 0.5},
        },
    ),
    "nonexp_heterogeneous": (
        """\
<medium type="nonexp_heterogeneous" name="interior">
    <string name="filename" value="cloud.npz"/>
    <transform name="to_world"> <translate value="-0.5"/> <scale value="2"/> </transform>
    <float name="extinction" value="12"/>
    <float name="albedo" value="0.999"/>
    <phase type="hg"> <float name="g" value="0.4"/> </phase>
    <texture type="transmittance_gamma" name="transmittance"/>
</medium>""",
        {
            "type": "nonexp_heterogeneous",
            "sigma_t": {"type": "gridvolume", "filename": "cloud.vol"},
            "scale": 12.0,
            "albedo": 0.999,
            "phase": {"type": "hg", "g": 0.4},
            "transmittance": {"type": "transmittance_linear", "b": 1.0},
        },
    ),
    "nonexp_binary_mixture": (
        """\
<medium type="nonexp_binary_mixture" name="interior">
    <string name="sigma_t" value="20, 0.5"/>
    <string name="chord" value="0.1, 0.4"/>
    <rgb name="albedo_0" value="0.9, 0.6, 0.3"/>
    <float name="albedo_1" value="0.99"/>
    <phase type="isotropic" name="phase_0"/>
    <phase type="hg" name="phase_1"> <float name="g" value="0.8"/> </phase>
</medium>""",
        {
            "type": "nonexp_binary_mixture",
            "sigma_t": "20, 0.5",
            "chord": "0.1, 0.4",
            "albedo_0": {"type": "rgb", "value": [0.9, 0.6, 0.3]},
            "albedo_1": 0.99,
            "phase_0": {"type": "isotropic"},
            "phase_1": {"type": "hg", "g": 0.8},
        },
    ),
    "nonexp_sobol": (
        """\
<sampler type="nonexp_sobol">
    <integer name="sample_count" value="64"/>
</sampler>""",
        {"type": "nonexp_sobol", "sample_count": 64},
    ),
    "nonexp_volpath": (
        """\
<integrator type="nonexp_volpath">
    <integer name="max_depth" value="64"/>
</integrator>""",
        {"type": "nonexp_volpath", "max_depth": 64},
    ),
    "transmittance_<model>": (
        """\
<texture type="transmittance_mixture" name="transmittance">
    <texture type="transmittance_exponential"/>
    <texture type="transmittance_linear"> <float name="b" value="2"/> </texture>
    <string name="weight" value="0.3, 0.7"/>
</texture>""",
        {
            "type": "transmittance_mixture",
            "model_0": {"type": "transmittance_exponential"},
            "model_1": {"type": "transmittance_linear", "b": 2.0},
            "weight": "0.3, 0.7",
        },
    ),
}


def plugins_page() -> str:
    pages = [PLUGINS]
    known = {
        **registration._PLUGINS,
        "transmittance_<model>": ("texture", *registration._TEXTURE),
    }
    for name, (kind, module, cls_name) in known.items():
        cls = getattr(importlib.import_module(module), cls_name)
        xml, scene = EXAMPLES.get(name, (f'<{kind} type="{name}"/>', {"type": name}))
        pages += [f"## {kind} `{name}`", manual(cls), fence("xml", xml)]
        pages.append(fence("python", in_python(scene)))
    return "\n\n".join(pages) + "\n"


# --------------------------------------------------------------------------------- docs/python.md

PYTHON = """\
# Python

Written by `tools/reference.py` from the docstrings. What is not listed here may change without
notice. Arrays are NumPy's; models compute with Python floats and Dr.Jit's arrays."""

DOCUMENTED: dict[str, tuple[Any, tuple[str, ...]]] = {
    "nonexp": (nonexp, ("render", "Image", "Transmittance", "parameter", "read_grid")),
    "nonexp.models": (models, ("create", "names", "register", "fit", "to_dict", "to_xml")),
    "nonexp.fitting": (fitting, ("Fit", "compare", "read_table")),
    "nonexp.parameters": (parameters, ("whole", "vector", "text", "function", "components")),
    "nonexp.rendering": (rendering, ("plan", "planned", "render_passes")),
    "nonexp.inverse": (
        inverse,
        (
            "fit",
            "Report",
            "ImageFit",
            "descend",
            "Descent",
            "jacobian",
            "differences",
            "Derivative",
        ),
    ),
    "nonexp.testing": (
        testing,
        ("check_law", "check_integrator", "assert_same_image", "assert_mean", "Agreement"),
    ),
    "nonexp.images": (images, ("read", "tone_map", "write")),
    "nonexp.fitting.plot": (plotting, ("plot_model", "plot_fit")),
}


def python_page() -> str:
    pages = [PYTHON]
    for prefix, (module, names) in DOCUMENTED.items():
        pages.append(f"## {prefix}")
        for name in names:
            pages += _documented(f"{prefix}.{name}", getattr(module, name))
    return "\n\n".join(pages) + "\n"


def _documented(name: str, thing: Any) -> Iterator[str]:
    yield f"### `{name}`"
    if not inspect.isclass(thing):
        yield fence("text", _signature(thing))
        yield manual(thing)
        return
    yield manual(thing)
    rows = [(f"`{field}`", doc) for field, doc in field_docs(thing).items()]
    if rows:
        yield table(("field", "meaning"), rows)
    members = []
    for member, value in vars(thing).items():
        function = value.fget if isinstance(value, property) else value
        text = manual(function) if inspect.isfunction(function) else ""
        if text and not member.startswith("_"):
            shown = member if isinstance(value, property) else _signature(function)
            members.append(f"* `{shown}`: " + text.replace("\n", "\n  "))
    if members:
        yield "\n".join(members)


def _signature(function: Callable[..., Any]) -> str:
    """Name and parameters, one per line where a line is too short; no default that is an object."""
    signature = inspect.signature(function)
    given = [p for p in signature.parameters.values() if p.name != "self"]
    line = _shown(function.__name__ + str(signature.replace(parameters=given)))
    if len(line) <= 88:
        return line
    arguments: list[str] = []
    for parameter in given:
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in arguments:
            arguments.append("*")
        arguments.append(_shown(str(parameter)))
    lines = [f"{function.__name__}(", *(f"    {argument}," for argument in arguments)]
    return "\n".join([*lines, f") -> {line.rpartition(' -> ')[2]}"])


def _shown(code: str) -> str:
    code = re.sub(r"(: |-> )'([^']*)'", r"\1\2", code)  # annotations are strings
    return re.sub(r"<\S* object at 0x\w+>", "...", code)


# ------------------------------------------------------------------------------------ docs/cli.md

CLI = """\
# Command line

Written by `tools/reference.py` from the command's own help. Exit codes: 0 done; 1 where `compare`
finds a difference, `check` a fault or `validate` a deviation; 2 an error, in one sentence; 130
interrupted. `python -m nonexp` is the same command."""


def cli_page() -> str:
    pages = [CLI, fence("text", command_line.EXAMPLES.strip())]
    for command in command_line.COMMANDS:
        pages += _command(command_line.app()[command], f"nonexp {command}")
    return "\n\n".join(pages) + "\n"


def _command(command: App, name: str) -> Iterator[str]:
    yield f"## {name}"
    yield inline(inspect.cleandoc(command.help.partition("Args:")[0]))
    arguments = command.assemble_argument_collection(parse_docstring=True)
    if rows := [(f"`{_usage(one)}`", _plain(one.parameter.help or "")) for one in arguments]:
        yield table(("argument", "meaning"), rows)


def _usage(argument: Argument) -> str:
    value = argument.parameter.metavar or argument.name
    kind = argument.field_info.kind
    if kind is inspect.Parameter.VAR_POSITIONAL:
        return f"[{value} ...]"
    if kind is inspect.Parameter.POSITIONAL_ONLY:
        return value
    flags = [name for name in argument.names if not name.startswith(("--no-", "--empty-"))]
    flag = ", ".join(sorted(flags, key=len))
    return flag if argument.hint is bool else f"{flag} {value}"


def _plain(text: str) -> str:
    return inline(" ".join(text.split())).replace("<", "&lt;")


# ------------------------------------------------------------------------------------------- pages

PAGES: dict[str, Callable[[], str]] = {
    "models.md": models_page,
    "plugins.md": plugins_page,
    "python.md": python_page,
    "cli.md": cli_page,
}


def main() -> None:
    mi.set_variant("llvm_ad_rgb")
    for name, page in PAGES.items():
        (DOCS / name).write_text(page(), encoding="utf-8")
        print(DOCS / name)


if __name__ == "__main__":
    main()
