"""Mitsuba plugins: the medium, the textures that carry laws, and their registration."""

from .registration import install, register, supported, unsupported_reason

__all__ = ["install", "register", "supported", "unsupported_reason"]
