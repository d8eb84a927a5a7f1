"""The notebooks run from top to bottom, and are kept without outputs."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellTimeoutError
from tiers import THOROUGH

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) >= 5


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stripped(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert not cell.outputs, "strip the outputs"
            assert cell.execution_count is None, "strip the outputs"


def executed(path: Path, seconds: float) -> nbformat.NotebookNode:
    """What a notebook is after running; ``seconds`` is the longest that a cell may take."""
    notebook = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(path.parent)}}
    NotebookClient(notebook, timeout=seconds, kernel_name="python3", resources=resources).execute()
    return notebook


@THOROUGH
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path, effort: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a kernel of its own, in its folder; a warning of ours or NumPy's is an error."""
    monkeypatch.setenv("NONEXP_QUALITY", "0.005" if effort == 1 else "0.25")
    monkeypatch.setenv("PYTHONWARNINGS", "error::RuntimeWarning,error::UserWarning:nonexp")
    monkeypatch.delenv("MPLBACKEND", raising=False)
    try:
        notebook = executed(path, 120 * effort)
    except CellTimeoutError:
        # Cells take seconds here. A kernel that waits for a message that was lost waits for ever.
        notebook = executed(path, 120 * effort)
    said = [
        output.text
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        if output.output_type == "stream" and output.name == "stderr"
    ]
    assert not said, "".join(said)
    assert any(
        "image/png" in output.get("data", {})
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    ), "no picture"
