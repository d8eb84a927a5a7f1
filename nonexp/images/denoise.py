"""Denoising a finished image, on request only: what it adds is a guess."""

from __future__ import annotations

from importlib import metadata

import mitsuba as mi
import numpy as np

from .moments import Array

__all__ = ["denoise", "require"]


def require() -> None:
    """Raise ``ImportError``, in one sentence, where there is no denoiser."""
    if not _optix():
        try:
            import pyoidn  # noqa: F401
        except (ImportError, OSError):
            raise ImportError(
                "denoising needs a CUDA variant, or Open Image Denoise, which is not installed: "
                "pip install 'nonexp[denoise]'"
            ) from None


def denoise(image: Array) -> tuple[Array, str]:
    """An image of linear RGB values without most of its noise, and what removed it.

    By Mitsuba's OptiX denoiser in CUDA variants, else by Open Image Denoise (package pyoidn, the
    extra ``denoise``). Both are neural networks that are given nothing but the image.
    """
    require()
    noisy = np.ascontiguousarray(image, dtype=np.float32)
    if _optix():
        height, width, _ = noisy.shape
        clean = mi.OptixDenoiser([width, height])(mi.TensorXf(noisy))
        return np.array(clean, dtype=np.float64), "OptiX"
    import pyoidn

    clean = pyoidn.denoise(noisy, hdr=True)
    return np.asarray(clean, dtype=np.float64), f"Open Image Denoise {metadata.version('pyoidn')}"


def _optix() -> bool:
    return (mi.variant() or "").startswith("cuda")
