"""What a folder of videos yields: windows, what belongs to a video, refusals, and the order of choice."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.datasets.real.case_windows import RealWindow, choose, place_names, real_windows
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.real.source_videos import find_footage, open_footage
from hfb.datasets.real.video_assets import Recording, find_plate, find_recording
from hfb.errors import InputError
from hfb.io.media.images.image_io import write_png
from tests.datasets.real.videos import BODY, FPS, calibration_toml, figure, joints_m, room, write_recording, write_trc
from tests.datasets.real.videos import write_video as write
from tests.io.media.test_capture_rate import tagged
from tests.io.media.test_interlacing import woven
from tests.io.media.videos import write_video as write_coded


def _picture(levels: np.ndarray) -> np.ndarray:
    return (levels / np.float32(255)).astype(np.float32)


def test_every_stretch_of_the_video_is_a_window(tmp_path: Path) -> None:
    write_recording(tmp_path / "deep" / "er", count=20)
    windows, refused = real_windows(RealSpec(videos=tmp_path, average=5, frames=2))
    assert refused == {}
    assert [window.first for window in windows] == list(range(11))
    recording = windows[0].recording
    assert recording.plate == tmp_path / "deep" / "er" / "cam01_plate.png"
    assert recording.calibration == tmp_path / "deep" / "er" / "Calib.toml"
    assert recording.joints == tmp_path / "deep" / "er" / "walk.trc"
    assert (recording.shift, recording.y_up) == (0, False)


def test_a_trc_with_y_up_is_turned(tmp_path: Path) -> None:
    write_recording(tmp_path, count=12)
    write_trc(tmp_path / "walk.trc", np.stack([joints_m(i) for i in range(12)])[..., [1, 2, 0]], BODY, FPS)
    windows, _ = real_windows(RealSpec(videos=tmp_path, average=5))
    assert windows[0].recording.y_up
    markers = windows[0].recording.markers()
    assert markers is not None
    np.testing.assert_allclose(markers.xyz_m[3], joints_m(3), atol=1e-9)


@pytest.mark.parametrize("late", [-1, 1, 2])
def test_joints_that_are_some_frames_off_are_brought_together(tmp_path: Path, late: int) -> None:
    write_recording(tmp_path, count=24, rows_late=late)
    windows, _ = real_windows(RealSpec(videos=tmp_path, average=5))
    recording = windows[0].recording
    assert recording.shift == -late
    assert any("frames off" in remark for remark in windows[0].remarks)
    markers = recording.markers()
    assert markers is not None
    np.testing.assert_allclose(markers.rows(recording.row_of(9), 1)[0], joints_m(9), atol=1e-9)


def test_gaps_in_the_joints_are_no_windows(tmp_path: Path) -> None:
    write_recording(tmp_path, count=20)
    points = np.stack([joints_m(index) for index in range(20)])
    points[8] = np.nan
    write_trc(tmp_path / "walk.trc", points, BODY, FPS)
    windows, _ = real_windows(RealSpec(videos=tmp_path, average=5))
    assert [window.first for window in windows] == [0, 1, 2, 3, *range(9, 16)]


def test_what_cannot_be_used_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    write_recording(tmp_path / "good", count=12)
    (tmp_path / "text.mp4").write_bytes(b"no video" * 50)
    (tmp_path / "empty.mov").write_bytes(b"")
    for name in ("plate", "joints", "rate", "toml", "short", "camera", "size"):
        write_recording(tmp_path / name, count=12)
    write_png(tmp_path / "plate" / "cam01_plate.png", _picture(room()[:64]))
    write_trc(tmp_path / "joints" / "walk.trc", np.stack([joints_m(i) - (1.3, 0, 0) for i in range(12)]), BODY, FPS)
    write_trc(tmp_path / "rate" / "walk.trc", np.stack([joints_m(i) for i in range(12)]), BODY, 30)
    (tmp_path / "toml" / "Calib.toml").write_text("[cam01]\nsize = 3\n")
    write(tmp_path / "short" / "cam01_walk.mp4", [figure(0), figure(1)])
    rng = np.random.default_rng(0)
    wide = cv2.resize(rng.integers(0, 255, (32, 64, 3)).astype(np.uint8), (400, 192), interpolation=cv2.INTER_CUBIC)
    for name in ("cam01_plate.png", "walk.trc"):
        (tmp_path / "camera" / name).unlink()
    write(tmp_path / "camera" / "cam01_walk.mp4", [wide[:, 9 * i : 9 * i + 160] for i in range(12)])
    text = calibration_toml().replace("160.0, 192.0", "192.0, 160.0")
    (tmp_path / "size" / "Calib.toml").write_text(text)
    windows, refused = real_windows(RealSpec(videos=tmp_path, average=5))
    assert {window.recording.video.parent.name for window in windows} == {"good"}
    for name, says in {
        "text.mp4": "video",
        "empty.mov": "video",
        "plate/cam01_walk.mp4": "same size",
        "rate/cam01_walk.mp4": "rate",
        "joints/cam01_walk.mp4": "of its joints fall on the person",
        "toml/cam01_walk.mp4": "camera cam01",
        "short/cam01_walk.mp4": "has 2 frames",
        "camera/cam01_walk.mp4": "camera moves",
        "size/cam01_walk.mp4": "192 x 160",
    }.items():
        assert says in refused[name], refused[name]
    assert len(refused) == 9


def test_interlaced_videos_are_refused_as_by_hfb_video(tmp_path: Path) -> None:
    """Unless clip.toml says that their frames are whole pictures; what only looks interlaced is told."""
    for name in ("flagged", "whole"):
        (tmp_path / name).mkdir()
        write_coded(tmp_path / name / "walk.mp4", woven(8), options={"x264-params": "tff=1"})
    (tmp_path / "whole" / "clip.toml").write_text('scan = "progressive"\n')
    write_coded(tmp_path / "combed.mp4", woven(12))
    found, refused = find_footage(tmp_path)
    assert list(refused) == ["flagged/walk.mp4"]
    assert "is interlaced" in refused["flagged/walk.mp4"]
    assert "bwdif=mode=send_field" in refused["flagged/walk.mp4"]
    told = {footage.path.parent.name: footage.remarks for footage in found}
    assert told["whole"] == ()
    (remark,) = told[tmp_path.name]
    assert "combed.mp4 seems to be interlaced" in remark
    assert find_recording(found[0])[1] == [remark]


@pytest.mark.parametrize(("told", "fps"), [("", 240.0), ("[exposure]\nfps = 60\n", 60.0)])
def test_slow_motion_has_the_rate_of_its_capture(tmp_path: Path, told: str, fps: float) -> None:
    tagged(tmp_path / "slow.mp4", "com.android.capture.fps", "240.0")
    if told:
        (tmp_path / "slow_clip.toml").write_text(told)
    (footage,), refused = find_footage(tmp_path)
    assert refused == {}
    assert footage.fps == fps == open_footage(tmp_path / "slow.mp4").fps
    remarks = find_recording(footage)[1]
    assert [("captured at 240 frames per second" in one) for one in remarks] == ([] if told else [True])


def test_folders_without_video(tmp_path: Path) -> None:
    for folder, says in ((tmp_path / "missing", "no folder"), (tmp_path, "no video")):
        with pytest.raises(InputError, match=says):
            real_windows(RealSpec(videos=folder))


def test_numbered_pictures_are_a_video(tmp_path: Path) -> None:
    for index in range(9):
        write_png(tmp_path / f"f{index + 8}.png", _picture(figure(index)))  # f8 .. f16: by number, not by letters
    write_png(tmp_path / "plate.png", _picture(room()))
    (tmp_path / "clip.toml").write_text("[camera]\nfocal_px = 300\n[exposure]\nfps = 20\n")
    (footage,), refused = find_footage(tmp_path)
    assert refused == {}
    assert (footage.count, footage.fps, footage.fps_known) == (9, 20, True)
    assert footage.pictures[0].name == "f8.png"
    assert find_plate(footage) == tmp_path / "plate.png"
    shown = list(footage.stored_frames(2, 4))
    np.testing.assert_allclose(shown[1] * 255, figure(3), atol=0.01)
    assert open_footage(footage.path).pictures == footage.pictures
    (tmp_path / "f11.png").unlink()
    write_png(tmp_path / "f17.png", _picture(figure(9)))
    found, refused = find_footage(tmp_path)
    assert found == []
    assert "follows number 10" in refused["f8.png"]


def test_the_longest_plate_name_that_fits_wins(tmp_path: Path) -> None:
    write(tmp_path / "cam01_f000-059.mp4", [figure(0), figure(1)])
    footage = open_footage(tmp_path / "cam01_f000-059.mp4")
    assert find_plate(footage) is None
    for name in ("plate.png", "c_plate.png", "cam01_plate.png", "cam02_plate.png"):
        write_png(tmp_path / name, _picture(room()))
    assert find_plate(footage) == tmp_path / "cam01_plate.png"


def test_joints_without_a_camera_are_left_with_a_remark(tmp_path: Path) -> None:
    write_recording(tmp_path, count=12)
    (tmp_path / "Calib.toml").unlink()
    recording, remarks = find_recording(open_footage(tmp_path / "cam01_walk.mp4"))
    assert recording.joints is None
    assert "no calibration names the camera" in remarks[0]


def test_joints_in_a_c3d_are_told(tmp_path: Path) -> None:
    write_recording(tmp_path, count=12)
    (tmp_path / "walk.trc").rename(tmp_path / "walk.c3d")
    recording, remarks = find_recording(open_footage(tmp_path / "cam01_walk.mp4"))
    assert recording.joints is None
    assert "walk.c3d is not read: export it as .trc" in remarks


def test_without_a_plate_the_median_stands_in(tmp_path: Path) -> None:
    write(tmp_path / "walk.mp4", [figure(index) for index in range(0, 48, 3)])
    plate = Recording(tmp_path / "walk.mp4").stored_plate()
    away = np.abs(plate - _picture(room())).max(-1) > 0.02
    assert away.mean() < 0.02


def _windows(counts: dict[str, int]) -> list[RealWindow]:
    return [RealWindow(Recording(Path(name)), first, 5) for name, count in counts.items() for first in range(count)]


def test_a_choice_is_spread_repeatable_and_begins_with_the_shorter_one() -> None:
    windows = _windows({"a": 100, "b": 37, "c": 1})
    everything = choose(windows, 1000, 3)
    assert sorted(map(str, everything)) == sorted(map(str, windows))
    for count in (0, 1, 7, 50):
        assert choose(windows, count, 3) == everything[:count]
    assert choose(windows, 20, 3) != choose(windows, 20, 4)
    first = choose(windows, 17, 3)
    per_video = {name: sorted(w.first for w in first if w.recording.video == Path(name)) for name in "abc"}
    assert [len(per_video[name]) for name in "abc"] == [8, 8, 1]
    gaps = np.diff([*per_video["a"], per_video["a"][0] + 100])
    assert 12 <= gaps.min() <= gaps.max() <= 13


def test_several_folders_and_exposures(tmp_path: Path) -> None:
    """Each video once, however often its folder is given; what is too short for one K serves the others."""
    write_recording(tmp_path / "gym", count=14)
    write_recording(tmp_path / "park" / "day", count=6)
    (tmp_path / "park" / "text.mp4").write_bytes(b"no video" * 50)
    folders = (tmp_path / "gym", tmp_path / "park", tmp_path / "park" / "day")
    windows, refused = real_windows(RealSpec(set="real", videos=folders, average=(1, 9), frames=1))
    found = {(window.place, window.video, window.average) for window in windows}
    assert found == {
        ("gym", "gym/cam01_walk.mp4", 1),
        ("gym", "gym/cam01_walk.mp4", 9),
        ("day", "day/cam01_walk.mp4", 1),
    }
    assert len(windows) == 14 + 6 + 6
    short = f"{(tmp_path / 'park').as_posix()}/day/cam01_walk.mp4 (K = 9)"
    assert set(refused) == {short, f"{(tmp_path / 'park').as_posix()}/text.mp4"}
    assert "has 6 frames and a case needs 9" in refused[short]


def test_a_recording_without_measured_joints_is_marked(tmp_path: Path) -> None:
    write_recording(tmp_path / "gym", count=12)
    (tmp_path / "gym" / "walk.trc").unlink()
    spec = RealSpec(set="real", videos=tmp_path / "gym", average=5)
    assert {(window.place, window.video) for window in real_windows(spec)[0]} == {
        ("gym (pseudo truth)", "gym/cam01_walk.mp4 (pseudo truth)")
    }


def test_an_empty_folder_among_several_is_told(tmp_path: Path) -> None:
    write_recording(tmp_path / "gym", count=12)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty holds no video"):
        real_windows(RealSpec(set="real", videos=(tmp_path / "gym", tmp_path / "empty")))


def test_places_have_the_shortest_names_that_differ() -> None:
    folders = [Path("/a/one/walk"), Path("/b/one/walk"), Path("/b/squat"), Path("/b/squat")]
    assert list(place_names(folders).values()) == ["a/one/walk", "b/one/walk", "squat"]


def test_a_choice_takes_turns_over_videos_and_exposures() -> None:
    """Every beginning is as even as its length allows, over pairs, over videos and over K."""
    averages = (1, 5, 9)
    windows = [
        RealWindow(Recording(Path(name)), first, average)
        for name in "abcd"
        for average in averages
        for first in range(30)
    ]
    order = choose(windows, 1000, 7)
    assert sorted(map(str, order)) == sorted(map(str, windows))
    for count in (3, 4, 6, 12, 24, 60):
        some = choose(windows, count, 7)
        assert some == order[:count]
        for dealt, kinds in (([w.recording.video for w in some], 4), ([w.average for w in some], 3)):
            counts = [dealt.count(one) for one in set(dealt)] + [0] * (kinds - len(set(dealt)))
            assert max(counts) - min(counts) <= 1
        pairs = [(w.recording.video, w.average) for w in some]
        assert max(pairs.count(one) for one in set(pairs)) == -(-count // 12)
    assert choose(windows, 12, 8) != order[:12]
