"""One scene, many values of a parameter: the kernel is compiled once.

python examples/sweep_parameter.py
"""

import os
from pathlib import Path

import mitsuba as mi

import nonexp

SCENE = Path(__file__).parent.parent / "scenes" / "fog.xml"
QUALITY = float(os.environ.get("NONEXP_QUALITY", 1))

mi.set_variant("llvm_ad_rgb")
scene = mi.load_file(str(SCENE), medium="linear", width="160", height="120")
parameters = mi.traverse(scene)

print("longest flight b   mean radiance   seconds")
for b in (1000.0, 4.0, 1.72, 1.2, 0.8):
    parameters["medium.transmittance.b"] = b
    parameters.update()
    image = nonexp.render(scene, spp=max(8, int(64 * QUALITY)), seed=1)
    print(f"{b:16g}   {image.mean.mean():13.4f}   {image.seconds:7.2f}")
