"""Render a scene in passes, and save the image with its standard error.

python examples/render_scene.py [OUT.png]
"""

import os
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

import nonexp
from nonexp.images import tone_map

SCENE = Path(__file__).parent.parent / "scenes" / "dragon.xml"
QUALITY = float(os.environ.get("NONEXP_QUALITY", 1))

mi.set_variant("llvm_ad_rgb")
width = 4 * round(80 * min(QUALITY, 1) ** 0.5)
scene = mi.load_file(str(SCENE), medium="gamma", width=str(width), height=str(width * 3 // 4))
image = nonexp.render(scene, spp=max(8, int(64 * QUALITY)), seed=1)

target = sys.argv[1] if len(sys.argv) > 1 else "dragon.png"
mi.Bitmap(np.uint8(np.round(255 * tone_map(image.mean)))).write(target)
noise = np.sqrt(np.mean(image.stderr**2)) / np.mean(image.mean)
print(f"{target}: {image.spp} samples per pixel in {image.seconds:.1f} s, noise {noise:.1%}")
