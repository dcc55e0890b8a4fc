"""Every system's file comes back as the person it was about, before the camera that the system meant."""

from collections.abc import Callable
from pathlib import Path

import joblib
import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.interop.readers import smplx
from hfb.interop.readers.beside import companions
from hfb.interop.readers.pose_track import PoseTrack, load_track, save_track
from hfb.interop.readers.sniff import choose_person, read_tracks
from hfb.interop.track_bodies import body_at, with_poses
from hfb.motion.motion_file import save_motion
from hfb.motion.sampled import SampledMotion
from hfb.motion.static_pose import FirstBody
from tests.interop.readers import files
from tests.interop.readers.files import COUNT, HEIGHT, WIDTH, Person, Written

SMPL = files.smpl()
WRITERS: dict[str, Callable[[Path, Person], Written]] = {
    "PyMAF": files.pymaf,
    "HybrIK": files.hybrik,
    "PHALP": files.phalp,
    "WHAM": files.wham,
    "TRAM": files.tram,
}


def read(path: Path, height: int = HEIGHT, width: int = WIDTH) -> tuple[PoseTrack, ...]:
    return read_tracks([path, *companions(path)], height, width)


def own_camera(track: PoseTrack, row: int) -> PinholeCamera:
    assert track.K is not None
    return PinholeCamera.from_matrix(torch.from_numpy(track.K[row]), HEIGHT, WIDTH)


def seen(first: FirstBody, camera: PinholeCamera) -> np.ndarray:
    turns = axis_angle_to_matrix(first.pose.double())[None]
    joints = SMPL.shape(first.betas.double()).joints_of(turns, first.translation.double()[None])
    return camera.project(joints)[0].numpy()


@pytest.mark.parametrize("system", WRITERS)
def test_the_person_appears_where_the_system_draws_it(tmp_path: Path, system: str) -> None:
    person = Person.some()
    written = WRITERS[system](tmp_path, person)
    track = choose_person(read(written.path), None)
    assert track.system == system
    assert len(track) == COUNT
    for row, frame in enumerate(track.frames):
        camera = own_camera(track, row)
        first = body_at(track, int(frame), camera, SMPL)
        assert first is not None
        np.testing.assert_allclose(seen(first, camera), written.pixels[row], atol=0.9)
        turn = axis_angle_to_matrix(first.pose).numpy() - person.matrices[row]
        assert np.abs(turn).max() < 1e-4
        np.testing.assert_allclose(first.betas.numpy(), person.betas[row], atol=1e-5)


@pytest.mark.parametrize("system", WRITERS)
def test_another_camera_shows_the_same(tmp_path: Path, system: str) -> None:
    """A focal length of the picture's diagonal instead of the system's: the root where it was, the rest nearly."""
    written = WRITERS[system](tmp_path, Person.some(1))
    track = read(written.path)[0] if system != "PHALP" else choose_person(read(written.path), "7")
    camera = PinholeCamera.from_focal(800.0, HEIGHT, WIDTH)
    first = body_at(track, int(track.frames[2]), camera, SMPL)
    assert first is not None
    pixels = seen(first, camera)
    size = np.ptp(written.pixels[2], axis=0).max()
    np.testing.assert_allclose(pixels[0], written.pixels[2, 0], atol=0.5)
    # What comes nearer to a nearer lens grows: some percent of the person's size.
    assert np.abs(pixels - written.pixels[2]).max() < 0.08 * size


def test_frames_are_the_systems_own(tmp_path: Path) -> None:
    person = Person.some()
    assert read(files.pymaf(tmp_path, person).path)[0].frames.tolist() == [2, 3, 4, 5, 6]
    assert read(files.hybrik(tmp_path, person).path)[0].frames.tolist() == [2, 3, 4, 5, 6]  # its names count from 1
    assert body_at(read(files.wham(tmp_path, person).path)[0], 99, own_camera_of(tmp_path, person), SMPL) is None


def own_camera_of(folder: Path, person: Person) -> PinholeCamera:
    return own_camera(read(files.wham(folder, person).path)[0], 0)


def test_a_track_that_only_remembers_is_left_out(tmp_path: Path) -> None:
    tracks = read(files.phalp(tmp_path, Person.some()).path)
    assert [track.person for track in tracks] == ["7"]
    with pytest.raises(InputError, match="no person 4; it has 7"):
        choose_person(tracks, "4")


def test_gvhmr_is_smplx(tmp_path: Path) -> None:
    person = Person.some()
    written = files.gvhmr(tmp_path, person, smplx.smplx_pelvis(np.zeros((1, 3))))
    (track,) = read(written.path)
    assert track.betas_space == "smplx"
    camera = own_camera(track, 1)
    first = body_at(track, 1, camera, SMPL)
    assert first is not None
    assert float(first.betas.abs().max()) == 0  # SMPL-X's betas are nobody else's
    np.testing.assert_allclose(seen(first, camera)[0], written.pixels[1, 0], atol=0.5)
    np.testing.assert_allclose(first.pose[1:22].numpy(), person.poses[1, 1:22], atol=1e-5)
    assert float(first.pose[22:].abs().max()) == 0


