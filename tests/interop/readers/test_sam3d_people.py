"""SAM 3D Body's frames and people: numbers as they are written, people by where they stand."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hfb.errors import InputError
from hfb.interop.readers.pose_track import PoseTrack
from hfb.interop.readers.sniff import read_tracks
from tests.interop.readers import files
from tests.interop.readers.files import HEIGHT, WIDTH, Person


@pytest.fixture(scope="module")
def someone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return files.sam3d(tmp_path_factory.mktemp("sam"), Person.some()).content[0][0]  # type: ignore[no-any-return]


def at(one: dict[str, Any], x: float, z: float = 4.0) -> dict[str, Any]:
    """The same person elsewhere [m]."""
    return {**one, "pred_cam_t": np.array([x, 0.3, z]), "pred_keypoints_2d": None}


def read(folder: Path, content: Any) -> tuple[PoseTrack, ...]:
    (folder / "people.pkl").write_bytes(pickle.dumps(content))
    return read_tracks([folder / "people.pkl"], HEIGHT, WIDTH)


@pytest.mark.parametrize(
    ("keys", "frames"),
    [
        ([10, 14], [10, 14]),
        ([14, 10], [10, 14]),
        (["10", "14"], [10, 14]),
        (["out2/000010.jpg", "out2/000014.jpg"], [10, 14]),
        (["10_left.png", "14_left.png"], [10, 14]),
        (["a.jpg", "b.jpg"], [0, 1]),
        (["cam1/3.jpg", "cam2/3.jpg"], [0, 1]),
        ([10], [10]),
        (["000010.jpg"], [10]),
    ],
)
def test_frames_have_their_own_numbers(
    tmp_path: Path, someone: dict[str, Any], keys: list[Any], frames: list[int]
) -> None:
    (track,) = read(tmp_path, {key: [at(someone, 0)] for key in keys})
    assert track.frames.tolist() == frames
    (track,) = read(tmp_path, {key: at(someone, 0) for key in keys})
    assert track.frames.tolist() == frames


def test_lists(tmp_path: Path, someone: dict[str, Any]) -> None:
    (track,) = read(tmp_path, [[], [at(someone, 0)], [], [at(someone, 0)]])
    assert track.frames.tolist() == [1, 3]
    one_picture = read(tmp_path, [at(someone, 0), at(someone, 0.1)])  # what the system's own call returns
    assert [track.frames.tolist() for track in one_picture] == [[0], [0]]


def test_another_order_of_detections_swaps_nobody(tmp_path: Path, someone: dict[str, Any]) -> None:
    left, right = [-1 + 0.2 * n for n in range(5)], [1 - 0.1 * n for n in range(5)]
    frames = [[at(someone, left[n]), at(someone, right[n])][:: -1 if n % 2 else 1] for n in range(5)]
    found = read(tmp_path, frames)
    assert [track.person for track in found] == ["0", "1"]
    for track, places in zip(found, (left, right), strict=True):
        assert track.joints is not None
        np.testing.assert_allclose(np.diff(track.joints[:, 0, 0]), np.diff(places), atol=1e-6)


def test_who_comes_is_new_and_who_returns_is_known(tmp_path: Path, someone: dict[str, Any]) -> None:
    frames = [
        [at(someone, -1), at(someone, 1)],
        [at(someone, 1)],
        [at(someone, 1), at(someone, 0, 9.0)],
        [at(someone, 0, 9.0), at(someone, -1.2), at(someone, 1)],
    ]
    found = {track.person: track for track in read(tmp_path, frames)}
    assert {name: track.frames.tolist() for name, track in found.items()} == {
        "0": [0, 3],
        "1": [0, 1, 2, 3],
        "2": [2, 3],
    }
    assert found["2"].joints is not None
    assert float(found["2"].joints[:, 0, 2].min()) > 8


def test_crowds_are_bounded(tmp_path: Path, someone: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="more than 128 people in a frame"):
        read(tmp_path, [[at(someone, 0)], [at(someone, 0)] * 129])
