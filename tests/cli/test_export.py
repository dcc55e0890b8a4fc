"""`hfb export`: a result's folder, a motion file or a run's id, in other programs' formats."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.flows.cli.cli import main
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.images.image_io import write_png
from hfb.motion.motion_file import load_motion, save_motion
from hfb.tasks.results.own_files import OWN_FILES
from tests.interop.writers.motions import motion_of

MOTION = motion_of(load_default_body(torch.float64), frames=2)


@pytest.fixture
def result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a result: a motion and a texture."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    folder = tmp_path / "result"
    save_motion(folder / "motion.npz", MOTION, "hfb")
    write_png(folder / "texture.png", np.full((4, 4, 3), 0.5))
    return folder


def said(capsys: pytest.CaptureFixture[str]) -> dict:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_a_folder(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(result), "--json"]) == 0
    out = result / "export"
    names = {"amass.npz", "motion.glb", "motion.bvh", "joints.csv", "joints.trc"}
    assert {path.name for path in out.iterdir()} == names | {OWN_FILES}
    told = said(capsys)
    assert told["files"] == {name: (out / name).stat().st_size for name in names}
    assert told["out"] == str(out)
    assert (told["betas_space"], told["sub_frames"], told["meshes"]) == ("hfb", 16, 0)
    assert (result / "texture.png").read_bytes() in (out / "motion.glb").read_bytes()


def test_a_rate_for_the_slow_motion(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At the sub-frames' own rate it is no slower than the true time. An older motion's image is guessed from its K."""
    words = ["export", str(result), "--formats", "glb", "--json"]
    assert main([*words, "--fps", "350"]) == 0
    glb = (result / "export" / "motion.glb").read_bytes()
    document = json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])
    assert [one["name"] for one in document["animations"]] == ["slow motion 1x", "true time"]
    assert document["cameras"][0]["extras"]["size_px"] == [640, 480]
    assert "background" not in document["cameras"][0]["extras"]
    assert main([*words, "--fps", "0"]) == 2
    assert "fps" in said(capsys)["error"]


