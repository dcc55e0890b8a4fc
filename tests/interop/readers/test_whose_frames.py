"""Whose rows are whose, and which frames they are: marks, names of pictures, tracks in pieces."""

import json
import pickle
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest

from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.interop.readers.image_names import ClipPictures
from hfb.interop.readers.pose_track import PoseTrack
from hfb.interop.readers.sniff import choose_person, read_tracks
from tests.interop.readers import files
from tests.interop.readers.files import COUNT, HEIGHT, WIDTH, Person
from tests.interop.readers.test_keypoints import COCO, KNEE, as_coco, shown
from tests.shared import REPORTS


def read(folder: Path, content: Any, clip: ClipPictures = ClipPictures()) -> tuple[PoseTrack, ...]:  # noqa: B008
    path = folder / "result.json"
    path.write_text(json.dumps(content))
    return read_tracks([path], HEIGHT, WIDTH, clip)


def two_people(folder: Path, marks: Any, image: str = "{}.jpg", first: int = 0) -> list[dict[str, Any]]:
    """One person and another 250 px to the right; who of them comes first in a picture changes."""
    rows = []
    for number, pixels in enumerate(shown(folder)):
        people = []
        for person, away in ((1, 0.0), (2, 250.0)):
            points = as_coco(pixels) + [away, 0, 0]
            one = {"image_id": image.format(number + first), "score": 3 + (number % 2) * (1.5 - person)}
            people.append({**one, "keypoints": points.ravel().tolist(), **marks(person)})
        rows += people[:: 1 - 2 * (number % 2)]
    return rows


@pytest.mark.parametrize(
    "marks",
    [
        lambda person: {"idx": person},
        lambda person: {"idx": [person]},
        lambda person: {"idx": [[float(person)]]},
        lambda person: {"idx": float(person)},
        lambda person: {"idx": str(person)},
        lambda person: {},
        lambda person: {"idx": None},
        lambda person: {"track_id": person, "idx": 0},
        lambda person: {"idx": []},
        lambda person: {"track_id": -1, "idx": [person]},
        lambda person: {"idx": -1},
    ],
    ids=["int", "list", "nested", "float", "text", "absent", "null", "track_id", "empty", "no track", "-1"],
)
def test_a_person_stays_that_person(tmp_path: Path, marks: Any) -> None:
    tracks = read(tmp_path, two_people(tmp_path, marks))
    assert [len(track) for track in tracks] == [COUNT, COUNT]
    pixels = shown(tmp_path)[:, KNEE]
    places = sorted((track.pixels[:, KNEE] for track in tracks), key=lambda one: float(one[0, 0]))
    for place, away in zip(places, (0, 250), strict=True):
        np.testing.assert_allclose(place, pixels + [away, 0], atol=1e-3)


@pytest.mark.parametrize("name", ["alphapose_idx_list.json", "alphapose_idx_int.json"])
def test_alphapose_as_reported(name: str) -> None:
    if not (REPORTS / name).is_file():
        pytest.skip("the shared reports are not here")
    tracks = read_tracks([REPORTS / name], HEIGHT, WIDTH)
    assert len(tracks) == 2
    for track in tracks:
        assert np.ptp(np.nanmean(track.pixels[..., 0], 1)) < 100  # on one side of the picture


def frames_of(folder: Path, image: str, names: tuple[str, ...], first: int = 0, frames: int = 0) -> list[int]:
    rows = two_people(folder, lambda person: {"idx": person}, image, first)
    return read(folder, rows, ClipPictures(names, frames))[0].frames.tolist()


