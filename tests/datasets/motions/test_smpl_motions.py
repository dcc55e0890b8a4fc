"""SMPL layouts from files: the same person upright in our world, whichever file they come from; bad files say why."""

import zipfile

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from hfb.body.assets import load_default_body
from hfb.datasets.motions.files.smpl_motions import load_smpl_motion
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.clock import subframe_times_s

_FRAMES = 20


def _body(columns: int = 66) -> np.ndarray:
    """A person who stands in a world with y up and turns to their left, arms moving."""
    poses = np.zeros((_FRAMES, columns))
    poses[:, 1] = np.linspace(0, 1, _FRAMES)
    poses[:, 3:66] = 0.2 * np.sin(np.arange(_FRAMES)[:, None] / 5 + np.arange(63))
    return poses


def _path() -> np.ndarray:
    return np.linspace(0, 1, _FRAMES)[:, None] * np.array([1.0, 0.2, 3.0])


def _in_world(poses: np.ndarray, turn: Rotation) -> np.ndarray:
    """The same poses in a world whose axes are turned."""
    turned = poses.copy()
    turned[:, :3] = (turn * Rotation.from_rotvec(poses[:, :3])).as_rotvec()
    return turned


_TO_Z_UP = Rotation.from_euler("x", 90, degrees=True)
_TO_CAMERA = Rotation.from_euler("x", 180, degrees=True)


def _same_motion(clip: MotionClip) -> None:
    np.testing.assert_allclose(clip.poses.reshape(_FRAMES, 72)[:, :66], _body(), atol=1e-12)
    np.testing.assert_array_equal(clip.poses[:, 22:], 0)
    np.testing.assert_allclose(clip.translations, _path(), atol=1e-12)


def _amass(columns: int) -> dict[str, np.ndarray]:
    poses = np.random.default_rng(0).normal(size=(_FRAMES, columns))  # fingers that must not come through
    poses[:, :66] = _in_world(_body(), _TO_Z_UP)
    return {"poses": poses, "trans": _TO_Z_UP.apply(_path()), "betas": np.zeros(16), "gender": np.array("female")}


@pytest.mark.parametrize("columns", [156, 165, 66])
@pytest.mark.parametrize("key", ["mocap_framerate", "mocap_frame_rate"])
def test_amass(tmp_path, columns, key):
    np.savez(tmp_path / "a.npz", **_amass(columns), **{key: np.array(120.0)}, dmpls=np.zeros((_FRAMES, 8)))
    clip = load_smpl_motion(tmp_path / "a.npz", "walk")
    assert (clip.name, clip.fps, clip.clothing) == ("walk", 120.0, None)
    _same_motion(clip)


def test_amass_in_parts(tmp_path):
    arrays = _amass(66)
    poses = arrays.pop("poses")
    np.savez(
        tmp_path / "a.npz",
        **arrays,
        root_orient=poses[:, :3],
        pose_body=poses[:, 3:66],
        pose_hand=np.ones((_FRAMES, 90)),
        mocap_frame_rate=np.array([60]),
    )
    clip = load_smpl_motion(tmp_path / "a.npz", "walk")
    assert clip.fps == 60
    _same_motion(clip)


@pytest.mark.parametrize("shape", [(_FRAMES, 72), (_FRAMES, 24, 3)])
def test_plain_smpl_keeps_its_world_and_hands(tmp_path, shape):
    poses = _body(72)
    poses[:, 66:] = 0.25
    np.savez(tmp_path / "a.npz", poses=poses.reshape(shape).astype(np.float32), trans=_path(), fps=30)
    clip = load_smpl_motion(tmp_path / "a.npz", "walk")
    np.testing.assert_allclose(clip.poses.reshape(_FRAMES, 72), poses, atol=1e-6)
    np.testing.assert_allclose(clip.translations, _path())


