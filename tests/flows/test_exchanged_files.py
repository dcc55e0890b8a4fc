"""Files of a received result that become links after they were checked: what is read is what was checked."""

import base64
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hfb.body.assets import load_default_body
from hfb.flows import export, record, report
from hfb.interop.writers.export_names import RECORD
from hfb.io.media.images import image_io
from hfb.io.media.images.image_io import stored_png, write_png
from hfb.motion.motion_file import save_motion
from hfb.report.pages import page
from hfb.tasks.core.handles import sha256_of
from hfb.tasks.results.workspace import publish, workspace
from hfb.tasks.tracking.run_record import RecordedFile, RunRecord
from tests.faults.stores import artifacts_of
from tests.interop.writers.motions import motion_of

Exchange = Callable[..., Callable[..., Any]]


def drawn(path: Path, level: float) -> bytes:
    write_png(path, np.full((4, 6, 3), level, np.float32))
    return path.read_bytes()


@pytest.fixture
def received(tmp_path: Path) -> Path:
    out = tmp_path / "received"
    save_motion(tmp_path / "motion.npz", motion_of(load_default_body(), frames=1), "hfb")
    drawn(tmp_path / "texture.png", 0.25)
    drawn(tmp_path / "strip.png", 0.5)
    with workspace(out):
        made = {name: tmp_path / name for name in ("motion.npz", "texture.png", "strip.png")}
        publish(out, made, {"out": str(out), "mlflow_run_id": None})
    return out


@pytest.fixture
def exchange(received: Path, tmp_path: Path) -> Exchange:
    """A function that, before it does its work, has every picture of the result replaced by a link to the user's."""
    drawn(tmp_path / "private.png", 0.9)

    def before(function: Callable[..., Any]) -> Callable[..., Any]:
        def exchanged(*args: Any, **options: Any) -> Any:
            for name in ("texture.png", "strip.png"):
                (received / name).unlink()
                (received / name).symlink_to(tmp_path / "private.png")
            return function(*args, **options)

        return exchanged

    return before


def test_a_page(
    store: Path, received: Path, exchange: Exchange, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "write_page", exchange(report.write_page))
    report.make_report(str(received), None)
    text = (received / "report.html").read_text()
    for name, shown in (("texture", True), ("strip", True), ("private", False)):
        assert (base64.b64encode((tmp_path / f"{name}.png").read_bytes()).decode() in text) is shown, name


def test_an_export(received: Path, exchange: Exchange, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "load_motion", exchange(export.load_motion))
    export.export_result(str(received), tmp_path / "out", ("glb",), ())
    content = (tmp_path / "out" / "motion.glb").read_bytes()
    assert (tmp_path / "texture.png").read_bytes() in content
    assert (tmp_path / "private.png").read_bytes() not in content


def test_a_late_record(
    store: Path, received: Path, exchange: Exchange, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = {"strip.png": RecordedFile(sha256=sha256_of(received / "strip.png"))}
    kept = RunRecord(name="a", key="b", params={}, tags={}, points={}, files=files, contents={})
    (received / RECORD).write_text(kept.model_dump_json())
    monkeypatch.setattr(record, "write_run", exchange(record.write_run))
    (run,) = record.record_folder(received)["runs"]
    assert "strip.png" in artifacts_of(store, run["mlflow_run_id"])
    (artifact,) = (store.parent / "mlflow-artifacts").rglob("strip.png")
    assert hashlib.sha256(artifact.read_bytes()).hexdigest() == files["strip.png"].sha256
    assert json.loads((received / "result.json").read_text())["mlflow_run_id"] == run["mlflow_run_id"]


def test_a_picture_is_embedded_as_it_was_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = b"\x89PNG and what no decoder has seen"
    picture = tmp_path / "a.png"
    for module, read in ((image_io, stored_png), (page, lambda path: page.checked_picture(path, 100, 1 << 20))):
        content = drawn(picture, 0.5)
        for name in ("decode_picture", "read_picture_srgb"):
            if (decode := getattr(module, name, None)) is not None:

                def then_exchanged(*args: Any, decode: Callable[..., Any] = decode, **options: Any) -> Any:
                    decoded = decode(*args, **options)
                    picture.write_bytes(bomb)
                    return decoded

                monkeypatch.setattr(module, name, then_exchanged)
        assert read(picture) == content
