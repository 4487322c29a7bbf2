"""Every notebook runs, draws its picture, and says what its text says it does."""

from __future__ import annotations

from pathlib import Path

import jupytext
import nbclient
import pytest

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.py"))
#: What must be among the outputs.
SAID = {
    "what_is_missing": ("Gain step of 0.04", "no gap beyond the noise"),
    "what_a_design_can_tell": ("frame_offset",),
    "how_sure_is_a_fit": ("within_2_SE",),
}


def test_every_notebook_is_known() -> None:
    assert [notebook.stem for notebook in NOTEBOOKS] == sorted(SAID)


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_draws_and_says_what_it_should(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    cells = jupytext.read(notebook)
    nbclient.NotebookClient(cells, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}).execute()
    said = "".join(_text(output) for cell in cells.cells for output in cell.get("outputs", []))
    for phrase in SAID[notebook.stem]:
        assert phrase in said
    assert (tmp_path / f"{notebook.stem}.png").stat().st_size > 5_000
    assert (FOLDER / f"{notebook.stem}.png").is_file(), "make notebooks draws it"


def _text(output: nbclient.client.NotebookNode) -> str:
    return output.get("text") or output.get("data", {}).get("text/plain", "")
