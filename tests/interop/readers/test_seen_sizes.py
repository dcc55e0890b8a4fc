"""A system that looked at another resolution: its camera looks through the middle of what it saw."""

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hfb.errors import InputError
from hfb.interop.readers.beside import companions
from hfb.interop.readers.pose_track import PoseTrack, pinhole, size_seen
from hfb.interop.readers.sniff import read_tracks
from tests.interop.readers import files
from tests.interop.readers.files import HEIGHT, WIDTH, Person, Written

WRITERS: dict[str, Callable[[Path], Written]] = {
    "TRAM": lambda folder: files.tram(folder, Person.some()),
    "GVHMR": lambda folder: files.gvhmr(folder, Person.some(), np.zeros((1, 3))),
    "SAM 3D Body": lambda folder: _centred(files.sam3d(folder, Person.some())),
}


def _centred(written: Written) -> Written:
    """Its own keypoints before a camera that looks through the middle, as the system's does."""
    for (one,) in written.content:
        one["pred_keypoints_2d"] = one["pred_keypoints_2d"] - np.array([5, -4])
    written.path.write_bytes(pickle.dumps(written.content))
    return written


def read(path: Path, height: int, width: int) -> PoseTrack:
    (track,) = read_tracks([path, *companions(path)], height, width)
    return track


@pytest.mark.parametrize("system", WRITERS)
def test_the_same_pictures_smaller(tmp_path: Path, system: str) -> None:
    path = WRITERS[system](tmp_path).path
    whole, half = read(path, HEIGHT, WIDTH), read(path, HEIGHT // 2, WIDTH // 2)
    assert whole.size == (HEIGHT, WIDTH)
    assert half.size == (HEIGHT // 2, WIDTH // 2)
    assert whole.K is not None
    assert half.K is not None
    # Its centre lies some pixels beside the middle: so much the size may be wrong.
    np.testing.assert_allclose(half.K[:, :2], whole.K[:, :2] / 2, rtol=0.02)
    with pytest.raises(InputError, match=rf"{system} result is about pictures of 6\d\d x 4\d\d px"):
        read(path, WIDTH, WIDTH)


def test_the_size_is_twice_the_centre() -> None:
    K = np.stack([pinhole(800, 960, 540.2), np.full((3, 3), np.nan)])
    assert size_seen(K, (480, 640)) == (1080, 1920)
    assert size_seen(K, (1088, 1920)) == (1088, 1920)
    assert size_seen(K[1:], (480, 640)) == (480, 640)
    with pytest.raises(InputError, match="no picture's middle"):
        size_seen(pinhole(800, 0, 0)[None], (480, 640))
