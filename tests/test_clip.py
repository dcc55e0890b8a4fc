"""clip.toml: what may stand in it, and what a mistake says."""

from pathlib import Path

import pytest

from hfb.errors import InputError
from hfb.io.clip import Clip, read_clip


def write(folder: Path, text: str) -> Path:
    path = folder / "clip.toml"
    path.write_text(text)
    return path


def test_everything_may_be_left_out(tmp_path: Path) -> None:
    assert read_clip(write(tmp_path, "")) == Clip()
    assert Clip().exposure.exposure_s(0.04) is None


@pytest.mark.parametrize(
    ("line", "exposure_s"), [("seconds = 0.01", 0.01), ("shutter_fraction = 0.5", 0.02), ("shutter_angle = 90", 0.01)]
)
def test_three_ways_to_say_how_long(tmp_path: Path, line: str, exposure_s: float) -> None:
    clip = read_clip(write(tmp_path, f"[exposure]\nfps = 25\n{line}"))
    assert clip.exposure.fps == 25
    assert clip.exposure.exposure_s(1 / 25) == pytest.approx(exposure_s)


def test_calibration(tmp_path: Path) -> None:
    clip = read_clip(write(tmp_path, 'transfer = "linear"\n[camera]\nK = [[800, 0, 320], [0, 810, 240], [0, 0, 1]]'))
    assert clip.transfer == "linear"
    assert clip.camera.K == ((800, 0, 320), (0, 810, 240), (0, 0, 1))


def test_everything_about_a_video(tmp_path: Path) -> None:
    text = """
    transfer = "bt709"
    video = "walk.mp4"
    start_s = 1.5
    stop = 90
    background = "plate.png"
    [camera]
    calibration = "Calib.toml"
    name = "cam01"
    [exposure]
    auto = true
    position = "middle"
    [person]
    track = "tracks.csv"
    id = 3
    """
    clip = read_clip(write(tmp_path, text))
    assert clip.video == tmp_path / "walk.mp4"
    assert clip.background == str(tmp_path / "plate.png")
    assert clip.camera.calibration == tmp_path / "Calib.toml"
    assert clip.person.track == tmp_path / "tracks.csv"
    assert (clip.transfer, clip.start_s, clip.stop, clip.exposure.position) == ("bt709", 1.5, 90, "middle")
    assert read_clip(write(tmp_path, 'background = "median"')).background == "median"
    assert read_clip(write(tmp_path, "[person]\nheight_m = 1.82")).person.height_m == 1.82
    assert read_clip(write(tmp_path, "[person]\nbox = [1, 2, 3, 4]")).person.box == (1, 2, 3, 4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[camera]\nfocal = 3", "unknown option camera.focal; did you mean camera.focal_px"),
        ("exposure = 3", "exposure: "),
        ("[exposure]\nfps = -1", "exposure.fps: .* greater than 0"),
        ("[exposure]\nseconds = 0.1\nshutter_angle = 90", "one of seconds, shutter_fraction and shutter_angle"),
        ("[exposure]\nreadout_s = 12", "exposure.readout_s: .* between 0 and 1"),
        ('[exposure]\nreadout_to = "bottom"', "exposure.readout_to: .*down"),
        ("[camera]\nfocal_px = 1\nK = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "focal_px or K, not both"),
        ("[camera]\nK = [[1, 0, 0], [0, 1, 0], [0, 0, 2]]", "undistort"),
        ("[camera]\nK = [[1, 0], [0, 1]]", "camera.K"),
        ("[camera\n", "not valid TOML"),
        ('transfer = "log"', "transfer: "),
        ("start = 3\nstart_s = 0.1", "in frames .* or in seconds"),
        ("start = 3\nstop = 3", "the range is empty"),
        ("[exposure]\nauto = true\nseconds = 0.1", "auto and a length exclude each other"),
        ('[camera]\ncalibration = "a.toml"\nfocal_px = 3', "focal_px, K or a calibration file"),
        ('[camera]\nname = "cam01"', "give calibration too"),
        ("[person]\nid = 3", "give track too"),
        ("[person]\nbox = [3, 2, 1, 4]", "left < right"),
        ("[person]\nheight_m = 182", "person.height_m: .* less than or equal to 2.4"),
        ("[person]\nheight_m = 1.2", "person.height_m: .* greater than or equal to 1.4"),
        ('[person]\nwhich = "everyone"\nheight_m = 1.8', "height_m is one person's"),
        ('[person]\nbox = [1, 2, 3, 4]\ntrack = "a.csv"', "a box or a track, not both"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        read_clip(write(tmp_path, text))
    assert "clip.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_file_and_no_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_clip(tmp_path / "clip.toml")
    (tmp_path / "clip.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not text in UTF-8"):
        read_clip(tmp_path / "clip.toml")


@pytest.mark.parametrize(
    "entry",
    [
        'video = "../walk.mp4"',
        'video = "/etc/passwd"',
        'background = "../../plate.png"',
        'video = "link.mp4"',
        'video = "a\\u0000b"',
        '[camera]\ncalibration = "/etc/calib.toml"',
        '[person]\ntrack = "down/../../t.csv"',
        'video = "loop"',
    ],
)
def test_files_that_lie_elsewhere_are_refused(tmp_path: Path, entry: str) -> None:
    folder = tmp_path / "clip"
    folder.mkdir()
    (tmp_path / "walk.mp4").touch()
    (folder / "link.mp4").symlink_to(tmp_path / "walk.mp4")
    (folder / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="does not lie in its folder") as caught:
        read_clip(write(folder, entry))
    assert "\n" not in str(caught.value)


def test_links_that_stay_and_folders_below_are_fine(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "walk.mp4").touch()
    (tmp_path / "link.mp4").symlink_to(Path("below") / "walk.mp4")
    assert read_clip(write(tmp_path, 'video = "link.mp4"')).video == tmp_path / "link.mp4"
    assert read_clip(write(tmp_path, 'video = "below/walk.mp4"')).video == tmp_path / "below" / "walk.mp4"


@pytest.mark.parametrize("text", ["fps = inf", "fps = nan", "seconds = inf"])
def test_numbers_are_finite(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="finite number"):
        read_clip(write(tmp_path, f"[exposure]\n{text}"))