def test_turning_the_world_moves_all_vertices_as_one(tmp_path):
    """A clip's place has no meaning, but its path does: bodies agree up to one constant for the whole clip."""
    np.savez(tmp_path / "a.npz", **_amass(156), mocap_framerate=120)
    clip = load_smpl_motion(tmp_path / "a.npz", "walk")
    body = load_default_body(torch.float64)
    shaped = body.shape(torch.full((10,), 0.7, dtype=torch.float64))

    def vertices(poses: np.ndarray, translations: np.ndarray) -> np.ndarray:
        matrices = axis_angle_to_matrix(torch.from_numpy(poses.reshape(-1, 24, 3)))
        return shaped.pose(matrices, torch.from_numpy(translations)).vertices.numpy()

    theirs = np.zeros((_FRAMES, 72))
    theirs[:, :66] = _in_world(_body(), _TO_Z_UP)
    there = _TO_Z_UP.inv().apply(vertices(theirs, _TO_Z_UP.apply(_path())).reshape(-1, 3))
    shift = vertices(clip.poses, clip.translations).reshape(-1, 3) - there
    np.testing.assert_allclose(shift, shift[:1] * np.ones((len(shift), 1)), atol=1e-9)


def _own(frames: int, subframes: int, shutter: float) -> dict[str, np.ndarray]:
    times_s, frame_index = subframe_times_s(frames, subframes, shutter / 30, 1 / 30)
    poses = np.zeros((len(times_s), 72))
    poses[:, 1] = 3.0 * times_s
    places = times_s[:, None] * np.array([1.0, -2.0, 0.5])
    return {
        "poses": _in_world(poses, _TO_CAMERA),
        "trans": _TO_CAMERA.apply(places),
        "times_s": times_s,
        "frame_index": frame_index,
        "K": np.eye(3),
        "betas": np.zeros(10),
        "betas_space": np.array("hfb"),
    }


@pytest.mark.parametrize(("frames", "shutter"), [(1, 0.8), (3, 0.5), (3, 1.0), (4, 0.9)])
def test_own_motions_with_gaps_between_exposures(tmp_path, frames, shutter):
    np.savez(tmp_path / "motion.npz", **_own(frames, 8, shutter))
    clip = load_smpl_motion(tmp_path / "motion.npz", "own")
    assert clip.fps == pytest.approx(30 * 7 / shutter)
    times_s = np.arange(len(clip.poses)) / clip.fps
    assert times_s[-1] == pytest.approx((frames - 1 + shutter) / 30, abs=1 / clip.fps)
    np.testing.assert_allclose(clip.poses[:, 0, 1], 3.0 * times_s, atol=1e-5)
    np.testing.assert_allclose(clip.translations, times_s[:, None] * np.array([1.0, -2.0, 0.5]), atol=1e-9)


def test_own_motions_whose_instants_are_not_in_order(tmp_path):
    arrays = _own(2, 8, 0.5)
    np.savez(tmp_path / "motion.npz", **(arrays | {"times_s": arrays["times_s"][::-1]}))
    with pytest.raises(InputError, match="in order"):
        load_smpl_motion(tmp_path / "motion.npz", "own")
    np.savez(tmp_path / "motion.npz", **(arrays | {"times_s": np.concatenate([[-1e9], arrays["times_s"][1:]])}))
    with pytest.raises(InputError, match="gaps"):
        load_smpl_motion(tmp_path / "motion.npz", "own")


def _changed(**changes: object) -> dict[str, object]:
    return {"poses": _body(156), "trans": _path(), "mocap_framerate": 120.0} | changes


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({"betas": np.zeros(10), "gender": np.array("male")}, "betas, gender; expected is AMASS"),
        (_changed(poses=_body(150)), "expected is AMASS"),
        (_changed(poses=np.zeros(156)), "expected is AMASS"),
        (_changed(poses=np.full((_FRAMES, 156), np.nan)), "not finite"),
        (_changed(trans=np.full((_FRAMES, 3), np.inf)), "not finite"),
        (_changed(trans=_path() * 1e6), "metres"),
        (_changed(trans=_path()[:5]), r"20 poses but translations of shape \(5, 3\)"),
        (_changed(poses=_body(156)[:1], trans=_path()[:1]), "1 frames"),
        (_changed(poses=_body(156)[:0], trans=_path()[:0]), "0 frames"),
        (_changed(mocap_framerate=0.0), "0 frames per second"),
        (_changed(mocap_framerate=np.nan), "nan frames per second"),
        (_changed(mocap_framerate=np.array([60.0, 120.0])), "2 frame rates"),
        (_changed(mocap_framerate=np.array("fast")), "no plain numbers"),
        (_changed(poses=np.array([{"a": 1}], dtype=object)), "no plain numbers"),
        (_changed(trans=_path().astype(complex)), "no plain numbers"),
    ],
)
def test_bad_arrays_are_refused_with_the_reason(tmp_path, arrays, reason):
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(InputError, match=reason) as caught:
        load_smpl_motion(tmp_path / "bad.npz", "bad")
    assert "bad.npz" in str(caught.value)


