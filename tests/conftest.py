"""Shared set-up: every test starts in llvm_ad_rgb unless it chooses a variant itself."""

from __future__ import annotations

from collections.abc import Iterator

import mitsuba as mi
import pytest

import nonexp  # noqa: F401  (registers the plugins)

mi.set_variant("llvm_ad_rgb")
mi.set_log_level(mi.LogLevel.Error)


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
    """Leave out, with --quick, what is marked thorough."""
    if config.getoption("--quick"):
        thorough = [item for item in items if item.get_closest_marker("thorough")]
        config.hook.pytest_deselected(items=thorough)
        items[:] = [item for item in items if not item.get_closest_marker("thorough")]


@pytest.fixture(scope="session")
def effort(request: pytest.FixtureRequest) -> int:
    """Factor on sample counts: 1 in the reduced form, 16 with --full."""
    return 16 if request.config.getoption("--full") else 1
