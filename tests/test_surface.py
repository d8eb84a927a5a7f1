"""What a BSDF answers in one call is what it answers in two."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.integrators import surface

TEXTURE = {"type": "checkerboard", "to_uv": mi.ScalarTransform4f().scale(8)}
WALL = {"type": "diffuse", "reflectance": TEXTURE}
PLASTIC = {"type": "roughplastic", "diffuse_reflectance": TEXTURE}
BSDFS: dict[str, Any] = {
    "wall": WALL,
    "two-sided wall": {"type": "twosided", "nested": WALL},
    "two different walls": {"type": "twosided", "a": WALL, "b": {"type": "diffuse"}},
    "plastic": PLASTIC,
    "two-sided plastic": {"type": "twosided", "nested": PLASTIC},
    "glass": {"type": "dielectric"},
    "nothing": {"type": "null"},
}


def asked(bsdfs: list[mi.BSDF], ask: Any) -> tuple[list[Any], str]:
    """Answers to ``ask`` for directions on all sides, and the program that gave them."""
    n = 20_000
    rng = np.random.default_rng(7)
    which = mi.UInt32(rng.integers(0, len(bsdfs) + 1, n))
    pointer = dr.zeros(mi.BSDFPtr, n)
    for number, bsdf in enumerate(bsdfs):
        pointer = dr.select(which == number, mi.BSDFPtr(bsdf), pointer)
    wi, wo = (
        dr.normalize(mi.Vector3f(rng.normal(size=(3, n)).astype(np.float32))) for _ in range(2)
    )
    u = mi.Point3f(rng.random((3, n), dtype=np.float32))
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi, si.uv = wi, mi.Point2f(rng.random((2, n), dtype=np.float32))
    active = mi.Bool(rng.random(n) < 0.8)
    dr.eval(pointer, si, wo, u, active)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        value, pdf, bs, weight = ask(pointer, si, wo, u.x, mi.Point2f(u.y, u.z), active)
        parts = [value, pdf, bs.wo, bs.pdf, bs.eta, mi.Float(bs.sampled_type), weight]
        dr.eval(parts)
        program = dr.kernel_history([dr.KernelType.JIT])[-1]["ir"].getvalue()
    return [np.array(part) for part in parts], program


def in_two(bsdf: Any, si: Any, wo: Any, u1: Any, u2: Any, active: Any) -> Any:
    return bsdf.eval_pdf_sample(mi.BSDFContext(), si, wo, u1, u2, active)


def test_same_answers() -> None:
    """Of all kinds of surfaces at once, and of each alone."""
    loaded = [mi.load_dict(bsdf) for bsdf in BSDFS.values()]
    for bsdfs in (loaded, *([bsdf] for bsdf in loaded)):
        found, _ = asked(bsdfs, surface.eval_pdf_sample)
        expected, _ = asked(bsdfs, in_two)
        for a, b in zip(found, expected, strict=True):
            np.testing.assert_allclose(a, b, rtol=3e-7, atol=1e-9)
        assert np.any(expected[-1] > 0)


def test_textures_of_diffuse_surfaces_are_looked_up_once() -> None:
    values = np.random.default_rng(1).random((4, 4, 3), dtype=np.float32)

    def gathers(ask: Any, two_sided: bool) -> int:
        # Loading a bitmap takes its data away.
        bitmap = {"type": "bitmap", "data": mi.TensorXf(values), "raw": True}
        bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": bitmap}
        bsdf = {"type": "twosided", "nested": bsdf} if two_sided else bsdf
        return asked([mi.load_dict(bsdf)], ask)[1].count("gather")

    for two_sided in (False, True):
        saved = gathers(in_two, two_sided) - gathers(surface.eval_pdf_sample, two_sided)
        # The texels between which one look-up interpolates; what is nested is there by itself, too.
        assert saved == (8 if two_sided else 4)
