"""Rendering in passes.

=================  ===============================================================================
``render``         a render from its first pass to its last, and its resumption
``job``            what is rendered, how, until when, and where to
``passes``         how samples are divided, and the passes themselves
``sampling``       which sampler, and which of its numbers a pass gets
``targets``        when a render is good enough
``checkpoint``     its state on disk
``progress``       the progress bar
``cluster``        rendering on many machines
=================  ===============================================================================
"""

from .passes import Plan, pass_seed, plan, planned, render_passes

__all__ = ["Plan", "pass_seed", "plan", "planned", "render_passes"]