def test_a_motion_file_and_meshes_on_request(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "other"
    words = [
        "export",
        str(result / "motion.npz"),
        "--out",
        str(out),
        "--formats",
        "ply,trc,amass",
        "--amass-rate",
        "30",
    ]
    assert main(words) == 0
    assert {path.name for path in out.iterdir()} == {"joints.trc", "amass.npz", "meshes", OWN_FILES}
    assert len(list((out / "meshes").glob("frame_000[01]_sub_0[0-7].ply"))) == 16
    with np.load(out / "amass.npz") as amass:
        assert float(amass["mocap_framerate"]) == 30
    assert "meshes/" in capsys.readouterr().out


def test_the_world_of_exports(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A result without a world is exported as of a level camera, which is said; options and clip.toml tell it."""
    words = ["export", str(result), "--formats", "csv", "--csv-frame", "world", "--json"]
    assert main(words) == 0
    shown = capsys.readouterr()
    assert "the camera is taken as level in exports: give --camera.tilt-deg" in shown.err
    assert json.loads(shown.out.splitlines()[-1])["world"]["source"] == "level"
    assert main([*words, "--camera.tilt-deg", "40"]) == 0
    shown = capsys.readouterr()
    assert "level" not in shown.err
    told = json.loads(shown.out.splitlines()[-1])["world"]
    assert (told["source"], told["tilt_deg"]) == ("options", 40)

    clip = tmp_path / "clip.toml"
    clip.write_text("[camera]\nrotation = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]\ntranslation = [0, 1.5, 0]\n")
    assert main([*words, "--clip", str(clip)]) == 0
    assert said(capsys)["world"]["source"] == "calibration"
    row = (result / "export" / "joints.csv").read_text().splitlines()[1].split(",")
    x, y, z = MOTION.joints[0, 0]
    np.testing.assert_allclose([float(cell) for cell in row[3:6]], [x, z, 1.5 - y], atol=1e-6)
    assert main([*words, "--clip", str(clip), "--camera.world-up=-y"]) == 0
    assert said(capsys)["world"]["up"] == "-y"
    assert main([*words, "--clip", str(clip), "--floor", "0,0,1,-9"]) == 0
    shown = capsys.readouterr()
    assert "above the floor that is given: check the height in --camera.floor" in shown.err
    told = json.loads(shown.out.splitlines()[-1])["world"]
    assert (told["source"], told["floor"]) == ("calibration", "plane")
    assert main([*words, "--floor", "estimate"]) == 0
    assert "height 0 is told by the feet" in capsys.readouterr().err
    head, *rows = (line.split(",") for line in (result / "export" / "joints.csv").read_text().splitlines())
    assert head[-4:] == ["left_foot_stands", "right_foot_stands", "left_foot_sole_m", "right_foot_sole_m"]
    assert min(abs(float(cell)) for row in rows for cell in row[-2:]) < 0.05
    for bad in ("wall", "0,0,1", "0,0,0,1", "0,0,nan,1", "0,0,1,1e4"):
        assert main([*words, f"--floor={bad}"]) == 2
        assert "must be estimate, or a plane's normal and height [m] as four numbers" in said(capsys)["error"]
    assert main([*words, "--world-up=-y"]) == 2
    assert "--clip" in said(capsys)["error"]
    assert main([*words, "--tilt-deg", "91"]) == 2
    assert "tilt_deg" in said(capsys)["error"]


def test_what_hfb_did_not_write_is_not_replaced(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor what was changed since; one file in the way and none is written. What hfb wrote gives way to the new."""
    out = tmp_path / "mine"
    out.mkdir()
    (out / "motion.bvh").write_text("mine")
    words = ["export", str(result), "--out", str(out), "--formats", "bvh,csv", "--json"]
    assert main(words) == 2
    assert f"{out} holds motion.bvh, which is not as hfb wrote it there" in said(capsys)["error"]
    assert {path.name: path.read_text() for path in out.iterdir()} == {"motion.bvh": "mine"}
    assert main([*words[:5], "csv", "--json"]) == 0  # beside it there is room

    (out / "motion.bvh").unlink()
    assert main(words) == 0
    first = (out / "motion.bvh").read_bytes()
    save_motion(result / "motion.npz", motion_of(load_default_body(torch.float64), frames=1), "hfb")
    assert main(words) == 0
    second = (out / "motion.bvh").read_bytes()
    assert second != first
    (out / "joints.csv").write_text("edited")
    capsys.readouterr()
    assert main(words) == 2
    assert "joints.csv" in said(capsys)["error"]
    assert (out / "motion.bvh").read_bytes() == second


@pytest.mark.parametrize("kind", ["link", "folder", "pipe", "dangling"])
def test_what_is_no_file_is_not_replaced(
    kind: str, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, place = tmp_path / "mine", tmp_path / "mine" / "joints.csv"
    out.mkdir()
    (tmp_path / "elsewhere").write_text("mine")
    match kind:
        case "link":
            place.symlink_to(tmp_path / "elsewhere")
        case "dangling":
            place.symlink_to(tmp_path / "nowhere")
        case "folder":
            place.mkdir()
        case _:
            os.mkfifo(place)
    assert main(["export", str(result), "--out", str(out), "--formats", "csv", "--json"]) == 2
    assert "joints.csv" in said(capsys)["error"]
    assert (tmp_path / "elsewhere").read_text() == "mine"
    assert [path.name for path in out.iterdir()] == ["joints.csv"]


@pytest.mark.parametrize("content", ["[]", "{", '{"sha256": 3}', '{"sha256": {"joints.csv": 4}}'])
def test_a_damaged_record_of_what_hfb_wrote(
    content: str, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine"
    out.mkdir()
    (out / OWN_FILES).write_text(content)
    assert main(["export", str(result), "--out", str(out), "--formats", "csv", "--json"]) == 2
    assert f"{OWN_FILES} is damaged: remove it" in said(capsys)["error"]
    assert (out / OWN_FILES).read_text() == content


def test_what_a_killed_export_left_is_hfbs(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    words = ["export", str(result), "--out", str(out), "--formats", "bvh,csv", "--json"]
    assert main(words) == 0
    save_motion(result / "motion.npz", motion_of(load_default_body(torch.float64), frames=1), "hfb")
    written: list[str] = []

    def killed(path: Path, data: bytes) -> None:
        if len(written) == 2:
            raise KeyboardInterrupt
        written.append(path.name)
        write_bytes_atomic(path, data)

    with monkeypatch.context() as patched:
        patched.setattr("hfb.tasks.results.own_files.write_bytes_atomic", killed)
        assert main(words) != 0
    assert written == [OWN_FILES, "motion.bvh"]
    assert main(words) == 0


@pytest.mark.parametrize("trouble", ["a folder of others", "a full disk"])
def test_a_disk_that_takes_nothing_is_a_sentence(trouble: str, result: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / ".hfb-part").mkdir(parents=True)
    as_user = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search"] if os.getuid() == 0 else []
    if as_user and shutil.which("setpriv") is None:
        pytest.skip("root may write everywhere")
    if trouble == "a folder of others":
        (out / ".hfb-part").chmod(0o555)
    elif subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16k", "tmpfs", str(out)], capture_output=True).returncode:
        pytest.skip("no disk can be mounted here")
    command = [*as_user, sys.executable, "-m", "hfb.flows.cli.cli", "export", str(result), "--out", str(out)]
    try:
        done = subprocess.run([*command, "--formats", "bvh,csv"], capture_output=True, text=True)
        assert not [path for path in out.rglob("*") if path.is_file() and path.name != OWN_FILES]
    finally:
        subprocess.run(["umount", "--lazy", str(out)], capture_output=True)
    assert done.returncode == 1, done.stderr
    sentence = done.stderr.splitlines()[-1]
    assert ("free some space" if trouble == "a full disk" else "see to whose it is") in sentence
    assert "unexpected" not in sentence


def test_a_page_in_a_folder_of_the_users(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mine"
    out.mkdir()
    (out / "report.html").write_text("mine")
    words = ["report", str(result), "--out", str(out), "--json"]
    assert main(words) == 2
    assert "report.html" in said(capsys)["error"]
    assert (out / "report.html").read_text() == "mine"
    (out / "report.html").unlink()
    assert main(words) == main(words) == 0


@pytest.mark.parametrize("form", ["obj", "ply"])
def test_meshes_of_a_longer_result_do_not_stay(form: str, result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words, meshes = ["export", str(result), "--formats", form, "--json"], result / "export" / "meshes"
    assert main(words) == 0
    other = "ply" if form == "obj" else "obj"
    for name in (f"frame_0001_sub_00.{other}", f"frame_of_mine.{form}"):
        (meshes / name).write_text("mine")
    kept = motion_of(load_default_body(torch.float64), frames=1)
    save_motion(result / "motion.npz", kept, "hfb")
    assert main(words) == 0
    assert len(list(meshes.glob(f"frame_*_sub_*.{form}"))) == len(kept.poses) == said(capsys)["meshes"]
    assert {path.read_text() for path in (meshes / f"frame_0001_sub_00.{other}", meshes / f"frame_of_mine.{form}")} == {
        "mine"
    }
    (meshes / f"frame_0002_sub_00.{form}").write_text("mine")
    before = {path: path.stat().st_mtime_ns for path in result.rglob("*")}
    assert main(words) == 2
    assert f"frame_0002_sub_00.{form} is not from this version of hfb: move it away" in said(capsys)["error"]
    assert {path: path.stat().st_mtime_ns for path in result.rglob("*")} == before


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["nowhere/motion.npz"], "there is no nowhere/motion.npz"),
        (["{result}", "--formats", "stl"], "'stl' is no format: take some of amass"),
        (["{result}", "--films", "sepia"], "'sepia' is no film: take some of slowmotion, exact, overlay"),
        (["{result}", "--films", "exact"], "has no result.json"),
        (["{result}/texture.png"], "not a motion file"),
        (["{result}", "--body", "{result}/texture.png"], "texture.png"),
    ],
)
def test_what_cannot_be_used(words: list[str], sentence: str, result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = result.parent / "none"
    assert main(["export", *(word.format(result=result) for word in words), "--out", str(out), "--json"]) == 2
    assert sentence in said(capsys)["error"]
    assert not out.exists()


def test_a_surface_needs_the_body_that_was_fitted(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motion, _ = load_motion(result / "motion.npz")
    save_motion(result / "motion.npz", motion, "smpl")
    assert main(["export", str(result), "--formats", "glb", "--json"]) == 2
    assert "--body" in said(capsys)["error"]
    assert main(["export", str(result), "--formats", "bvh,amass,trc,csv", "--json"]) == 0
    save_motion(result / "motion.npz", replace(motion, joints=1.1 * motion.joints), "hfb")
    assert main(["export", str(result), "--formats", "glb", "--json"]) == 2
    assert "not the body that was fitted" in said(capsys)["error"]