@pytest.mark.parametrize(
    ("image", "first", "names", "expected"),
    [
        ("{:06d}.png", 1, "{:06d}.png", range(5)),
        ("{:06d}.jpg", 1, "{:06d}.PNG", range(5)),
        ("/home/x/frames/img_{:04d}.jpeg", 1, "img_{:04d}.png", range(5)),
        ("{}.jpg", 1, "frame{:03d}.tif", range(5)),
        ("_{:012d}_keypoints.json", 1, "{:06d}.png", range(5)),
        ("walk_{:012d}_keypoints.json", 1, "walk_{:012d}.png", range(5)),
        ("{:06d}.png", 1, "IMG_{:d}.JPG", range(5)),
        ("{}.jpg", 0, "{:06d}.png", range(5)),
        ("{:06d}_vis.png", 3, "{:06d}.png", range(2, 7)),
    ],
)
def test_pictures_are_found_by_the_clips_own_names(
    tmp_path: Path, image: str, first: int, names: str, expected: range
) -> None:
    own = tuple(names.format(number) for number in range(0 if first == 0 else 1, 12))
    assert frames_of(tmp_path, image, own, first) == list(expected)


def test_files_that_are_not_numbered_from_one(tmp_path: Path) -> None:
    own = tuple(f"DSC{number:05d}.png" for number in range(817, 822))
    assert frames_of(tmp_path, "DSC{:05d}.jpg", own, 817) == list(range(COUNT))
    assert frames_of(tmp_path, "{:06d}.jpg", own, 1) == list(range(COUNT))  # renamed and counted from 1
    assert frames_of(tmp_path, "{:06d}.jpg", own, 0) == list(range(COUNT))


