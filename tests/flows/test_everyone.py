"""Several people in one clip: each followed on their own, each with a run and a folder of their own."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.errors import InputError
from hfb.flows.everyone import everyone_in, run_clip
from hfb.motion.motion_file import load_motion
from hfb.tasks.inputs.video_inputs import take_video_inputs
from tests.orchestration import mlflow_rows
from tests.small_clips import small_clip, small_config

_FRAMES = 3


def test_everyone_is_followed(store: Path, tmp_path: Path) -> None:
    source = _two_people(tmp_path / "clip")
    config = small_config()
    inputs = take_video_inputs(source, config, everyone=True)
    result = run_clip(inputs, tmp_path / "out", config, 2)
    assert json.loads((tmp_path / "out" / "result.json").read_text()) == result
    assert [one["error"] for one in result["people"]] == [None, None]
    assert result["frames"] == _FRAMES
    places = []
    for number in (1, 2):
        motion, _ = load_motion(tmp_path / "out" / f"person-{number}" / "motion.npz")
        assert len(motion.poses) == 3 * _FRAMES
        assert result["people"][number - 1]["matte_iou"] > 0.4
        places.append(float(np.mean(motion.trans[:, 0])))
    assert abs(places[0] - places[1]) > 0.5  # one in the left half, one in the right
    assert mlflow_rows(store, "select count(*) from runs where status = 'FINISHED'") == [(2,)]


def test_one_height_is_not_everyone_s(tmp_path: Path) -> None:
    source = _two_people(tmp_path / "clip")
    config = small_config().model_copy(update={"fit": small_config().fit.model_copy(update={"height_m": 1.8})})
    with pytest.raises(InputError, match=r"--fit.height-m is one person's height"):
        run_clip(take_video_inputs(source, config, everyone=True), tmp_path / "out", config, 1)
    assert not (tmp_path / "out").exists()
    (tmp_path / "clip.toml").write_text("[person]\nheight_m = 1.8\n")
    with pytest.raises(InputError, match=r"clip.toml: height_m is one person's"):
        take_video_inputs(source, small_config(), tmp_path / "clip.toml", everyone=True)


def test_tracks_of_another_system_are_everyone(store: Path, tmp_path: Path) -> None:
    source = _two_people(tmp_path / "clip")
    rows = [
        f"{frame},{name},{left},0,{left + 128},96" for frame in range(_FRAMES) for name, left in (("b", 0), ("a", 128))
    ]
    (tmp_path / "tracks.csv").write_text("\n".join(["frame,id,left,top,right,bottom", *rows, "99,c,0,0,9,9"]))
    (tmp_path / "clip.toml").write_text('[person]\nwhich = "everyone"\ntrack = "tracks.csv"\n')
    config = small_config()
    people = everyone_in(take_video_inputs(source, config, tmp_path / "clip.toml"), tmp_path / "out", config)
    assert [(one.name, one.choice.id, one.frames) for one in people] == [("track a", "a", 3), ("track b", "b", 3)]


def _two_people(folder: Path) -> Path:
    """A small clip and, beside it, its mirror image."""
    made = small_clip(_FRAMES)
    (folder / "frames").mkdir(parents=True)
    for path in (*sorted(made.source.iterdir()), made.background):
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        both = np.concatenate([picture, picture[:, ::-1]], 1)
        where = folder / "background.png" if path == made.background else folder / "frames" / path.name
        assert cv2.imwrite(str(where), both)
    return folder / "frames"
