"""Shared set-up: every test starts in llvm_ad_rgb unless it chooses a variant itself."""

from __future__ import annotations

import os
from collections.abc import Iterator

import drjit as dr
import mitsuba as mi
import pytest
from tiers import repetitions

import nonexp  # noqa: F401  (registers the plugins)

mi.set_variant("llvm_ad_rgb")
mi.set_log_level(mi.LogLevel.Error)

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def pytest_configure(config: pytest.Config) -> None:
    """Workers of pytest-xdist share the cores: more threads than cores wait for each other."""
    dr.set_thread_count(max(1, CORES // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1))))


@pytest.fixture(scope="module")
def several_threads() -> Iterator[None]:
    """Dr.Jit has 2 threads or more: what should not depend on their order could."""
    before = dr.thread_count()
    dr.set_thread_count(max(2, CORES))
    yield
    dr.set_thread_count(before)


@pytest.fixture(autouse=True)
def rgb() -> Iterator[None]:
    mi.set_variant("llvm_ad_rgb")
    yield
    mi.set_variant("llvm_ad_rgb")


@pytest.fixture
def variant(request: pytest.FixtureRequest) -> str:
    """Indirect parameter: the variant to run in."""
    mi.set_variant(request.param)
    return str(request.param)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", action="store_true", help="without the tests marked thorough")
    parser.addoption("--full", action="store_true", help="full statistics instead of reduced ones")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out, with --quick, what is marked thorough, and without --full repetitions."""
    quick, full, listed = config.getoption("--quick"), config.getoption("--full"), repetitions()

    def runs(item: pytest.Item) -> bool:
        if quick and item.get_closest_marker("thorough"):
            return False
        return full or not listed.fullmatch(item.nodeid.removeprefix("tests/"))

    config.hook.pytest_deselected(items=[item for item in items if not runs(item)])
    items[:] = [item for item in items if runs(item)]


@pytest.fixture(scope="session")
def effort(request: pytest.FixtureRequest) -> int:
    """Factor on sample counts: 1 in the reduced form, 16 with --full."""
    return 16 if request.config.getoption("--full") else 1