def test_files_that_are_no_archives(tmp_path):
    np.savez(tmp_path / "good.npz", **_changed())
    data = (tmp_path / "good.npz").read_bytes()
    path = tmp_path / "bad.npz"
    for content in (b"", b"poses 1 2 3", data[: len(data) // 2], data[:-10], data[:100] + bytes(2000) + data[2100:]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"bad\.npz"):
            load_smpl_motion(path, "bad")
    with pytest.raises(InputError, match="no file"):
        load_smpl_motion(tmp_path / "none.npz", "none")


def _member(header: bytes, length: int) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(length)


@pytest.mark.parametrize(
    "header",
    [
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999, 156)}\n",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 156)}\n",
        b"{'descr': '|O', 'fortran_order': False, 'shape': (2, 156)}\n",
        b"[" * 60_000 + b"\n",
        b"__import__('os').system('false')\n",
    ],
)
def test_lying_headers(tmp_path, header):
    with zipfile.ZipFile(tmp_path / "bad.npz", "w") as archive:
        archive.writestr("poses.npy", _member(header, 2 * 156 * 8))
    with pytest.raises(InputError):
        load_smpl_motion(tmp_path / "bad.npz", "bad")


def test_a_zip_bomb_is_not_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("poses.npy", bytes(1000))
    data = (tmp_path / "bomb.npz").read_bytes()
    entry = data.index(b"PK\x01\x02") + 24  # the directory's unpacked size
    (tmp_path / "bomb.npz").write_bytes(data[:entry] + (1 << 31).to_bytes(4, "little") + data[entry + 4 :])
    with pytest.raises(InputError, match="larger than 512 MB"):
        load_smpl_motion(tmp_path / "bomb.npz", "bomb")


def test_degrees_are_refused(tmp_path):
    poses, turning = np.rad2deg(_body()), _body()
    turning[:, :3] *= 30  # a dancer whose turns were unwrapped
    facts = {"trans": _path(), "fps": np.array(30.0)}
    np.savez(tmp_path / "a.npz", poses=np.pad(poses, ((0, 0), (0, 6))), **facts)
    with pytest.raises(InputError, match="convert its degrees to radians"):
        load_smpl_motion(tmp_path / "a.npz", "walk")
    np.savez(tmp_path / "b.npz", poses=np.pad(turning, ((0, 0), (0, 6))), **facts)
    np.testing.assert_allclose(load_smpl_motion(tmp_path / "b.npz", "walk").poses[:, 0, 1], 30 * _body()[:, 1])


@pytest.mark.parametrize("unit", [100, 1000])
def test_translations_that_are_not_metres_are_refused(tmp_path, unit):
    arrays = _amass(156)
    np.savez(tmp_path / "a.npz", **(arrays | {"trans": unit * arrays["trans"]}), mocap_framerate=np.array(60.0))
    with pytest.raises(InputError, match=r"a\.npz moves its person by .* m/s: give its translations in metres"):
        load_smpl_motion(tmp_path / "a.npz", "walk")


def test_whoever_stands_along_y_in_a_file_of_amass_is_told(tmp_path, caplog):
    np.savez(tmp_path / "a.npz", poses=_body(156), trans=_path(), mocap_framerate=np.array(60.0))
    load_smpl_motion(tmp_path / "a.npz", "walk")
    assert "walk: its person lies, along y: name its rate fps if y is up" in caplog.text
    caplog.clear()
    np.savez(tmp_path / "b.npz", **_amass(156), mocap_framerate=np.array(60.0))
    load_smpl_motion(tmp_path / "b.npz", "walk")
    assert not caplog.text
