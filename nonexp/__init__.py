"""nonexp: participating media with non-exponential transmittance for Mitsuba 3.

Importing the package registers its plugins with Mitsuba, for the variant that is set now and for
every variant set later: the integrator ``nonexp_volpath``, the medium ``nonexp_homogeneous`` and
one ``transmittance_<model>`` per model. Models also work alone, on floats and Dr.Jit arrays.
"""

from __future__ import annotations

import os as _os

from .machine import load_drjit as _load_drjit
from .machine import select_llvm as _select_llvm

__version__ = "0.1.0"

# In a source tree the integrators stand beside this folder, not inside it.
_root = _os.path.dirname(_os.path.dirname(_os.path.abspath(__file__)))
if all(_os.path.exists(_os.path.join(_root, p)) for p in ("pyproject.toml", "integrators")):
    __path__.append(_root)

_select_llvm()  # before Dr.Jit starts its LLVM backend
_load_drjit()

from . import models, parameters, plugins  # noqa: E402
from .parameters import parameter  # noqa: E402
from .rendering import Image, render  # noqa: E402
from .targets import Progress  # noqa: E402
from .transmittance import Draw, Transmittance  # noqa: E402

__all__ = [
    "Draw",
    "Image",
    "Progress",
    "Transmittance",
    "__version__",
    "models",
    "parameter",
    "parameters",
    "plugins",
    "render",
]

plugins.install()
