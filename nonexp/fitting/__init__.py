"""Fitting models to measured transmittances, and drawing models and fits."""

from ..transmittance.columns import read_table
from .fit import Fit, compare, fit

__all__ = ["Fit", "compare", "fit", "read_table"]
