"""Inverse rendering: derivatives of images, and scenes fitted to images.

=================  ===============================================================================
``derivatives``    derivatives of images, by path replay or by differences
``estimate``       :func:`fit`: parameters and laws of media from images
``unknowns``       what is fitted, and where it may lie
``laws``           the law of a medium, and others in its place
``views``          the images, and the sensors that see them
``equations``      normal equations without the bias of noise
``search``         Gauss-Newton steps on them
``result``         what a fit of one law found
``report``         the fits of several laws
``plot``           figures of it
``descent``        :func:`descend`: grids from images, by gradient descent
=================  ===============================================================================
"""

from .derivatives import Derivative, differences, jacobian
from .descent import Descent, descend
from .estimate import fit
from .report import Report
from .result import ImageFit

__all__ = [
    "Derivative",
    "Descent",
    "ImageFit",
    "Report",
    "descend",
    "differences",
    "fit",
    "jacobian",
]
