"""nonexp: participating media with non-exponential transmittance for Mitsuba 3.

Importing the package registers its plugins with Mitsuba, for the variant that is set now and for
every variant set later: the integrator ``nonexp_volpath``, the medium ``nonexp_homogeneous`` and
one ``transmittance_<model>`` per model. Models also work alone, on floats and Dr.Jit arrays.
"""

from __future__ import annotations

import os as _os

from .system.machine import load_drjit as _load_drjit
from .system.machine import select_llvm as _select_llvm
from .system.version import __version__

# In a source tree the integrators stand beside this folder, not inside it.
_root = _os.path.dirname(_os.path.dirname(_os.path.abspath(__file__)))
if all(_os.path.exists(_os.path.join(_root, p)) for p in ("pyproject.toml", "integrators")):
    __path__.append(_root)

_select_llvm()  # before Dr.Jit starts its LLVM backend
_load_drjit()

from . import models, parameters, plugins  # noqa: E402
from .fitting import fit  # noqa: E402
from .images.image import Image  # noqa: E402
from .parameters import parameter  # noqa: E402
from .plugins.gridfiles import read_grid  # noqa: E402
from .rendering.render import render  # noqa: E402
from .rendering.targets import Progress  # noqa: E402
from .transmittance import Draw, Transmittance  # noqa: E402

__all__ = [
    "Draw",
    "Image",
    "Progress",
    "Transmittance",
    "__version__",
    "fit",
    "models",
    "parameter",
    "parameters",
    "plugins",
    "read_grid",
    "render",
]

models.fit = fit  # where it was in version 0.1; the registry itself knows no fitting
plugins.install()
