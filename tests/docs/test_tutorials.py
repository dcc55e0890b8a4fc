"""Tutorials, and code of other documents that a reader copies: run as it stands there.

The presets that their commands use are smaller here: the same steps, with few iterations on small images.
"""

import doctest
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hfb.interop.writers.export_names import BLENDER, find_blender
from tests.docs.small_presets import small_environment
from tests.documents import ROOT, code_blocks

_TUTORIALS = sorted(path.name for path in (ROOT / "docs" / "tutorials").glob("*.md") if path.stem != "index")
_LONGEST_S = 600


@pytest.mark.parametrize("name", _TUTORIALS)
def test_a_tutorial_runs(name: str, tmp_path: Path, store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    blocks = code_blocks(ROOT / "docs" / "tutorials" / name, "bash", "python")
    assert blocks
    for language, code in blocks:
        if language == "bash":
            _run(code, tmp_path)
        else:
            names = _doctest(code, names)
    if name == "first-motion.md":  # whose images the README's lines fit
        for source, target in (("frame_0.png", "frame.png"), ("background.png", "plate.png")):
            shutil.copy(tmp_path / "cases" / "case_0001" / source, tmp_path / target)
        (readme,) = [code for _, code in code_blocks(ROOT / "README.md", "python")]
        _run(f"python - <<'END'\n{readme}\nEND", tmp_path)


@pytest.mark.parametrize(
    ("name", "picture"), [("researcher", "compared"), ("sports_engineer", "upright"), ("artist", "blender")]
)
def test_an_example_leaves_its_picture(name: str, picture: str, tmp_path: Path, store: Path) -> None:
    if name == "artist" and find_blender() is None:
        pytest.skip(f"Blender is not on the path, and {BLENDER} names none")
    _run(f"python {ROOT}/examples/{name}.py out", tmp_path)
    drawn = cv2.imread(str(tmp_path / "out" / f"{picture}.png"))
    assert min(drawn.shape[:2]) > 100
    assert drawn.std() > 10


def test_a_calibration_by_the_book_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hfb.io.clip import ClipCamera
    from hfb.io.media.lens.clip_lens import clip_lens

    _photograph_chessboard(tmp_path / "chessboard")
    monkeypatch.chdir(tmp_path)
    code = next(code for _, code in code_blocks(ROOT / "docs" / "howto" / "calibrate-camera.md", "python"))
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["error_px"] < 0.5
    lens = clip_lens(ClipCamera(calibration=tmp_path / "camera.yml"), "clip.mp4", _SIZE[1], _SIZE[0])
    assert lens is not None
    assert lens.K[0] == pytest.approx(_FOCAL_PX, rel=0.02)


_FOCAL_PX, _SIZE = 700.0, (640, 480)


def _photograph_chessboard(folder: Path) -> None:
    """Twelve views of a board of 10 x 7 squares by a camera of known focal length."""
    folder.mkdir()
    square_px = 40
    board = np.kron(np.indices((7, 10)).sum(0) % 2, np.ones((square_px, square_px))).astype(np.uint8) * 255
    board = cv2.copyMakeBorder(board, square_px, square_px, square_px, square_px, cv2.BORDER_CONSTANT, value=255)
    to_metres = np.diag([0.025 / square_px, 0.025 / square_px, 1]) @ [[1, 0, -240], [0, 1, -180], [0, 0, 1]]
    K = np.array([[_FOCAL_PX, 0, _SIZE[0] / 2], [0, _FOCAL_PX, _SIZE[1] / 2], [0, 0, 1]])
    rng = np.random.default_rng(0)
    for number in range(12):
        turn, _ = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))
        place = np.array([*rng.uniform(-0.03, 0.03, 2), rng.uniform(0.4, 0.55)])
        homography = K @ np.column_stack([turn[:, 0], turn[:, 1], place]) @ to_metres
        view = cv2.warpPerspective(board, homography, _SIZE, flags=cv2.INTER_AREA, borderValue=255)
        cv2.imwrite(str(folder / f"{number:02}.png"), view)


def _run(code: str, folder: Path) -> None:
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", code],
        cwd=folder,
        env=small_environment(folder),
        capture_output=True,
        text=True,
        timeout=_LONGEST_S,
    )
    assert done.returncode == 0, done.stderr


def _doctest(code: str, names: dict[str, Any]) -> dict[str, Any]:
    """Run a block of examples; returns the names that are known after it."""
    test = doctest.DocTestParser().get_doctest(code, names, "tutorial", None, 0)
    said: list[str] = []
    outcome = doctest.DocTestRunner().run(test, out=said.append, clear_globs=False)
    assert outcome.attempted > 0
    assert outcome.failed == 0, "".join(said)
    return test.globs
