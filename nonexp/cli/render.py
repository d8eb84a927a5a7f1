"""``nonexp render``: render a scene file."""

from __future__ import annotations

import argparse
import contextlib
import json
import platform
import signal
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..system.signals import Stopped, stop_signals
from ..system.terminal import note
from . import progress as cli_progress
from .arguments import UserError, add_scene, duration, fraction, load, one_sentence, size, whole

if TYPE_CHECKING:
    from ..images.image import Image
    from ..rendering.render import Source
    from ..scene.load import LoadedScene

__all__ = ["add"]

MAX_SEED = 2**31 - 1  # an EXR header holds 32-bit integers

WORTH_KEEPING = 60.0
"""Seconds of rendering that are not thrown away without being asked to."""


def add(commands: Any) -> None:
    """Add the command to those of the parser."""
    render = commands.add_parser(
        "render",
        help="render a scene file to an EXR and a PNG",
        description="Render a Mitsuba scene in passes, until the first of the targets --spp, "
        "--time and --error is reached. Writes OUT.exr (channels R, G, B, their "
        "standard error as stderr.R, stderr.G, stderr.B, and how it was made as nonexp:... in the "
        "header) and a tone-mapped OUT.png beside it; while rendering, OUT.exr.checkpoint, from "
        "which --resume goes on.",
    )
    add_scene(render)
    render.add_argument(
        "-o", "--output", type=Path, metavar="OUT.exr", help="default: the scene's name, here"
    )
    render.add_argument("--size", type=size, metavar="WxH", help="image size in pixels")
    render.add_argument(
        "--seed", type=whole(0, MAX_SEED), default=0, metavar="S", help="default: 0"
    )
    render.add_argument(
        "--pass-spp",
        type=whole(1),
        metavar="N",
        help="samples per pixel of a pass (default: by image size and --spp)",
    )
    targets = render.add_argument_group("targets, whichever is reached first")
    targets.add_argument(
        "--spp", type=whole(1), metavar="N", help="samples per pixel (default: the scene's)"
    )
    targets.add_argument("--time", type=duration, metavar="T", help="such as 90s, 10m or 2h30m")
    targets.add_argument(
        "--error",
        type=fraction,
        metavar="E",
        help="relative standard error of the image, such as 1%%: root mean square over the pixels "
        "that are not black of the standard error by the brightness of the pixel (or by a tenth "
        "of the median brightness, if that is more)",
    )
    long = render.add_argument_group("long renders")
    long.add_argument(
        "--checkpoint",
        type=_interval,
        default=60.0,
        metavar="T",
        help="time between checkpoints, such as 5m, or off (default: 60s)",
    )
    start = long.add_mutually_exclusive_group()
    start.add_argument(
        "--resume",
        action="store_true",
        help="go on from the checkpoint, if there is one, to the same image as without a break",
    )
    start.add_argument(
        "--restart", action="store_true", help="discard the checkpoint of an unfinished render"
    )
    long.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="render on the workers of a Dask scheduler, such as tcp://host:8786, or local: on "
        "two workers here",
    )
    render.add_argument(
        "--denoise",
        action="store_true",
        help="add a denoised image: to the EXR as denoised.R, ..., and as OUT.denoised.png",
    )
    render.set_defaults(run=_render)


def _interval(text: str) -> float | None:
    if text == "off":
        return None
    return 0.0 if text == "0" else duration(text)


def _render(options: argparse.Namespace) -> int:
    from ..images import denoise as denoising
    from ..images import exr as output
    from ..rendering import checkpoint
    from ..system import files

    target: Path = options.output or Path(options.scene.stem + ".exr")
    state = None
    if options.checkpoint is not None:
        state = target.with_name(target.name + ".checkpoint")
    with one_sentence():
        output.check(target, *([state] if state else []))
        if options.resume and state is None:
            raise ValueError("--resume needs checkpoints: leave out --checkpoint off")
    loaded = load(options, options.size)
    with one_sentence(), _warnings():
        if options.denoise:
            denoising.require()
        if state is not None:
            _look_at(state, options)
            files.remove_leftovers(target, target.with_suffix(".png"), state)
        before = _version(state)
        with stop_signals(immediately=options.cluster is not None) as stop:
            try:
                image, identity = _run(loaded, options, state, stop)
            except Stopped as stopped:
                return _say_how_to_resume(stopped, state, before)
        metadata = _metadata(options, loaded, image, identity)
        denoised = None
        try:
            if options.denoise:
                denoised, metadata["denoiser"] = denoising.denoise(image.mean)
            with _saved_at_least(state, before):
                output.write(target, image, metadata, denoised)
        except KeyboardInterrupt:
            return _say_how_to_resume(Stopped(signal.SIGINT), state, before)
    if state is not None:
        checkpoint.older(state).unlink(missing_ok=True)
        if image.seconds < options.checkpoint:  # quicker made again than kept
            state.unlink(missing_ok=True)
    noise = f", error {image.error:.2%}" if image.passes > 1 else ""
    print(
        f"{target}: {image.spp} samples per pixel in {image.passes} "
        f"pass{'es' if image.passes > 1 else ''}, {cli_progress.time(image.seconds)}{noise}"
    )
    return 0


# --------------------------------------------------------------------- rendering


