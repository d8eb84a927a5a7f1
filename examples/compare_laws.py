"""How much light two laws send through the same ball of fog, with error bars.

python examples/compare_laws.py
"""

import os

import mitsuba as mi
import numpy as np

import nonexp

mi.set_variant("llvm_ad_rgb")
spp = max(16, int(1024 * float(os.environ.get("NONEXP_QUALITY", 1))))
view = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
film = {"type": "hdrfilm", "width": 32, "height": 32}
camera = {"type": "perspective", "fov": 20, "to_world": view, "film": film}

radiance = {}
for law in ("exponential", "linear"):
    fog = {"type": "nonexp_homogeneous", "sigma_t": 1.0, "albedo": 0.8}
    fog["transmittance"] = {"type": f"transmittance_{law}"}
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": fog}
    parts = {"integrator": {"type": "nonexp_volpath"}, "light": {"type": "constant"}}
    scene = mi.load_dict({"type": "scene", "camera": camera, "ball": ball, **parts})
    image = nonexp.render(scene, spp=spp, seed=1)
    error = np.sqrt(np.sum(image.stderr[:, :, 0] ** 2)) / image.stderr[:, :, 0].size
    radiance[law] = image.mean[:, :, 0].mean()
    print(f"{law:12} {radiance[law]:.5f} ± {error:.5f}")
