"""All that is needed to write a transmittance law.

=================  ===============================================================================
``contract``       the abstract law: ff, fp, pf, pp and sampling
``parameters``     kinds of parameters that a law can have (``kinds``: what they have in common)
``choice``         choosing one of several alternatives, for mixtures
``piecewise``      laws that are curves through points
``columns``        tables of transmittances, from text and NPZ files
``shown``          how laws and fits show themselves in Jupyter
``functions``      Python functions that scene files name
=================  ===============================================================================
"""

from .contract import Draw, Transmittance

__all__ = ["Draw", "Transmittance"]
