"""Numbers in kernels: functions that stay accurate, tables, transforms. No Mitsuba, no laws.

=================  ===============================================================================
``elementary``     logarithms and exponentials without cancellation; these are imported from here
``special``        incomplete gamma functions, a spline
``lookup``         tables of numbers that a kernel reads
``laplace``        Laplace transforms of a law of finitely many values, draws of them
``alternating``    collisions along a ray through two materials that alternate
``quadrature``     laws of ``scipy.stats`` as few weighted values
=================  ===============================================================================
"""

from .elementary import expm1, filled, log1p, scaled_log1p, select, with_derivative

__all__ = ["expm1", "filled", "log1p", "scaled_log1p", "select", "with_derivative"]
