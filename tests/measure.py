"""The statistics of :mod:`nonexp.testing` under the names that the tests use; kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from nonexp.testing.statistics import (
    FALSE_ALARM,
    PASSES,
    assert_same,
    assert_share,
    passes,
    radiance,
)
from nonexp.testing.statistics import mean_is as assert_mean

__all__ = [
    "FALSE_ALARM",
    "PASSES",
    "assert_mean",
    "assert_same",
    "assert_share",
    "largest_kernel",
    "passes",
    "radiance",
]


def largest_kernel(run: Callable[[], Any]) -> Any:
    """Of the kernels that ``run`` launches the one of most operations, as Dr.Jit records it."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        run()
        return max(dr.kernel_history([dr.KernelType.JIT]), key=lambda k: k["operation_count"])
