"""A motion with a frame rate of its own plays at its own speed, whatever the video's."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hfb.errors import InputError
from hfb.interop.readers.pose_track import load_track, save_track
from hfb.interop.readers.sniff import read_tracks
from hfb.tasks.video import video_clip
from hfb.tasks.video.external_poses import GivenBodyCall, ResultHandle, body_of_result, find_given_body


def amass(path: Path, **rate: Any) -> Path:
    np.savez(path, poses=np.zeros((6, 156)), trans=np.zeros((6, 3)), **rate)
    return path


@pytest.mark.parametrize("name", ["mocap_framerate", "mocap_frame_rate", "fps"])
def test_the_rate_is_kept(tmp_path: Path, name: str) -> None:
    (track,) = read_tracks([amass(tmp_path / "a.npz", **{name: 120})], 480, 640)
    assert track.rate_hz == 120
    assert track.rows(np.array([1])).rate_hz == 120
    save_track(tmp_path / "track.npz", track)
    assert load_track(tmp_path / "track.npz").rate_hz == 120
    assert read_tracks([tmp_path / "track.npz"], 480, 640)[0].rate_hz == 120
    with pytest.raises(InputError, match=f"its {name} is 0; give its frames per second"):
        read_tracks([amass(tmp_path / "b.npz", **{name: 0})], 480, 640)


def test_a_video_s_frame_is_the_row_of_its_time() -> None:
    handle = ResultHandle(path=Path("x"), sha256="0", system="AMASS", frames=(0, 1), rate_hz=120)
    assert handle.number_in_clip(7, None, began=0, average=1, video_hz=30) == 28
    assert handle.number_in_clip(7, None, began=10, average=1, video_hz=25) == 82  # 81.6
    assert handle.number_in_clip(2, None, began=10, average=3, video_hz=240) == 8  # frame 17
    assert handle.number_in_clip(7, 5, began=10, average=1, video_hz=30) == 33  # row 5 is the first frame
    assert handle.number_in_clip(7, None, began=10, average=1) == 17


def test_a_clip_asks_for_that_row(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    footage = SimpleNamespace(first=4, average=2, interval_s=2 / 60)  # 60 frames per second in pairs
    monkeypatch.setattr(video_clip, "load_footage", lambda handle: footage)
    monkeypatch.setattr(body_of_result, "fn", lambda number, **_: asked.append(number))
    for rate_hz in (None, 120.0):
        handle: Any = ResultHandle(path=Path("x"), sha256="0", system="AMASS", frames=(0,), rate_hz=rate_hz)
        unused = dict.fromkeys(("footage", "still", "matte", "first", "body"))
        find_given_body.fn(GivenBodyCall.model_construct(**unused, number=3, result=handle, folder=Path("x")))
    assert asked == [11, 22]
