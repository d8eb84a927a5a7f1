"""``nonexp render``: render a scene file."""

from __future__ import annotations

import contextlib
import json
import math
import platform
import signal
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

from ..images.denoise import denoise as denoised_by
from ..images.denoise import require as require_denoiser
from ..images.exr import exr_path, write
from ..images.image import Image
from ..rendering.checkpoint import newest, older
from ..rendering.cluster import connect
from ..rendering.job import RenderJob
from ..rendering.progress import time as written_time
from ..rendering.render import Source, run
from ..rendering.sampling import SAMPLERS
from ..rendering.targets import fraction, seconds
from ..scene.identity import digest
from ..scene.load import LoadedScene
from ..system.files import check_writable, remove_leftovers
from ..system.signals import Stopped, stop_signals
from ..system.terminal import note
from .arguments import (
    Definitions,
    Scene,
    UserError,
    Variant,
    argument,
    load,
    one_of,
    one_sentence,
    only_one,
    whole,
)
from .arguments import (
    size as image_size,
)

__all__ = ["render"]

MAX_SEED = 2**31 - 1  # an EXR header holds 32-bit integers

WORTH_KEEPING = 60.0
"""Seconds of rendering that are not thrown away without being asked to."""

TARGETS = Group("Targets, whichever is reached first", sort_key=1)
LONG = Group("Long renders", sort_key=2)
START = Group("start", validator=only_one, show=False)


def _interval(text: str) -> float | None:
    if text == "off":
        return None
    return 0.0 if text == "0" else seconds(text)


def render(
    scene: Scene,
    /,
    *,
    variant: Variant = None,
    parameters: Definitions = (),
    output: Annotated[Path | None, argument("OUT.exr", None, "--output", "-o")] = None,
    size: Annotated[tuple[int, int] | None, argument("WxH", image_size)] = None,
    sensor: Annotated[str, argument("N")] = "0",
    seed: Annotated[int, argument("S", whole(0, MAX_SEED))] = 0,
    pass_spp: Annotated[int | None, argument("N", whole(1))] = None,
    sampler: Annotated[str | None, argument("NAME", one_of(*SAMPLERS))] = None,
    spp: Annotated[int | None, argument("N", whole(1), group=TARGETS)] = None,
    time: Annotated[float | None, argument("T", seconds, group=TARGETS)] = None,
    error: Annotated[float | None, argument("E", fraction, group=TARGETS)] = None,
    checkpoint: Annotated[float | None, argument("T", _interval, group=LONG)] = 60.0,
    resume: Annotated[bool, Parameter(group=(LONG, START))] = False,
    restart: Annotated[bool, Parameter(group=(LONG, START))] = False,
    cluster: Annotated[str | None, argument("ADDRESS", group=LONG)] = None,
    denoise: bool = False,
) -> int:
    """Render a scene file to an EXR and a PNG.

    Renders a Mitsuba scene in passes, until the first of the targets --spp, --time and --error is
    reached. Writes OUT.exr (channels R, G, B, their standard error as stderr.R, stderr.G, stderr.B,
    and how it was made as nonexp:... in the header) and a tone-mapped OUT.png beside it; while
    rendering, OUT.exr.checkpoint, from which --resume goes on.

    Args:
        output: name of the EXR, or of the PNG (default: the scene's name, here)
        size: image size in pixels
        sensor: number or id of the sensor (default: 0)
        seed: default: 0
        pass_spp: samples per pixel of a pass (default: by image size and --spp)
        sampler: sobol or independent (default: the scene's, but sobol in place of independent)
        spp: samples per pixel (default: the scene's)
        time: such as 90s, 10m or 2h30m
        error: relative standard error of the image, such as 1%: root mean square over the pixels
            that are not black of the standard error by the brightness of the pixel (or by a tenth
            of the median brightness, if that is more)
        checkpoint: time between checkpoints, such as 5m, or off (default: 60s)
        resume: go on from the checkpoint, if there is one, to the same image as without a break
        restart: discard the checkpoint of an unfinished render
        cluster: render on the workers of a Dask scheduler, such as tcp://host:8786, or local: on
            two workers here
        denoise: add a denoised image: to the EXR as denoised.R, ..., and as OUT.denoised.png
    """
    with one_sentence():
        path = exr_path(output or Path(scene.stem + ".exr"))
        state = None if checkpoint is None else path.with_name(path.name + ".checkpoint")
        check_writable(path, path.with_suffix(".png"), *([state] if state else []))
        if resume and state is None:
            raise ValueError("--resume needs checkpoints: leave out --checkpoint off")
    loaded = load(scene, variant, parameters, size)
    with one_sentence(), _warnings_as_notes():
        if denoise:
            require_denoiser()
        if state is not None:
            _check_checkpoint(state, resume, restart)
            remove_leftovers(path, path.with_suffix(".png"), state)
        job = RenderJob.of_file(
            loaded,
            scene,
            dict(parameters),
            size,
            path,
            spp=spp,
            time=time,
            error=error,
            seed=seed,
            sensor=sensor,
            pass_spp=pass_spp,
            sampler=sampler,
            checkpoint=state,
            resume=resume,
            interval=checkpoint or 0.0,
        )
        before = _version(state)
        if spp is not None and spp != job.plan.spp and not (resume and before):
            note(
                f"--spp {spp} becomes {job.plan.spp}: "
                f"{job.plan.passes} passes of {job.plan.pass_spp} samples per pixel"
            )
        try:
            with stop_signals(immediately=cluster is not None) as stop, _workers(cluster) as source:
                image = run(job, loaded.scene, scene.name, lambda _: stop.check(), source)
            metadata = _metadata(job, str(scene), loaded, image)
            clean = None
            if denoise:
                clean, metadata["denoiser"] = denoised_by(image.mean)
            with _saved_at_least(state, before):
                write(path, image, metadata, clean)
        except (Stopped, KeyboardInterrupt) as error:
            return _report_interruption(error, state, before)
    if state is not None and checkpoint is not None:
        older(state).unlink(missing_ok=True)
        if image.seconds < checkpoint:  # quicker rendered again than resumed
            state.unlink(missing_ok=True)
    print(
        f"{path}: {image.spp} samples per pixel in {image.passes} "
        f"pass{'es' if image.passes > 1 else ''}, {written_time(image.seconds)}"
        + ("" if math.isnan(image.error) else f", error {image.error:.2%}")
    )
    return 0


