"""The checks of laws as tests of pytest: ``pytest --nonexp-law my_module:MyLaw``.

pytest loads this file in every run, also of people who do not use nonexp: it is installed as the
package ``nonexp_pytest``, so that nonexp and Mitsuba are imported only where the option is given.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

__all__ = ["LawItem", "pytest_addoption", "pytest_collection_modifyitems"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option ``--nonexp-law``."""
    group = parser.getgroup("nonexp", "transmittance laws")
    group.addoption(
        "--nonexp-law",
        action="append",
        default=[],
        metavar="MODULE:LAW",
        help="also check this law: module:Class, a module or file of laws, or a model's name; "
        "may be repeated",
    )


@pytest.hookimpl(tryfirst=True)  # before -k and --deselect choose
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Add one test for each check of each law."""
    for name in config.getoption("--nonexp-law"):
        items.extend(_items(session, config, name))


def _items(session: pytest.Session, config: pytest.Config, name: str) -> Iterator[pytest.Item]:
    from nonexp.testing.laws import CHECKS, find_laws, law_checks

    folders = [str(config.invocation_params.dir), str(config.rootpath)]
    try:
        laws = find_laws(name, folders)
    except ValueError as error:
        raise pytest.UsageError(f"--nonexp-law: {error}") from None
    for law in laws:
        for checks in law_checks(law):
            for check in CHECKS:
                title = f"{checks.name} {check.name}"
                node = f"{name}::{title}"
                yield LawItem.from_parent(
                    session, name=title, nodeid=node, checks=checks, check=check
                )


class LawItem(pytest.Item):
    """A check of a law."""

    def __init__(self, *, checks: Any, check: Any, **kw: Any) -> None:
        super().__init__(**kw)
        self.checks, self.check = checks, check

    def runtest(self) -> None:
        outcome = self.checks.outcome(self.check)
        if outcome.skipped:
            pytest.skip(f"presupposes {outcome.skipped}")
        if outcome.fault:
            raise AssertionError(f"{self.checks.name}: {self.check.name}: {outcome.fault}")

    def repr_failure(self, excinfo: Any, style: Any = None) -> Any:
        if isinstance(excinfo.value, AssertionError):
            return str(excinfo.value)
        return super().repr_failure(excinfo)

    def reportinfo(self) -> tuple[Any, int | None, str]:
        return self.nodeid.partition("::")[0], None, self.name
