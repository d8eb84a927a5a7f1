"""The quick tier has everything once: laws, values of configurations, documented commands."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import test_configurations
import test_documents
from stability_cases import CASES
from tiers import THOROUGH, repetitions

from nonexp import models

pytestmark = THOROUGH

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent


class Collector:
    """A plugin that keeps what a session would run."""

    items: list[Any]

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        self.items = list(session.items)


def collected(*options: str) -> list[Any]:
    """The tests of a session with these options, whichever runs now."""
    collector = Collector()
    quiet = ["--collect-only", "-qqq", "-p", "no:cacheprovider", "-p", "no:xdist"]
    arguments = ["-o", "addopts=", *quiet, "--rootdir", str(ROOT), *options]
    assert pytest.main(arguments, [collector]) == 0
    return collector.items


@cache
def suite() -> tuple[list[Any], list[Any]]:
    """All tests, and the quick ones."""
    every = collected(str(TESTS))
    return every, [item for item in every if not item.get_closest_marker("thorough")]


def parameters(items: list[Any]) -> Iterator[tuple[str, str, Any]]:
    """File with test, name of a parameter, value."""
    for item in items:
        for name, value in (item.callspec.params if hasattr(item, "callspec") else {}).items():
            yield f"{item.path.name}::{item.originalname}", name, value


def laws(items: list[Any]) -> dict[str, set[str]]:
    """Models on which tests with models run."""
    found: dict[str, set[str]] = defaultdict(set)
    for test, name, value in parameters(items):
        if name in ("position", "flights"):
            value = CASES[value if name == "position" else value[0]]
        if isinstance(value, tuple) and value and value[0] in models.registry:
            found[test].add(value[0])
        if isinstance(value, str) and name == "key" and value in models.registry:
            found[test].add(value)
    return found


def test_quick_leaves_out_what_is_thorough() -> None:
    path = TESTS / "test_configurations.py"
    quickly = {item.nodeid for item in collected("--quick", str(path))}
    assert quickly == {item.nodeid for item in suite()[1] if item.path == path}
    assert 0 < len(quickly) < len([item for item in suite()[0] if item.path == path])


def test_every_test_of_all_models_is_quick_on_all() -> None:
    everywhere, quickly = map(laws, suite())
    few = {"test_exact.py", "test_renders.py", "test_chromatic.py", "test_heterogeneous.py"}
    of_all = {test for test, keys in everywhere.items() if len(keys) == len(models.names())}
    assert len(of_all) > 30
    for test in of_all:
        if test.partition("::")[0] not in few:
            assert quickly[test] == set(models.names()), test
    rendered = [test for test in of_all if quickly[test] == set(models.names()) and "exact" in test]
    assert len(rendered) >= 3


def test_every_axis_of_configurations_is_quick() -> None:
    test = "test_configurations.py::test_with_and_without_connections"
    numbers = [value for where, _, value in parameters(suite()[1]) if where == test]
    chosen = [test_configurations.MATRIX[number] for number in numbers]
    for i, values in enumerate(zip(*test_configurations.MATRIX, strict=True)):
        assert {row[i] for row in chosen} == set(values)
        for j, others in enumerate(zip(*test_configurations.MATRIX, strict=True)):
            if i < j:  # pairwise
                pairs = {(row[i], row[j]) for row in chosen}
                assert pairs == set(zip(values, others, strict=True))


def test_documents_are_quick_but_for_what_builds_pages() -> None:
    every, quickly = (
        {item.nodeid for item in items if item.path.name == "test_documents.py"}
        for items in suite()
    )
    commands = {node for node in quickly if "test_command_is_understood" in node}
    assert len(commands) == len(test_documents.commands())
    assert {re.sub(r".*::", "", node) for node in every - quickly} <= {
        "test_documentation_builds_without_a_warning"
    }


def test_repetitions_are_tests_of_which_other_cases_stay() -> None:
    kept = {item.nodeid.partition("[")[0] for item in suite()[0]}
    listed = [
        item.nodeid
        for item in collected("--full", str(TESTS))
        if repetitions().fullmatch(item.nodeid.removeprefix("tests/"))
    ]
    text = (TESTS / "repetitions.txt").read_text(encoding="utf-8")
    for line in text.splitlines():
        if line and not line.startswith("#"):
            pattern = re.escape(line).replace(r"\*", ".*")
            matches = [n for n in listed if re.fullmatch(pattern, n.removeprefix("tests/"))]
            assert matches, line
            assert {name.partition("[")[0] for name in matches} <= kept, line