@contextlib.contextmanager
def _workers(address: str | None) -> Iterator[Source | None]:
    """What renders the passes: a cluster, or None for this process."""
    if address is None:
        yield None
        return
    with connect(address, note) as cluster:
        workers = cluster.workers()
        note(f"{workers} worker{'' if workers == 1 else 's'}, dashboard at {cluster.dashboard}")
        yield cluster.passes


@contextlib.contextmanager
def _warnings_as_notes() -> Iterator[None]:
    """Print warnings for users as notes."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: note(f"warning: {message}")
        yield


# --------------------------------------------------------------------- checkpoints


def _check_checkpoint(state: Path, resume: bool, restart: bool) -> None:
    """Raise :class:`UserError` if there is a checkpoint that must not be replaced."""
    if resume:
        if not state.exists() and not older(state).exists():
            note(f"there is no checkpoint {str(state)!r}: starting from the beginning")
        return
    try:
        found = newest(state)
    except ValueError:
        found = None  # damaged: nothing to lose
    if found is None or restart:
        return
    saved, _ = found
    if not saved.finished and saved.seconds >= WORTH_KEEPING:
        raise UserError(
            f"{str(state)!r} holds {written_time(saved.seconds)} of an unfinished render: "
            "give --resume to go on, or --restart to discard it"
        )


def _version(state: Path | None) -> tuple[int, ...] | None:
    """Distinguishes a checkpoint from the next of the same name, even if clocks are set back."""
    if state is None or not state.exists():
        return None
    status = state.stat()
    return status.st_ino, status.st_mtime_ns, status.st_size


def _report_interruption(
    error: Stopped | KeyboardInterrupt, state: Path | None, before: Any
) -> int:
    stopped = error if isinstance(error, Stopped) else Stopped(signal.SIGINT)
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
    """Where the image cannot be written, say what is in the checkpoint."""
    try:
        yield
    except OSError as error:
        if _version(state) in (None, before):
            raise
        saved = f"what is done is in {str(state)!r}, from which --resume goes on"
        raise OSError(f"{error} ({saved})") from error


# --------------------------------------------------------------------- metadata


def _metadata(
    job: RenderJob, scene: str, loaded: LoadedScene, image: Image
) -> dict[str, str | int | float]:
    identity = job.identity
    versions = dict(identity["versions"])
    film: Any = loaded.scene.sensors()[job.sensor].film()
    return {
        "scene": scene,
        "parameters": json.dumps(job.parameters),
        "integrator": loaded.integrators[0] if loaded.integrators else "",
        "spp": image.spp,
        "pass_spp": image.pass_spp,
        "passes": image.passes,
        "independent": image.passes if image.independent is None else image.independent,
        "sampler": identity["sampler"],
        "seed": image.seed,
        "seconds": image.seconds,
        "error": image.error,
        "stopped": image.stopped,
        "filter": str(film.rfilter()).partition("[")[0],
        "variant": job.variant,
        "version": versions.pop("nonexp"),
        **versions,
        "python": platform.python_version(),
        "scene_hash": digest({k: identity[k] for k in ("parameters", "files")}),
        "identity": json.dumps({k: v for k, v in identity.items() if k != "seed"}),
    }
