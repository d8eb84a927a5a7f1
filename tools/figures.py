"""Render the pictures of the README into docs/images (10 minutes on 2 cores; needs the extra plot).

.venv/bin/pip install -e '.[plot]' && .venv/bin/python tools/figures.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import mitsuba as mi

import nonexp
from nonexp import output

ROOT = Path(__file__).resolve().parent.parent
SIZE = {"width": 400, "height": 300}

FIGURES = {
    "laws": (
        "dragon",
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
        512,
        {
            "linear_b1000": "linear, b = 1000",
            "linear_b1.72": "linear, b = 1.72",
            "linear_b0.8": "linear, b = 0.8",
        },
    ),
}


def main() -> None:
    mi.set_variant("llvm_ad_rgb")
    folder = ROOT / "docs" / "images"
    folder.mkdir(parents=True, exist_ok=True)
    for name, (scene, spp, media) in FIGURES.items():
        figure, axes = plt.subplots(
            1, len(media), figsize=(4 * len(media), 3.35), layout="constrained"
        )
        for axis, (medium, title) in zip(axes, media.items(), strict=True):
            built = mi.load_file(str(ROOT / "scenes" / f"{scene}.xml"), medium=medium, **SIZE)
            image = nonexp.render(built, spp=spp)
            print(f"{scene}.xml, {medium}: {image.spp} spp in {image.seconds:.0f} s", flush=True)
            axis.imshow(output.tone_map(image.mean))
            axis.set_title(title)
            axis.axis("off")
        figure.savefig(folder / f"{name}.png", dpi=100)


if __name__ == "__main__":
    main()
