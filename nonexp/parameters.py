"""Kinds of parameters of a law: :mod:`nonexp.transmittance.parameters`, under a short name."""

from .transmittance import parameters as _parameters
from .transmittance.parameters import *  # noqa: F403

__all__ = _parameters.__all__
