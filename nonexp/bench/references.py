"""References: closed forms, and long renders stored as EXR files.

A file holds the mean in ``R, G, B`` (32 bits), its standard error in ``stderr.R, stderr.G,
stderr.B`` and that of the mean over channels in ``stderr.Y`` (16 bits), and how it was made in its
header: ``nonexp:command``, ``nonexp:integrator``, ``nonexp:spp``, ``nonexp:seed``,
``nonexp:stderr`` (of the mean of the image, relative to it) and versions.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import OpenEXR

from ..images.moments import Array, Moments
from ..rendering.passes import pass_seed
from ..system.files import replacing
from ..system.version import __version__
from .competitors import reference_competitor
from .scenes import Case, Filling, checkout
from .statistics import Reference

__all__ = ["default_folder", "load", "path", "rebuild", "relative_stderr", "write"]


def default_folder() -> Path:
    """Folder of the references: ``benchmarks/references`` in the source tree, or else here."""
    return (checkout() or Path.cwd()) / "benchmarks" / "references"


def path(case: Case, folder: Path) -> Path:
    """The file of a case."""
    return folder / f"{case.name}.exr"


def load(case: Case, folder: Path) -> Reference:
    """The reference of a case. Raises ``FileNotFoundError`` or ``ValueError``."""
    if case.scene.exact is not None:
        value = case.scene.exact(case.law)
        return Reference.exact(value, case.scene.size, f"exact: {value:.6g}")
    file = path(case, folder)
    if not file.is_file():
        raise FileNotFoundError(
            f"{case.name} has no reference {file}: make it by nonexp bench --rebuild-references"
        )
    with OpenEXR.File(str(file), separate_channels=True) as exr:
        header = {key: exr.header().get(f"nonexp:{key}") for key in ("integrator", "spp", "seed")}
        pixels: dict[str, Array] = {
            name: np.array(channel.pixels, dtype=np.float64)
            for name, channel in exr.channels().items()
        }
    width, height = case.scene.size
    if pixels["R"].shape != (height, width):
        raise ValueError(
            f"reference {file} has {pixels['R'].shape[1]} x {pixels['R'].shape[0]} pixels: "
            f"{case.name} has {width} x {height}"
        )
    return Reference(
        np.stack([pixels[name] for name in "RGB"], axis=2),
        np.stack([pixels[f"stderr.{name}"] for name in "RGB"], axis=2),
        pixels["stderr.Y"],
        f"{header['integrator']}, {header['spp']} spp, seed {header['seed']}",
    )


def rebuild(
    case: Case,
    folder: Path,
    seconds: float,
    *,
    seed: int = 1,
    command: str = "",
    on_pass: Callable[[float], Any] = lambda done: None,
) -> Reference:
    """Render the reference of a case for about ``seconds``, and write its file.

    If extinction differs between channels, each channel is rendered as a grey medium, without
    sampling of channels. At least 8 passes are rendered. ``on_pass`` is called with the fraction
    done.
    """
    if not seconds > 0:
        raise ValueError(f"time is {seconds} s: it must be > 0")
    channels = (0, 1, 2) if "chromatic" in case.scene.tags else (None,)
    competitor = reference_competitor(case)
    totals, passes = [], 0
    for number, channel in enumerate(channels):
        plain = competitor.filling(case)
        filling = Filling(plain.law, plain.properties, channel)
        scene = case.scene.build(filling, case.scene.size)
        total = Moments()
        share, started = seconds / len(channels), time.perf_counter()
        while total.passes < 8 or time.perf_counter() - started < share:
            image = competitor.integrator(case.scene).render(
                scene, seed=pass_seed(seed + number, total.passes), spp=case.scene.spp
            )
            rgb: Array = np.array(image, dtype=np.float64)[:, :, :3]
            total = total.plus(np.concatenate([rgb, rgb.mean(axis=2, keepdims=True)], axis=2))
            done = min((time.perf_counter() - started) / share, 1.0)
            on_pass((number + done) / len(channels))
        totals.append(total)
        passes += total.passes
    reference = _combine(totals)
    integrator = f"{competitor.plugin} {dict(competitor.properties) or ''}".strip()
    if len(channels) > 1:
        integrator += ", each channel as a grey medium"
    if competitor.tracking != "auto":
        integrator += f", tracking {competitor.tracking}"
    header = {
        "command": command,
        "case": case.name,
        "integrator": integrator,
        "spp": passes // len(channels) * case.scene.spp,
        "passes": passes,
        "seed": seed,
        "stderr": relative_stderr(reference),
        "version": __version__,
        "mitsuba": metadata.version("mitsuba"),
        "drjit": metadata.version("drjit"),
        "variant": mi.variant() or "",
    }
    write(path(case, folder), reference, header)
    return reference


def _combine(totals: list[Moments]) -> Reference:
    """One render of four planes (R, G, B, mean), or three of one channel each."""
    if len(totals) == 1:
        mean, stderr = totals[0].mean, totals[0].stderr
        return Reference(mean[:, :, :3], stderr[:, :, :3], stderr[:, :, 3], "")
    mean = np.stack([total.mean[:, :, c] for c, total in enumerate(totals)], axis=2)
    stderr = np.stack([total.stderr[:, :, c] for c, total in enumerate(totals)], axis=2)
    return Reference(mean, stderr, np.sqrt(np.sum(stderr**2, axis=2)) / 3, "")


def relative_stderr(reference: Reference) -> float:
    """Standard error of the mean of the image, relative to it."""
    grey = reference.grey_stderr
    return float(math.sqrt(np.sum(grey**2)) / grey.size / reference.mean.mean())


def write(file: Path, reference: Reference, header: dict[str, str | int | float]) -> None:
    """Write the file; an existing file is replaced when the new one is complete."""
    channels = {}
    for i, name in enumerate("RGB"):
        channels[name] = np.ascontiguousarray(reference.mean[:, :, i], dtype=np.float32)
        channels[f"stderr.{name}"] = np.ascontiguousarray(reference.stderr[:, :, i], np.float16)
    channels["stderr.Y"] = np.ascontiguousarray(reference.grey_stderr, dtype=np.float16)
    attributes = {f"nonexp:{key}": value for key, value in header.items()}
    attributes |= {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    file.parent.mkdir(parents=True, exist_ok=True)
    with replacing(file) as (aside,):
        OpenEXR.File(attributes, channels).write(str(aside))
