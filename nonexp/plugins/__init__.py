"""Mitsuba plugins: the medium, the textures that carry laws, and their registration."""

from ..system.machine import supported, unsupported_reason
from .registration import install, register

__all__ = ["install", "register", "supported", "unsupported_reason"]
