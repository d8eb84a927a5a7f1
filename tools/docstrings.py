"""Docstrings of this project (a subset of reStructuredText) as Markdown."""

from __future__ import annotations

import ast
import inspect
import itertools
import re
import textwrap
from collections.abc import Iterator
from typing import Any

_CODE = re.compile(r"(`[^`\n]+`)")


def markdown(docstring: str | None) -> str:
    """A docstring as Markdown: roles, code, literal blocks, doctests, definitions, headings."""
    return "\n\n".join(_paragraphs(inspect.cleandoc(docstring or ""))).strip()


def manual(thing: Any) -> str:
    """The docstring of a class or function as Markdown; empty if it has none itself."""
    own = vars(thing).get("__doc__") if inspect.isclass(thing) else thing.__doc__
    return markdown(own)


def field_docs(cls: type) -> dict[str, str]:
    """The string that follows a field in the source of its class, for each field that has one."""
    body = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0].body  # type: ignore[attr-defined]
    docs = {}
    for field, after in itertools.pairwise(body):
        if isinstance(field, ast.AnnAssign) and isinstance(after, ast.Expr):
            if isinstance(after.value, ast.Constant) and isinstance(field.target, ast.Name):
                docs[field.target.id] = inline(" ".join(str(after.value.value).split()))
    return docs


def inline(text: str) -> str:
    """Roles and double backquotes become code; stars inside words are escaped."""
    text = re.sub(r":\w+:`~?([^`]+)`", lambda role: f"`{_last(role[0], role[1])}`", text)
    parts = _CODE.split(text.replace("``", "`"))
    parts[::2] = [re.sub(r"(?<=\w)\*(?=\w)", r"\\*", part) for part in parts[::2]]
    return "".join(parts)


def _last(role: str, target: str) -> str:
    return target.rpartition(".")[2] if "~" in role else target


def _paragraphs(text: str) -> Iterator[str]:
    literal = False
    for paragraph in re.split(r"\n\s*\n", text):
        first, _, rest = paragraph.partition("\n")
        if literal and paragraph.startswith(" "):
            yield f"```text\n{textwrap.dedent(paragraph)}\n```"
            continue
        literal = paragraph.endswith("::")
        if literal:
            paragraph = paragraph.removesuffix(":")
        if paragraph.startswith(">>>"):
            yield f"```pycon\n{paragraph}\n```"
        elif rest and re.fullmatch(r"(-{3,}|={3,})", rest.strip()):
            yield f"**{inline(first)}**"
        elif rest.startswith("    ") and not first.startswith(("*", "-", " ")):
            yield "\n".join(_definitions(paragraph))
        else:
            yield inline(paragraph)


def _definitions(paragraph: str) -> Iterator[str]:
    """Lines ``term`` with indented text below, as a list."""
    for term, text in re.findall(r"^(\S.*)\n((?:[ ]{4}.*\n?)+)", paragraph, re.MULTILINE):
        yield f"* {inline(term)}:\n" + textwrap.indent(inline(textwrap.dedent(text)).strip(), "  ")