def test_pictures_out_of_a_video(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert frames_of(tmp_path, "{}.jpg", (), 0, COUNT) == list(range(COUNT))
    assert "from 1" not in caplog.text
    assert frames_of(tmp_path, "{:06d}.jpg", (), 1, COUNT) == list(range(COUNT))
    assert "numbered from 1 to 5" in caplog.text
    assert frames_of(tmp_path, "{:06d}.jpg", (), 1, COUNT + 3) == list(range(1, COUNT + 1))  # who knows


def test_pictures_that_the_clip_does_not_have_are_left_out(tmp_path: Path) -> None:
    assert frames_of(tmp_path, "{:06d}.png", ("000002.png", "000004.png")) == [0, 1]


def test_sam3d_by_names(tmp_path: Path) -> None:
    content = files.sam3d(tmp_path, Person.some()).content
    named = {f"frames/{number + 1:06d}.png": people for number, people in enumerate(content)}
    (tmp_path / "named.pkl").write_bytes(pickle.dumps(named))
    own = ClipPictures(tuple(f"{number:06d}.png" for number in range(1, COUNT + 1)))
    (track,) = read_tracks([tmp_path / "named.pkl"], HEIGHT, WIDTH, own)
    assert track.frames.tolist() == list(range(COUNT))


def test_mmpose(tmp_path: Path) -> None:
    pixels = shown(tmp_path)
    content = {
        "meta_info": {"dataset_name": "coco"},
        "instance_info": [
            {
                "frame_id": number + 1,
                "instances": [
                    {
                        "keypoints": as_coco(one)[:, :2].tolist(),
                        "keypoint_scores": as_coco(one)[:, 2].tolist(),
                        "bbox": [[1, 2, 3, 4]],
                        "bbox_score": 0.9,
                    }
                ],
            }
            for number, one in enumerate(pixels)
        ],
    }
    (track,) = read(tmp_path, content)
    assert track.frames.tolist() == list(range(COUNT))
    np.testing.assert_allclose(track.pixels[:, KNEE], pixels[:, KNEE], atol=1e-3)
    assert len(COCO) == 17


def wham_in_pieces(folder: Path, cuts: list[range], away: float = 0.0) -> Path:
    """One person as several tracks; the later ones so far to the right [m]."""
    person = Person.some(count=20)
    content = {}
    for name, frames in enumerate(cuts):
        at = np.array(frames)
        place = np.stack([0.02 * at + away * name, 0 * at, 4 + 0.01 * at], 1)
        content[name * 3] = {
            "pose": person.poses[at].reshape(-1, 72),
            "trans": place,
            "betas": person.betas[at],
            "frame_ids": at,
        }
    joblib.dump(content, folder / "wham_output.pkl")
    return folder / "wham_output.pkl"


def test_tracks_that_continue_each_other_are_one_person(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = wham_in_pieces(tmp_path, [range(8), range(8, 13), range(15, 20)])
    (track,) = read_tracks([path], HEIGHT, WIDTH)
    assert track.person == "0+3+6"
    assert track.frames.tolist() == [*range(13), *range(15, 20)]
    np.testing.assert_allclose(track.trans[:, 0], 0.02 * track.frames, atol=1e-9)
    assert "persons 0, 3, 6 never share a frame" in caplog.text
    for name in ("0", "3", "6", "0+3+6"):
        assert choose_person([track], name) is track
    with pytest.raises(InputError, match="no person 1"):
        choose_person([track], "1")


def test_a_track_that_comes_back_between_anothers_frames(tmp_path: Path) -> None:
    path = wham_in_pieces(tmp_path, [range(0, 20, 2), range(1, 20, 2)])
    (track,) = read_tracks([path], HEIGHT, WIDTH)
    assert track.frames.tolist() == list(range(20))


@pytest.mark.parametrize(
    ("cuts", "away"),
    [([range(10), range(10, 20)], 2.0), ([range(12), range(8, 20)], 0.0), ([range(3), range(18, 20)], 3.0)],
)
def test_others_stay_apart(tmp_path: Path, cuts: list[range], away: float) -> None:
    tracks = read_tracks([wham_in_pieces(tmp_path, cuts, away)], HEIGHT, WIDTH)
    assert [track.person for track in tracks] == ["0", "3"]


@pytest.mark.parametrize("suffix", [".pkl", ".npz", ".npy", ".json"])
def test_sam3d_without_its_focal_length(tmp_path: Path, suffix: str) -> None:
    whole = files.sam3d(tmp_path, Person.some(), suffix)
    (true,) = read_tracks([whole.path], HEIGHT, WIDTH)
    for frame in whole.content:
        del frame[0]["focal_length"]
    if suffix == ".json":
        whole.path.write_text(json.dumps(whole.content, default=lambda one: one.tolist()))
    elif suffix == ".npz":
        np.savez(whole.path, data=np.array(whole.content, dtype=object))
    elif suffix == ".npy":
        np.save(whole.path, np.array(whole.content, dtype=object), allow_pickle=True)
    else:
        whole.path.write_bytes(pickle.dumps(whole.content))
    (track,) = read_tracks([whole.path], HEIGHT, WIDTH)
    np.testing.assert_allclose(track.K, true.K, rtol=2e-3)
    for frame in whole.content:
        del frame[0]["pred_keypoints_2d"]
    (tmp_path / "bare.pkl").write_bytes(pickle.dumps(whole.content))
    with pytest.raises(InputError, match="no focal_length, and no pred_keypoints_2d"):
        read_tracks([tmp_path / "bare.pkl"], HEIGHT, WIDTH)


def test_as_reported() -> None:
    if not (REPORTS / "wham_chunks.pkl").is_file():
        pytest.skip("the shared reports are not here")
    tracks = read_tracks([REPORTS / "wham_chunks.pkl"], HEIGHT, WIDTH)
    assert len(tracks) == 1
    assert len(tracks[0]) == 20
    named = REPORTS / "named_from_1"
    own = ClipPictures(tuple(sorted(path.name for path in (named / "frames").iterdir())))
    (track,) = read_tracks([named / "alphapose-results.json"], 120, 160, own)
    assert track.frames.tolist() == list(range(6))
    (track,) = read_tracks([REPORTS / "sam3d_without_focal_length.npz"], HEIGHT, WIDTH)
    assert np.isfinite(track.K).all()
    assert track.joints is not None
    assert JOINT_NAMES[0] == "pelvis"
