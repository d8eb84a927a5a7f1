"""Render the gallery: every model in the dragon scene, and a series in the fog room.

Its cloud and its mixture are pictures of tools/figures.py.

.venv/bin/python tools/gallery.py [--spp 1024] [--size 320x240]

The command `nonexp render` renders each image into out/gallery/. Its PNG is copied to
docs/images/gallery/, and docs/gallery.md shows it with its command. Images that out/gallery/
already has at these settings are not rendered again, so an interrupted run continues (remove the
folder when the code has changed). Nothing is denoised. Takes half an hour on two cores.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from nonexp import cli, models

ROOT = Path(__file__).resolve().parent.parent
RENDERED = ROOT / "out" / "gallery"
PICTURES = ROOT / "docs" / "images" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"

HEAD = """\
# Gallery

Written by `tools/gallery.py`; `make gallery` renders it again. Every image is as `nonexp render`
wrote it: the mean of its samples, tone-mapped. No image is denoised, clamped or retouched. The
noise is the root mean square of the pixels' standard errors over the mean of the image. For another
number of samples or another size: `make gallery GALLERY='--spp 256 --size 240x180'`.
"""

DRAGON = """\
## A dragon in every model

A golden dragon in a glass ball, 1.6 m wide, filled with media of mean extinction 1.2 per metre
(except `constant`, which is vacuum). Only the law differs: `scenes/dragon.xml` with the media of
`scenes/media/`. The light comes from a lamp outside the glass.
"""

FOG = """\
## Fog from thin to thick

The camera is in the fog: `scenes/fog.xml`. In the first three images the longest flight `b`
shrinks; the mean extinction is `1/b`. The last two images have the mean extinction of `linear` with
`b = 1`.
"""

CLOUD = """\
## A cloud in five laws

![One cloud in five laws, from clustered particles to perfect order](images/clouds.png)

`scenes/cloud.xml` with `extinction` 4: one grid of 128³ voxels, the sun from the left. Only the
law differs. Where particles cluster (`exponential_mixture`, `gamma`) light finds gaps, and the
cloud is soft and transparent. Where they keep their distance (`quadratic`, `linear`) its edges
are harder and its shadow darker: with `linear` no light goes farther than the optical depth 1
without a collision, which draws the line between light and shadow. 200 x 150, 128 samples per
pixel, made by `nonexp cloud scenes/cloud.npz` and `tools/figures.py clouds`. One of these images:

```sh
nonexp cloud scenes/cloud.npz
nonexp render scenes/cloud.xml -D medium=linear -D extinction=4 --spp 128 --size 200x150
```
"""

MEMORY = """\
## A mixture that remembers

![A block of dark lumps in white fog, as three media](images/memory.png)

