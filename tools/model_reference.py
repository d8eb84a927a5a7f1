"""Write docs/models.md, the manual of the models, from what their classes say of themselves."""

from __future__ import annotations

import dataclasses
import inspect
from pathlib import Path

from nonexp import models, parameters

TARGET = Path(__file__).resolve().parent.parent / "docs" / "models.md"

HEAD = """\
# Models

Written by `tools/model_reference.py` from the docstrings of `nonexp/models/`; `nonexp models`
prints the short form, `nonexp plot MODEL` draws one. `T` is the transmittance between two points
that are not correlated with the scatterers, over optical depth `tau`; `sigma_bar = -T'(0)` the
mean extinction per unit of it. See [accuracy.md](accuracy.md) for the errors in single precision.
"""


def page(key: str) -> str:
    cls = models.registry[key]
    model = models.create(key, **cls.examples[0])
    fields = dataclasses.fields(cls)  # type: ignore[arg-type]
    manual = (inspect.getdoc(cls) or "").replace("*", "\\*").replace("``", "`")
    lines = [f"## {key}", "", manual, ""]
    lines += ["| parameter | meaning |", "|---|---|"] if fields else ["No parameters.", ""]
    for field in fields:
        name, _, doc = parameters.describe(field).partition(": ")
        lines.append(f"| `{name}` | {doc} |")
    lines += [""] if fields else []
    lines += [f"`sigma_bar` = {float(model.sigma_bar):g} for", ""]
    return "\n".join([*lines, "```xml", models.to_xml(model), "```", ""])


def text() -> str:
    return "\n".join([HEAD, *(page(key) for key in models.names())])


if __name__ == "__main__":
    TARGET.write_text(text(), encoding="utf-8")
    print(TARGET)
