"""Checks for laws, integrators and images, for pytest and for scripts.

``images``        two images are the same but for noise; an image has the mean that it should
``laws``          everything that is asked of a transmittance law
``exponential``   an integrator in exponential media against Mitsuba's ``volpath``
``relations``     the functions of a law beside each other
``precision``     a law in single precision
``samplers``      flights against their distribution
``renders``       a law in scenes of known answers
``statistics``    the tests themselves, and which bias they find
``scenes``        small scenes
``arrays``        laws whose parameters are arrays
``faults``        what a check raises

``pytest_plugin`` is installed as ``nonexp_pytest``, which pytest loads: ``pytest --nonexp-law
my_module:MyLaw``.
"""

from .exponential import Verdict, check_integrator
from .faults import Fault
from .images import assert_mean, assert_same_image
from .laws import Outcome, check_law, law_checks
from .statistics import Agreement

__all__ = [
    "Agreement",
    "Fault",
    "Outcome",
    "Verdict",
    "assert_mean",
    "assert_same_image",
    "check_integrator",
    "check_law",
    "law_checks",
]