def _run(
    loaded: LoadedScene, options: argparse.Namespace, state: Path | None, stop: Any
) -> tuple[Image, dict[str, Any]]:
    """Render with a progress bar; the image and its identity."""
    import mitsuba as mi

    from .. import rendering
    from ..rendering.render import identity_of, render
    from ..rendering.targets import Progress
    from ..scene import identity as sceneid

    scene = loaded.scene
    open_ended = options.spp is None and (options.time is not None or options.error is not None)
    identity = {
        **sceneid.of_files(options.scene, dict(options.parameters)),
        "integrator": ", ".join(loaded.integrators),
    }
    if options.spp is not None and not (state is not None and state.exists()):
        plan = rendering.planned(scene, options.spp, pass_spp=options.pass_spp)
        if plan.spp != options.spp:
            note(
                f"--spp {options.spp} becomes {plan.spp}: "
                f"{plan.passes} passes of {plan.pass_spp} samples per pixel"
            )
    with contextlib.ExitStack() as stack:
        source = _source(stack, options)
        pixels = mi.ScalarVector2u(scene.sensors()[0].film().crop_size())
        show = stack.enter_context(
            cli_progress.bar(options.scene.name, int(pixels[0] * pixels[1]), options.error)
        )

        def on_progress(progress: Progress) -> None:
            show(progress)
            stop.check()

        image = render(
            scene,
            spp=None if open_ended else options.spp,
            time=options.time,
            error=options.error,
            seed=options.seed,
            pass_spp=options.pass_spp,
            checkpoint=state,
            resume=options.resume,
            interval=options.checkpoint or 0.0,
            on_progress=on_progress,
            identity=identity,
            source=source,
        )
    return image, identity_of(scene, 0, options.seed, identity)


def _source(stack: contextlib.ExitStack, options: argparse.Namespace) -> Source | None:
    """Who renders the passes: this process, or a cluster."""
    if options.cluster is None:
        return None
    import mitsuba as mi

    from ..rendering import cluster
    from ..scene import files as scenefiles
    from ..scene import identity as sceneid

    files = scenefiles.collect(options.scene, dict(options.parameters))
    files.check_movable()
    where = stack.enter_context(cluster.connect(options.cluster, note))
    workers = where.workers()
    note(f"{workers} worker{'' if workers == 1 else 's'}, dashboard at {where.dashboard}")

    def source(plan: Any, seed: int, start: int) -> Iterator[Any]:
        job = cluster.Job(
            root=files.root.relative_to(files.folder).as_posix(),
            parameters=dict(options.parameters),
            size=options.size,
            variant=mi.variant() or "",
            plan=plan,
            seed=seed,
            versions=sceneid.versions(),
        )
        return where.passes(files, job, start)

    return source


# --------------------------------------------------------------------- checkpoints


def _look_at(state: Path, options: argparse.Namespace) -> None:
    """Whether the checkpoint that is there, if any, may be used, or replaced."""
    from ..rendering import checkpoint

    if options.resume:
        if not state.exists() and not checkpoint.older(state).exists():
            note(f"there is no checkpoint {str(state)!r}: starting from the beginning")
        return
    try:
        found = checkpoint.load(state)
    except ValueError:
        found = None  # damaged: nothing to lose
    if found is None or options.restart:
        return
    saved, _ = found
    if not saved.finished and saved.seconds >= WORTH_KEEPING:
        spent = cli_progress.time(saved.seconds)
        raise UserError(
            f"{str(state)!r} holds {spent} of an unfinished render: "
            "give --resume to go on, or --restart to discard it"
        )


def _version(state: Path | None) -> tuple[int, ...] | None:
    """What tells one checkpoint from the next of the same name; clocks may be set back."""
    if state is None or not state.exists():
        return None
    status = state.stat()
    return status.st_ino, status.st_mtime_ns, status.st_size


def _say_how_to_resume(stopped: Stopped, state: Path | None, before: Any) -> int:
    if _version(state) not in (None, before):
        note(
            f"{stopped}; what is done is in {str(state)!r}: "
            "to go on, give the same command with --resume"
        )
    else:
        note(f"{stopped}, nothing written")
    return stopped.exit_code


@contextlib.contextmanager
def _saved_at_least(state: Path | None, before: Any) -> Iterator[None]:
    """Where the image cannot be written, tell what is in the checkpoint."""
    try:
        yield
    except OSError as error:
        if _version(state) in (None, before):
            raise
        saved = f"what is done is in {str(state)!r}, from which --resume goes on"
        raise OSError(f"{error} ({saved})") from error


@contextlib.contextmanager
def _warnings() -> Iterator[None]:
    """Tell the library's warnings as notes."""
    with warnings.catch_warnings():
        warnings.filterwarnings("always", module="nonexp")
        warnings.showwarning = lambda message, *_: note(f"warning: {message}")
        yield


# --------------------------------------------------------------------- metadata


def _metadata(
    options: argparse.Namespace, loaded: LoadedScene, image: Image, identity: dict[str, Any]
) -> dict[str, str | int | float]:
    from ..scene import identity as sceneid

    versions = dict(identity["versions"])
    mine = {name: value for name, value in identity.items() if name != "seed"}
    return {
        "scene": str(options.scene),
        "parameters": json.dumps(dict(options.parameters)),
        "integrator": loaded.integrators[0] if loaded.integrators else "",
        "spp": image.spp,
        "pass_spp": image.pass_spp,
        "passes": image.passes,
        "seed": image.seed,
        "seconds": image.seconds,
        "error": image.error,
        "stopped": image.stopped,
        "filter": str(loaded.scene.sensors()[0].film().rfilter()).partition("[")[0],
        "variant": identity["variant"],
        "version": versions.pop("nonexp"),
        **versions,
        "python": platform.python_version(),
        "scene_hash": sceneid.digest({k: identity[k] for k in ("parameters", "files")}),
        "identity": json.dumps(mine),
    }