@pytest.mark.parametrize("suffix", [".pkl", ".npy", ".npz", ".json"])
def test_sam_3d_bodys_keypoints_get_a_body(tmp_path: Path, suffix: str) -> None:
    written = files.sam3d(tmp_path, Person.some(2), suffix)
    (track,) = read(written.path)
    camera = own_camera(track, 0)
    assert (camera.cx, camera.cy) == pytest.approx((WIDTH / 2 + 5, HEIGHT / 2 - 4), abs=0.1)
    if suffix != ".pkl":
        return
    posed = with_poses(track, SMPL)
    for row in range(COUNT):
        first = body_at(posed, row, camera, SMPL)
        assert first is not None
        known = np.isfinite(written.pixels[row]).all(1)
        miss = np.linalg.norm(seen(first, camera) - written.pixels[row], axis=1)[known]
        assert miss.mean() < 6  # px, of a person of some 400


@pytest.mark.parametrize(("suffix", "joints"), [(".pt", 24), (".pkl", 24), (".pt", 55)])
def test_nlf_says_where_and_how(tmp_path: Path, suffix: str, joints: int) -> None:
    """Millimetres, its own camera, and nobody in the last frame."""
    person = Person.some()
    written = files.nlf(tmp_path, person, suffix, joints)
    (track,) = read(written.path)
    assert track.system == "NLF"
    assert track.betas_space == ("smpl" if joints == 24 else "smplx")
    assert track.frames.tolist() == list(range(COUNT))
    camera = own_camera(track, 1)
    assert camera.fx == pytest.approx(WIDTH / (2 * np.tan(np.radians(27.5))), rel=1e-3)
    first = body_at(track, 1, camera, SMPL)
    assert first is not None
    np.testing.assert_allclose(first.pose[1:22].numpy(), person.poses[1, 1:22], atol=1e-5)
    np.testing.assert_allclose(seen(first, camera)[0], written.pixels[1, 0], atol=0.05)
    if joints == 24:
        np.testing.assert_allclose(seen(first, camera), written.pixels[1], atol=0.5)


def test_nlf_s_people_and_assumed_camera(tmp_path: Path) -> None:
    content = files.nlf(tmp_path, Person.some()).content
    beside = {name: [torch.cat([one, one]) for one in entries] for name, entries in content.items()}
    for one in beside["joints3d"]:
        one[len(one) // 2 :, :, 0] += 1500.0
    del beside["joints2d"]
    torch.save(beside, tmp_path / "two.pt")
    first, second = read(tmp_path / "two.pt")
    assert first.pelvis is not None
    assert second.pelvis is not None
    np.testing.assert_allclose(second.pelvis - first.pelvis, np.tile([1.5, 0, 0], (COUNT, 1)), atol=1e-5)
    assert own_camera(first, 0).fx == pytest.approx(WIDTH / (2 * np.tan(np.radians(27.5))))


def test_nlf_s_damage_is_said(tmp_path: Path) -> None:
    whole = files.nlf(tmp_path, Person.some()).content
    for name, part, says in (
        ("pose", [one[:, :70] if one.ndim == 2 else one for one in whole["pose"]], "70 numbers instead of 72"),
        ("joints3d", whole["joints3d"][:-1], "different numbers of frames"),
        ("joints3d", [one[:, :20] for one in whole["joints3d"]], r"\(1, 20, 3\)"),
    ):
        torch.save({**whole, name: part}, tmp_path / "damaged.pt")
        with pytest.raises(InputError, match=says):
            read(tmp_path / "damaged.pt")
    torch.save({name: [one[:0] for one in entries] for name, entries in whole.items()}, tmp_path / "nobody.pt")
    with pytest.raises(InputError, match="it holds nobody"):
        read(tmp_path / "nobody.pt")


def test_without_tram_s_camera_the_diagonal_is_assumed(tmp_path: Path) -> None:
    path = files.tram(tmp_path, Person.some()).path
    assert own_camera(read(path)[0], 0).fx == 700
    (tmp_path / "camera.npy").unlink()
    assert own_camera(read(path)[0], 0).fx == pytest.approx(800)


def test_amass_is_upright_but_nowhere(tmp_path: Path) -> None:
    """A person who stands in a z-up world stands in the image."""
    poses = np.zeros((3, 156))
    poses[:, 0] = np.pi / 2  # from the rest pose's y up to z up
    np.savez(tmp_path / "walk_poses.npz", poses=poses, trans=np.zeros((3, 3)), mocap_framerate=120.0)
    (track,) = read(tmp_path / "walk_poses.npz")
    assert track.K is None
    assert not track.turn_is_known
    first = body_at(track, 0, PinholeCamera.from_focal(800, HEIGHT, WIDTH), SMPL)
    assert first is not None
    assert bool(first.translation.isnan().all())
    turns = axis_angle_to_matrix(first.pose.double())[None]
    joints = SMPL.shape(first.betas.double()).joints_of(turns, torch.zeros(1, 3).double())[0]
    assert joints[JOINT_NAMES.index("head"), 1] < joints[JOINT_NAMES.index("left_foot"), 1] - 1


def test_joints_of_any_system(tmp_path: Path) -> None:
    person = Person.some(3)
    joints = person.standing + np.array([0.1, 0.2, 4.0])
    K = np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]])
    np.savez(tmp_path / "joints.npz", joints=joints, K=K, frame_index=np.arange(COUNT) * 2)
    (track,) = read(tmp_path / "joints.npz")
    assert track.frames.tolist() == [0, 2, 4, 6, 8]
    first = body_at(with_poses(track, SMPL), 4, own_camera(track, 2), SMPL)
    assert first is not None
    expected = files.perspective(joints, 700.0)[2]
    assert np.linalg.norm(seen(first, own_camera(track, 2)) - expected, axis=1).mean() < 3
    order = [3, 1, 2, 0, *range(4, 20)]
    np.savez(
        tmp_path / "named.npz",
        joints=joints[:, order] * [1, -1, -1],
        y_up=True,
        joint_names=np.array([JOINT_NAMES[joint] for joint in order]),
    )
    (track,) = read(tmp_path / "named.npz")
    assert track.joints is not None
    np.testing.assert_allclose(track.joints[:, 7], joints[:, 7])
    assert np.isnan(track.joints[:, 22]).all()


