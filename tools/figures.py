"""Render the pictures of README.md, docs/faq.md and docs/refractive.md into docs/images.

Takes 15 minutes on 2 cores, and needs the extra plot. Arguments choose some of the pictures:
laws, series, clouds, refractive, memory. The clouds need a grid: nonexp cloud scenes/cloud.npz.

.venv/bin/pip install -e '.[plot]' && .venv/bin/python tools/figures.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
from matplotlib.colors import LogNorm

import nonexp
from nonexp.images import exr as output
from nonexp.models.exponential_mixture import ExponentialMixture

ROOT = Path(__file__).resolve().parent.parent
SIZE = {"width": 400, "height": 300}

FIGURES: dict[str, tuple[str, dict[str, float], int, dict[str, str]]] = {
    "laws": (
        "dragon",
        SIZE,
        1024,
        {
            "constant": "constant",
            "gamma": "gamma, alpha = 0.5",
            "exponential": "exponential",
            "quadratic": "quadratic, b = 2",
            "linear": "linear, b = 1",
        },
    ),
    "series": (
        "fog",
        SIZE,
        512,
        {
            "linear_b1000": "linear, b = 1000",
            "linear_b1.72": "linear, b = 1.72",
            "linear_b0.8": "linear, b = 0.8",
        },
    ),
    "clouds": (
        "cloud",
        {"width": 200, "height": 150, "extinction": 4},
        128,
        {
            "exponential_mixture": "exponential_mixture",
            "gamma": "gamma, alpha = 2",
            "exponential": "exponential",
            "quadratic": "quadratic, b = 2",
            "linear": "linear, b = 1",
        },
    ),
}
"""Name of a picture: scene, its parameters, samples per pixel, and media with their titles."""


def laws(scene: str, parameters: dict[str, float], spp: int, media: dict[str, str]) -> Any:
    """One scene in several media, side by side."""
    width, height = (parameters[side] / 100 for side in ("width", "height"))
    size = (width * len(media), height + 0.35)
    figure, axes = plt.subplots(1, len(media), figsize=size, layout="constrained")
    for axis, (medium, title) in zip(axes, media.items(), strict=True):
        path = ROOT / "scenes" / f"{scene}.xml"
        built = mi.load_file(str(path), medium=medium, **parameters)
        image = nonexp.render(built, spp=spp)
        print(f"{scene}.xml, {medium}: {image.spp} spp in {image.seconds:.0f} s", flush=True)
        axis.imshow(output.tone_map(image.mean))
        axis.set_title(title)
        axis.axis("off")
    return figure


def refractive(seconds: float = 60) -> Any:
    """The dragon at equal time, without and with connections through glass, and their noise."""
    figure, axes = plt.subplots(2, 2, figsize=(8, 6.9), layout="constrained")
    scene = mi.load_file(str(ROOT / "scenes" / "dragon.xml"), **SIZE)
    for column, how in zip(axes.T, ("off", "auto"), strict=True):
        integrator = {"type": "nonexp_volpath", "max_depth": 64, "refractive_nee": how}
        built = mi.load_dict(
            {
                "type": "scene",
                "integrator": integrator,
                "sensor": scene.sensors()[0],
                **{f"shape_{i}": shape for i, shape in enumerate(scene.shapes())},
            }
        )
        nonexp.render(built, spp=1)  # compiles
        image = nonexp.render(built, time=seconds)
        print(f"refractive_nee={how}: {image.spp} spp in {image.seconds:.0f} s", flush=True)
        noise = np.mean(image.stderr, axis=2) / np.mean(image.mean)
        column[0].imshow(output.tone_map(image.mean))
        column[0].set_title(f"{how}: {image.spp} samples per pixel", fontsize=10)
        shown = column[1].imshow(noise, norm=LogNorm(0.003, 0.3), cmap="magma")
    label = "standard error / mean of the image"
    figure.colorbar(shown, ax=axes, location="bottom", shrink=0.6, pad=0.02, label=label)
    for axis in axes.flat:
        axis.axis("off")
    return figure


def memory() -> Any:
    """A mixture of two materials, dense dark lumps in thin white fog, in three models of it."""
    extinction, chord, albedo = (12.0, 0.3), (0.25, 0.75), ((0.9, 0.45, 0.2), (0.99, 0.99, 0.99))
    share = [one / sum(chord) for one in chord]
    rates = [p * s for p, s in zip(share, extinction, strict=True)]
    mean = list(np.array(rates) @ np.array(albedo) / sum(rates))
    law = ExponentialMixture.levermore(*extinction, *chord)
    mixed = {"albedo": {"type": "rgb", "value": mean}}
    media = {
        "mixed finely: exponential": {
            "type": "nonexp_homogeneous",
            "sigma_t": sum(rates),
            **mixed,
        },
        "forgets: exponential_mixture": {
            "type": "nonexp_homogeneous",
            "transmittance": nonexp.models.to_dict(law),
            **mixed,
        },
        "remembers: nonexp_binary_mixture": {
            "type": "nonexp_binary_mixture",
            "sigma_t": ", ".join(map(str, extinction)),
            "chord": ", ".join(map(str, chord)),
            **{f"albedo_{i}": {"type": "rgb", "value": a} for i, a in enumerate(albedo)},
        },
    }
    transform = mi.ScalarTransform4f()
    film = {"type": "hdrfilm", "width": 160, "height": 120}
    eye = transform.look_at([2.4, 1.6, 3.4], [0, -0.1, 0], [0, 1, 0])
    place = transform.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(8)
    figure, axes = plt.subplots(1, 3, figsize=(4.8, 1.5), layout="constrained")
    for axis, (title, medium) in zip(axes, media.items(), strict=True):
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "nonexp_volpath", "max_depth": 64},
                "sensor": {"type": "perspective", "fov": 40, "to_world": eye, "film": film},
                "block": {"type": "cube", "bsdf": {"type": "null"}, "interior": medium},
                "floor": {"type": "rectangle", "to_world": place},
                "sun": {"type": "directional", "direction": [-1, -1.2, -0.2], "irradiance": 2.0},
                "sky": {"type": "constant", "radiance": 0.4},
            }
        )
        image = nonexp.render(scene, spp=128)
        print(f"{title}: {image.spp} spp in {image.seconds:.0f} s", flush=True)
        axis.imshow(output.tone_map(image.mean))
        axis.set_title(title, fontsize=6)
        axis.axis("off")
    return figure


DRAWN = {"refractive": refractive, "memory": memory}


def main() -> None:
    mi.set_variant("llvm_ad_rgb")
    folder = ROOT / "docs" / "images"
    folder.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[1:] or [*FIGURES, *DRAWN]:
        figure = DRAWN[name]() if name in DRAWN else laws(*FIGURES[name])
        figure.savefig(folder / f"{name}.png", dpi=100)


if __name__ == "__main__":
    main()
