"""Notebooks run from the first cell to the last in Jupyter's own kernel, and are committed without what they print."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

from hfb.datasets.example import write_example
from hfb.tasks.core.handles import sha256_of
from tests.docs.small_presets import small_environment
from tests.documents import ROOT
from tests.orchestration import migrated_store, mlflow_rows

_NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
_LARGEST_BYTES = 10_000
_LONGEST_S = 300


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Any]]:
    """Executes a notebook in the test's folder; returns all outputs of its cells. Cells may be changed before."""
    for name in ("JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path / "jupyter"))

    def execute(name: str, **changed: str) -> list[Any]:
        book = nbformat.read(ROOT / "notebooks" / name, as_version=4)
        for before, after in changed.items():
            (cell,) = [one for one in book.cells if f"{before} = None" in one.source]
            cell.source = cell.source.replace(f"{before} = None", f"{before} = {after!r}")
        client = NotebookClient(book, timeout=_LONGEST_S, resources={"metadata": {"path": str(tmp_path)}})
        client.execute(env=small_environment(tmp_path))
        return [output for cell in book.cells for output in cell.get("outputs", ())]

    return execute


def of_kind(outputs: list[Any], kind: str) -> list[str]:
    """What the outputs hold of one MIME type."""
    return [one["data"][kind] for one in outputs if kind in one.get("data", ())]


@pytest.mark.parametrize("path", _NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_without_outputs(path: Path) -> None:
    assert path.stat().st_size < _LARGEST_BYTES
    book = json.loads(path.read_text())
    nbformat.validate(book)
    cells = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    assert len(cells) > 3
    assert [(cell["outputs"], cell["execution_count"]) for cell in cells] == [([], None)] * len(cells)
    assert set(book["metadata"]) == {"kernelspec", "language_info"}


def test_a_picture_is_fitted(run: Callable[..., list[Any]], tmp_path: Path) -> None:
    outputs = run("fit_your_own_picture.ipynb")
    assert len(of_kind(outputs, "image/png")) == 5  # frame, plate, matte, strip, curves
    (viewer,) = of_kind(outputs, "text/html")
    assert viewer.startswith("<iframe srcdoc=")
    result = tmp_path / "result"
    assert (result / "report.html").stat().st_size > 100_000
    assert {path.name for path in (result / "export").iterdir()} >= {"motion.glb", "motion.bvh", "joints.csv"}


def test_two_paths_are_all_that_changes_for_a_picture_of_ones_own(
    run: Callable[..., list[Any]], tmp_path: Path
) -> None:
    made = write_example(tmp_path / "made", seed=5)
    frame = shutil.copy(made.frame, tmp_path / "a.png")
    plate = shutil.copy(made.background, tmp_path / "b.png")
    run("fit_your_own_picture.ipynb", FRAME="a.png", PLATE="b.png")
    facts = json.loads((tmp_path / "result" / "result.json").read_text())
    assert set(facts["inputs"].values()) == {sha256_of(frame), sha256_of(plate)}
    assert not (tmp_path / "example").exists()


def test_a_prior_is_compared_in_mlflow(run: Callable[..., list[Any]], tmp_path: Path) -> None:
    (tmp_path / "compared").mkdir()
    shutil.copy(migrated_store(), tmp_path / "compared" / "mlflow.db")  # tables alone, which take long to make
    outputs = run("compare_priors_in_mlflow.ipynb")
    (table,) = of_kind(outputs, "text/html")
    for words in ("as_it_is", "mine", "truth/mpjpe_mm", "truth/pa_mpjpe_mm", "matte_iou", "psnr_db"):
        assert words in table, words
    assert len(of_kind(outputs, "image/png")) == 1
    recorded = mlflow_rows(tmp_path / "compared" / "mlflow.db", "select name, status from runs order by start_time")
    assert recorded == [("as_it_is", "FINISHED"), ("mine", "FINISHED")]