A block of two materials along each ray: dense brown lumps (extinction 12, mean chord .25) in thin
white fog (.3, .75). Mixed finely it is an `exponential` medium. As a law, `exponential_mixture` by
`levermore`, it lets light pass between the lumps, but each collision forgets in which material it
was. `nonexp_binary_mixture` remembers: light that is in a lump stays there for some collisions, and
the fog between keeps its white. 160 x 120, 128 samples per pixel, made by
`tools/figures.py memory`.
"""


@dataclasses.dataclass(frozen=True)
class Picture:
    """One image: a scene with parameters."""

    title: str
    scene: str
    parameters: dict[str, str]

    @property
    def name(self) -> str:
        return "_".join([self.scene, *self.parameters.values()]).replace(".", "p")

    def arguments(self, spp: int, size: str) -> list[str]:
        """Arguments of the command that renders it, from the root of the repository."""
        given = [f"-D {key}={value}" for key, value in self.parameters.items()]
        target = f"out/gallery/{self.name}.exr"
        line = f"render scenes/{self.scene}.xml {' '.join(given)} --spp {spp} --size {size}"
        return [*line.split(), "-o", target]

    def header(self) -> dict[str, Any]:
        """The header of the finished EXR; empty if there is none."""
        path = RENDERED / f"{self.name}.exr"
        if not path.is_file():
            return {}
        try:
            return dict(OpenEXR.File(str(path), header_only=True).parts[0].header)
        except (OSError, RuntimeError):
            return {}

    def finished(self, spp: int, size: str) -> bool:
        """Whether it was rendered at these settings."""
        header = self.header()
        if not header or not (RENDERED / f"{self.name}.png").is_file():
            return False
        low, high = header["dataWindow"]
        found = "x".join(str(int(b - a) + 1) for a, b in zip(low, high, strict=True))
        parameters = json.loads(header.get("nonexp:parameters", "{}"))
        same = spp <= header.get("nonexp:spp", 0) < 1.1 * spp + 8  # whole passes
        return bool(found == size and same and parameters == self.parameters)

    def noise(self) -> float:
        with OpenEXR.File(str(RENDERED / f"{self.name}.exr"), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
        errors = np.stack([channels[f"stderr.{c}"] for c in "RGB"]).astype(float)
        means = np.stack([channels[c] for c in "RGB"]).astype(float)
        return float(np.sqrt(np.mean(errors**2)) / np.mean(means))


def pictures() -> dict[str, list[Picture]]:
    """The sections of the gallery."""
    dragons = [Picture(f"`{key}`", "dragon", {"medium": key}) for key in models.names()]
    fogs = [
        Picture(f"`linear`, b = {b}", "fog", {"medium": f"linear_b{b}"})
        for b in ("1000", "1.72", "0.8")
    ]
    fogs += [Picture(f"`{key}`", "fog", {"medium": key}) for key in ("exponential", "gamma")]
    return {DRAGON: dragons, FOG: fogs}


def render(wanted: Iterable[Picture], spp: int, size: str) -> None:
    """Render the images that are not finished; raises ``SystemExit`` if one fails."""
    RENDERED.mkdir(parents=True, exist_ok=True)
    for picture in wanted:
        if picture.finished(spp, size):
            print(f"{picture.name}: already finished")
            continue
        arguments = picture.arguments(spp, size)
        print(f"nonexp {' '.join(arguments)}", flush=True)
        code = cli.main([*arguments, "--resume"])
        if code:
            raise SystemExit(code)


def made(picture: Picture, header: dict[str, Any]) -> str:
    medium = f"{picture.parameters['medium']}.xml"
    spp, seed, variant, version = (
        header[f"nonexp:{key}"] for key in ("spp", "seed", "variant", "version")
    )
    return (
        f"Medium [{medium}](../scenes/media/{medium}), {spp} samples per pixel, seed {seed}, "
        f"noise {picture.noise():.1%}, {variant}, nonexp {version}.\n"
    )


def page(sections: dict[str, list[Picture]], spp: int, size: str) -> str:
    """The text of docs/gallery.md, from the images in out/gallery."""
    text = [HEAD]
    for head, members in sections.items():
        text.append(head)
        for picture in members:
            header = picture.header()
            text += [
                f"### {picture.scene}: {picture.title}\n",
                f"![{picture.scene}, {picture.title}](images/gallery/{picture.name}.png)\n",
                "```sh",
                f"nonexp {' '.join(picture.arguments(spp, size))}",
                "```\n",
                made(picture, header),
            ]
    return "\n".join([*text, CLOUD, MEMORY])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])  # type: ignore[union-attr]
    parser.add_argument("--spp", type=int, default=1024, help="samples per pixel (default: 1024)")
    parser.add_argument("--size", default="320x240", metavar="WxH", help="default: 320x240")
    options = parser.parse_args()
    sections = pictures()
    everything = [picture for members in sections.values() for picture in members]
    render(everything, options.spp, options.size)
    written = page(sections, options.spp, options.size)  # of finished images only
    PICTURES.mkdir(parents=True, exist_ok=True)
    for old in set(PICTURES.glob("*.png")) - {PICTURES / f"{p.name}.png" for p in everything}:
        old.unlink()
    for picture in everything:
        shutil.copyfile(RENDERED / f"{picture.name}.png", PICTURES / f"{picture.name}.png")
    PAGE.write_text(written, encoding="utf-8")
    size = sum(path.stat().st_size for path in PICTURES.glob("*.png"))
    print(f"{PAGE}, {len(everything)} images of {size / 1e6:.1f} MB in all")


if __name__ == "__main__":
    main()
