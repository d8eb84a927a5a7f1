"""Scattering at surfaces: everything that the path asks of a BSDF, in one call."""

from __future__ import annotations

from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi


def eval_pdf_sample(bsdf: Any, si: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Any:
    """Value and density for ``wo``, a direction drawn with ``u1`` and ``u2``, and its weight.

    The answers are those of ``BSDF.eval_pdf_sample``, which looks a diffuse surface's reflectance
    up for each of the two directions: a texture is most of what such a surface costs.
    """
    if not dr.flag(dr.JitFlag.SymbolicLoops):
        # Dr.Jit 1.5 cannot take forward derivatives of a dispatched function in evaluated loops.
        return bsdf.eval_pdf_sample(mi.BSDFContext(), si, wo, u1, u2, active)
    return dr.dispatch(bsdf, partial(_scatter, mi.BSDFContext()), si, wo, u1, u2, active)


def _scatter(
    context: mi.BSDFContext, bsdf: mi.BSDF | None, si: Any, wo: Any, u1: Any, u2: Any, active: Any
) -> Any:
    if bsdf is None:  # a scene without surfaces
        sample = dr.zeros(mi.BSDFSample3f)
        return mi.Spectrum(0), mi.Float(0), sample, mi.Spectrum(0)
    sides = 2 if bsdf.class_name() == "TwoSidedBRDF" else 1
    diffuse = _one_brdf(bsdf) if sides == 2 else bsdf
    if diffuse is None or diffuse.class_name() != "SmoothDiffuse":
        return bsdf.eval_pdf_sample(context, si, wo, u1, u2, active)
    bs, weight = bsdf.sample(context, si, u1, u2, active)
    cos_i, cos_o = si.wi.z, wo.z
    if sides == 2:
        cos_i, cos_o = dr.abs(cos_i), dr.mulsign(cos_o, cos_i)
    lit = active & (cos_i > 0)  # as in `sample`, so that both look-ups become one
    reflectance = diffuse.eval_diffuse_reflectance(si, lit)
    pdf = dr.select(lit & (cos_o > 0), dr.inv_pi * cos_o, 0)
    return reflectance * pdf, pdf, bs, weight


def _one_brdf(bsdf: mi.BSDF) -> Any:
    """What both sides of a two-sided surface are, if they are the same."""
    nested = [node for node in mi.traverse(bsdf).hierarchy if isinstance(node, mi.BSDF)]
    return nested[1] if len(nested) == 2 else None
