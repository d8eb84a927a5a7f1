"""The command ``nonexp``: render scenes, look into them, list the models, check the machine."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import datetime
import importlib
import inspect
import json
import math
import platform
import re
import sys
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from . import __version__

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from .rendering import Image
    from .scenefile import LoadedScene

__all__ = ["main"]

MAX_SEED = 2**31 - 1  # an EXR header holds 32-bit integers

EPILOG = """\
examples:
  nonexp render scenes/dragon.xml
  nonexp render scenes/dragon.xml -D medium=gamma -D alpha=0.5 --spp 256 -o gamma.exr
  nonexp info scenes/dragon.xml
  nonexp models
  nonexp plot gamma alpha=0.5 -o gamma.svg
  nonexp fit data.csv --model gamma --model linear -o fit.png
  nonexp doctor
"""


class UserError(Exception):
    """What the user has to change; the message is one sentence."""


class Parser(argparse.ArgumentParser):
    """Reports bad usage as one line, under the name of the command itself."""

    def error(self, message: str) -> NoReturn:
        message = re.sub(r"^argument (\S+): ", r"\1 ", message)
        raise UserError(f"{message} (see {self.prog} --help)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0, 2 for an error, 130 for Ctrl-C."""
    try:
        options = _parser().parse_args(arguments)
        code: int = options.run(options)
        return code
    except UserError as error:
        print(f"nonexp: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("nonexp: interrupted, nothing written", file=sys.stderr)
        return 130


def _parser() -> Parser:
    parser = Parser(
        prog="nonexp",
        description="Render participating media with non-exponential transmittance in Mitsuba 3.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"nonexp {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    render = commands.add_parser(
        "render",
        help="render a scene file to an EXR and a PNG",
        description="Render a Mitsuba scene in passes. Writes OUT.exr (channels R, G, B, their "
        "standard error as stderr.R, stderr.G, stderr.B, and how it was made as nonexp:... in the "
        "header) and a tone-mapped OUT.png beside it.",
    )
    _add_scene(render)
    render.add_argument(
        "-o", "--output", type=Path, metavar="OUT.exr", help="default: the scene's name, here"
    )
    render.add_argument(
        "--spp", type=_whole(1), metavar="N", help="samples per pixel (default: the scene's)"
    )
    render.add_argument(
        "--seed", type=_whole(0, MAX_SEED), default=0, metavar="S", help="default: 0"
    )
    render.add_argument("--size", type=_size, metavar="WxH", help="image size in pixels")
    render.set_defaults(run=_render)

    info = commands.add_parser(
        "info",
        help="tell what a scene needs, and what its kernel leaves out",
        description="Show what the integrator nonexp_volpath finds in a scene, and what it "
        "therefore skips.",
    )
    _add_scene(info)
    info.set_defaults(run=_info)

    models = commands.add_parser(
        "models",
        help="list the transmittance models",
        description="List the transmittance models with their parameters.",
    )
    models.set_defaults(run=_models)
    _add_plot(commands)
    _add_fit(commands)
    doctor = commands.add_parser(
        "doctor",
        help="check whether this machine can render",
        description="Say whether this machine can render, and what to do if it cannot.",
    )
    doctor.set_defaults(run=_doctor)
    return parser


def _add_plot(commands: Any) -> None:
    plot = commands.add_parser(
        "plot",
        help="draw a transmittance model",
        description="Draw the transmittances and densities of a model over optical depth, beside "
        "the exponential law of the same mean extinction, and histograms of what it samples. "
        "Needs matplotlib.",
    )
    plot.add_argument("model", metavar="MODEL", help="one of those that `nonexp models` lists")
    plot.add_argument(
        "parameters",
        nargs="*",
        type=_definition("alpha=0.5"),
        default=[],
        metavar="key=value",
        help="parameter of the model, such as alpha=0.5 or sigma=0.2,1.8",
    )
    plot.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="OUT.png",
        help="PNG, SVG or PDF by its suffix (default: MODEL.png)",
    )
    plot.set_defaults(run=_plot)


def _add_fit(commands: Any) -> None:
    fit = commands.add_parser(
        "fit",
        help="fit models to a measured transmittance",
        description="Fit the parameters of a model to a transmittance over distance, by least "
        "squares, and print what a scene's medium needs. DATA is a table with the columns "
        "distance (or optical depth), transmittance and, if known, its standard deviation, as "
        "text or as NPZ with arrays tau, ff and sigma. Several models are compared by AIC, "
        "Akaike's information criterion: the one with the least is the best.",
    )
    fit.add_argument("data", type=Path, metavar="DATA.csv", help="table: distance, ff [, sigma]")
    fit.add_argument(
        "--model",
        dest="models",
        action="append",
        metavar="MODEL",
        help="may be repeated; all (the default) tries every model",
    )
    for flag, does in (("--fix", "hold a parameter there"), ("--start", "start the search there")):
        fit.add_argument(
            flag,
            type=_definition("alpha=0.5"),
            action="append",
            default=[],
            metavar="key=value",
            help=f"{does}, as in alpha=0.5; may be repeated",
        )
    fit.add_argument(
        "--sigma-t",
        type=_sigma_t,
        default="auto",
        metavar="VALUE",
        help="extinction that turns distance into optical depth: a number, fit, or auto (default: "
        "fitted, but 1 for models whose parameters are lengths or extinctions themselves)",
    )
    fit.add_argument(
        "-o", "--output", type=Path, metavar="OUT.png", help="also draw data, fits and residuals"
    )
    fit.set_defaults(run=_fit)


def _add_scene(command: argparse.ArgumentParser) -> None:
    """A scene file with its parameters, and the variant to load it in."""
    command.add_argument("scene", type=Path, metavar="SCENE.xml", help="Mitsuba scene file")
    command.add_argument(
        "--variant", metavar="V", help="Mitsuba variant (default: cuda_ad_rgb or llvm_ad_rgb)"
    )
    command.add_argument(
        "-D",
        dest="parameters",
        type=_definition("medium=gamma"),
        action="append",
        default=[],
        metavar="key=value",
        help="parameter of the scene file, such as medium=gamma; may be repeated",
    )


# --------------------------------------------------------------------- arguments


def _whole(low: int, high: int = 2**31 - 1) -> Any:
    def parse(text: str) -> int:
        if not re.fullmatch(r"[+-]?[0-9]{1,18}", text) or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(
                f"is {text!r}: it must be a whole number from {low} to {high}"
            )
        return int(text)

    return parse


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    if match is None or not all(1 <= int(extent) <= 16384 for extent in match.groups()):
        raise argparse.ArgumentTypeError(
            f"is {text!r}: it must be WIDTHxHEIGHT in pixels, from 1 to 16384 each, as in 640x480"
        )
    return int(match[1]), int(match[2])


def _definition(example: str) -> Any:
    def parse(text: str) -> tuple[str, str]:
        name, equals, value = text.partition("=")
        if not equals or not re.fullmatch(r"\w+", name):
            raise argparse.ArgumentTypeError(f"is {text!r}: it must be key=value, as in {example}")
        return name, value

    return parse


def _sigma_t(text: str) -> float | str:
    if text in ("auto", "fit"):
        return text
    try:
        value = float(text)
    except ValueError:
        value = -1
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"is {text!r}: it must be a number > 0, fit, or auto")
    return value


# --------------------------------------------------------------------- nonexp render


def _render(options: argparse.Namespace) -> int:
    from . import output

    target: Path = options.output or Path(options.scene.stem + ".exr")
    with _one_sentence():
        output.check(target)
    loaded = _load(options, options.size)
    with _one_sentence():
        image = _render_with_progress(loaded.scene, options)
        output.write(target, image, _metadata(options, loaded, image))
    print(
        f"{target}: {image.spp} samples per pixel in {image.passes} "
        f"pass{'es' if image.passes > 1 else ''}, {image.seconds:.1f} s"
    )
    return 0


def _load(options: argparse.Namespace, size: tuple[int, int] | None = None) -> LoadedScene:
    """The scene in the variant asked for; warns if its integrator ignores its media's laws."""
    import mitsuba as mi

    from . import machine, scenefile

    with _one_sentence():
        mi.set_variant(machine.check_variant(options.variant))
        mi.set_log_level(mi.LogLevel.Error)
        loaded = scenefile.load(options.scene, dict(options.parameters), size)
    counterpart = loaded.exponential_counterpart()
    if counterpart:
        _note(
            f"warning: integrator {counterpart} shows its exponential counterpart "
            "(the scene holds a nonexp medium): use nonexp_volpath to see its own transmittance"
        )
    return loaded


@contextlib.contextmanager
def _one_sentence() -> Iterator[None]:
    """Turn what goes wrong inside into one sentence for the user."""
    try:
        yield
    except (ValueError, TypeError, OSError, RuntimeError, ImportError, MemoryError) as error:
        from .scenefile import explain

        raise UserError(explain(error)) from error


def _render_with_progress(scene: Any, options: argparse.Namespace) -> Image:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
    )

    from . import rendering

    plan = rendering.planned(scene, options.spp)
    if options.spp is not None and plan.spp != options.spp:
        _note(
            f"--spp {options.spp} becomes {plan.spp}: "
            f"{plan.passes} passes of {plan.pass_spp} samples per pixel"
        )
    console = Console(stderr=True)
    columns = (
        TextColumn(options.scene.name, markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("passes,"),
        TimeElapsedColumn(),
        TextColumn("elapsed, {task.fields[left]} left"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=plan.passes, left="?:??:??")

        def show(progress: rendering.Progress) -> None:
            left = progress.seconds / progress.done * (progress.passes - progress.done)
            bar.update(task, completed=progress.done, left=datetime.timedelta(seconds=round(left)))

        return rendering.render(scene, spp=options.spp, seed=options.seed, on_progress=show)


def _metadata(
    options: argparse.Namespace, loaded: LoadedScene, image: Image
) -> dict[str, str | int | float]:
    import drjit as dr
    import mitsuba as mi

    variant = mi.variant() or ""
    values: dict[str, str | int | float] = {
        "scene": str(options.scene),
        "parameters": json.dumps(dict(options.parameters)),
        "integrator": loaded.integrators[0] if loaded.integrators else "",
        "spp": image.spp,
        "passes": image.passes,
        "seed": image.seed,
        "seconds": image.seconds,
        "variant": variant,
        "version": __version__,
        "mitsuba": metadata.version("mitsuba"),
        "drjit": metadata.version("drjit"),
        "python": platform.python_version(),
    }
    if variant.startswith("llvm"):
        values["llvm"] = ".".join(map(str, dr.detail.llvm_version()))
    return values


def _note(text: str) -> None:
    print(f"nonexp: {text}", file=sys.stderr)


# --------------------------------------------------------------------- nonexp info


def _info(options: argparse.Namespace) -> int:
    from rich.text import Text

    loaded = _load(options)
    report = importlib.import_module("nonexp.integrators.report")
    with _one_sentence():
        findings = report.findings(loaded.scene)
    console, table = _stdout(), _table("in the scene", "found", "in the kernel")
    for finding in findings:
        row = (finding.question, finding.answer, finding.consequence)
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)
    if not any(name.startswith("nonexp_") for name in loaded.integrators):
        print(f"The scene's own integrator is {', '.join(loaded.integrators) or 'none'}.")
    return 0


# --------------------------------------------------------------------- nonexp models


def _models(_options: argparse.Namespace) -> int:
    from rich.text import Text

    from . import models, parameters

    console = _stdout()
    table = _table("model", "transmittance", "parameters", "sigma_bar")
    for name in models.names():
        cls = models.registry[name]
        law = (inspect.getdoc(cls) or "").partition("\n")[0]
        fields = [parameters.describe(field) for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
        sigma_bar = f"{models.create(name, **cls.examples[0]).sigma_bar:.6g}"
        separator = "\n" if console.is_terminal else ", "
        row = (name, law, separator.join(fields) or "none", sigma_bar)
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)
    console.print(
        Text("tau is optical depth, sigma_bar = -T'(0) at the default parameters."), style="dim"
    )
    return 0


def _stdout() -> Console:
    """Where results go: as wide as the terminal, or plain and unwrapped into a file or pipe."""
    from rich.console import Console

    if sys.stdout.isatty():
        return Console(highlight=False)
    return Console(width=10_000, highlight=False, no_color=True, force_terminal=False)


# --------------------------------------------------------------------- nonexp plot, nonexp fit


def _plot(options: argparse.Namespace) -> int:
    from . import cli_models

    with _one_sentence():
        print(cli_models.plot(options))
    return 0


def _fit(options: argparse.Namespace) -> int:
    from . import cli_models

    with _one_sentence():
        cli_models.fit(options, _stdout())
    return 0


def _table(*columns: str) -> Table:
    """An empty table: framed in a terminal, plain and unwrapped into a file or pipe."""
    from rich import box
    from rich.table import Table

    terminal = _stdout().is_terminal
    table = Table(box=box.ROUNDED if terminal else None, show_lines=terminal, pad_edge=terminal)
    for column in columns:
        table.add_column(column, no_wrap=not terminal)
    return table


# --------------------------------------------------------------------- nonexp doctor


def _doctor(_options: argparse.Namespace) -> int:
    from . import machine

    report = machine.inspect()
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("mitsuba", "drjit"))
    llvm = ".".join(map(str, report.llvm_version)) if report.llvm_version else "none"
    rows = {
        "python": f"{platform.python_version()} on {platform.system()} {platform.machine()}",
        "packages": f"nonexp {__version__}, {versions}",
        "LLVM": f"{llvm} ({report.llvm_path})" if report.llvm_path else llvm,
        "GPU": "usable" if report.gpu else "none (an NVIDIA GPU would be used)",
        "variants": ", ".join(report.variants) or "none",
    }
    for name, value in rows.items():
        print(f"{name:9} {value}")
    if report.problem:
        print(f"problem   {report.problem}")
    if not report.variants:
        print("This machine cannot render.")
        return 2
    print(f"This machine can render, by default with {machine.choose_variant(report.gpu)}.")
    return 0