def test_our_own_motion_starts_another_fit(tmp_path: Path) -> None:
    person = Person.some(4, count=6)
    K = np.array([[700.0, 0, 320], [0, 700, 240], [0, 0, 1]])
    motion = SampledMotion(
        person.poses.reshape(6, 72),
        np.tile([0.0, 0, 4], (6, 1)),
        person.betas[0],
        person.standing,
        np.arange(6) / 100,
        np.repeat([0, 1], 3),
        K,
    )
    save_motion(tmp_path / "motion.npz", motion, "hfb")
    (track,) = read(tmp_path / "motion.npz")
    assert track.frames.tolist() == [0, 1]
    first = body_at(track, 1, own_camera(track, 1), load_default_body())
    assert first is not None
    np.testing.assert_allclose(first.pose.numpy(), person.poses[4], atol=1e-6)
    np.testing.assert_allclose(first.translation.numpy(), [0, 0, 4], atol=1e-6)


def test_the_canonical_file_keeps_everything(tmp_path: Path) -> None:
    (track,) = read(files.hybrik(tmp_path, Person.some()).path)
    save_track(tmp_path / "track.npz", track)
    again = load_track(tmp_path / "track.npz")
    assert (again.system, again.person, again.size) == (track.system, track.person, track.size)
    for name in ("frames", "poses", "betas", "pelvis", "K"):
        np.testing.assert_array_equal(getattr(again, name), getattr(track, name))
    assert read(tmp_path / "track.npz")[0].system == "HybrIK"


def test_pictures_of_another_resolution(tmp_path: Path) -> None:
    path = files.hybrik(tmp_path, Person.some()).path
    (half,) = read(path, HEIGHT // 2, WIDTH // 2)
    assert half.K is not None
    assert half.K[0, 0, 0] == pytest.approx(1000 / 256 * 200 / 2)
    with pytest.raises(InputError, match="640 x 480 px and the frames have 640 x 640"):
        read(path, WIDTH, WIDTH)


@pytest.mark.parametrize("compress", [("zlib", 3), ("gzip", 3), ("bz2", 3), ("lzma", 3), ("xz", 3)])
def test_compressed_joblib(tmp_path: Path, compress: tuple[str, int]) -> None:
    written = files.wham(tmp_path, Person.some())
    joblib.dump(written.content, tmp_path / "c.pkl", compress=compress)
    np.testing.assert_allclose(read(tmp_path / "c.pkl")[0].poses, read(written.path)[0].poses)


def test_what_is_nobody_s_result_is_said_so(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", cats=np.zeros(3))
    with pytest.raises(InputError, match=r"no result that hfb knows \(it holds cats\)"):
        read(tmp_path / "other.npz")
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path / "missing.pkl")
    path = files.wham(tmp_path, Person.some()).path
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"wham_output.pkl cannot be used"):
        read(path)
    content = files.wham(tmp_path, Person.some()).content
    content[0]["trans"] = content[0]["trans"][:2]
    joblib.dump(content, path)
    with pytest.raises(InputError, match=r"shape \(2, 3\)"):
        read(path)
    content[0]["trans"] = np.full((COUNT, 3), np.nan)
    joblib.dump(content, path)
    with pytest.raises(InputError, match="not finite"):
        read(path)
