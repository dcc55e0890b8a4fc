"""Sources: what is found in a folder, in which order, under which name; built-in motions; CAPE's clothes."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.motions.built_in.gestures import CHANNELS, GESTURES, RANGES
from hfb.datasets.motions.built_in.procedural import ProceduralMotions
from hfb.datasets.motions.folder import FolderMotions
from hfb.datasets.motions.motion_clip import MotionSource
from hfb.datasets.motions.skeletons.kinematics import joint_positions, rest_joints, to_world
from hfb.datasets.motions.sources import open_motions, usable
from hfb.errors import InputError
from hfb.geometry.quaternions import from_axis_angle, rotate
from hfb.priors.anatomy import AnatomicalPrior
from tests.shared import SHARED_DATA

_MOCAP = SHARED_DATA / "cmu_bvh"


def _write_smpl(path: Path, frames: int = 4) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, poses=np.zeros((frames, 72)), trans=np.full((frames, 3), frames), fps=30.0)


def _write_cape(folder: Path, frames: list[int], rng: np.random.Generator) -> np.ndarray:
    """Frames of a sequence whose person walks along x; returns the clothed body of the first."""
    folder.mkdir(parents=True)
    clothed = rng.normal(size=(6890, 3))
    for k, frame in enumerate(frames):
        np.savez(
            folder / f"{folder.name}.{frame:06d}.npz",
            transl=[frame / 60, 0, 0],
            pose=np.full(72, 0.01 * frame),
            v_cano=clothed + 0.001 * k,
            v_posed=clothed,
        )
    return clothed


def test_a_folder_is_searched_in_an_order_of_its_own(tmp_path):
    for name in ("b/z.npz", "b/a.NPZ", "A.npz", ".hidden/x.npz", "b/.y.npz", "c/deep/er/m.npz"):
        _write_smpl(tmp_path / "in" / name.replace("NPZ", "npz"))
    (tmp_path / "in" / "b" / "a.npz").rename(tmp_path / "in" / "b" / "a.NPZ")
    (tmp_path / "in" / "notes.txt").write_text("no motion")
    np.savez(tmp_path / "in" / "b" / "shape.npz", betas=np.zeros(16))  # of AMASS, in every person's folder
    np.savez(tmp_path / "in" / "b" / "neutral_stagei.npz", betas=np.zeros(16))
    (tmp_path / "in" / "folder.bvh").mkdir()
    source = open_motions(tmp_path / "in", 0)
    assert isinstance(source, MotionSource)
    assert list(source.names()) == ["A.npz", "b/a.NPZ", "b/z.npz", "c/deep/er/m.npz"]
    clip = source.load(1)
    assert (clip.name, clip.fps, len(clip.poses)) == ("b/a.NPZ", 30.0, 4)
    again = pickle.loads(pickle.dumps(source))
    np.testing.assert_array_equal(again.load(1).translations, clip.translations)


def test_folders_without_motion_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"AMASS.*BVH.*CAPE.*hfb"):
        open_motions(tmp_path, 0)
    with pytest.raises(InputError, match="no folder"):
        open_motions(tmp_path / "none", 0)


def test_usable_names_what_does_not_load(tmp_path):
    _write_smpl(tmp_path / "a.npz")
    _write_smpl(tmp_path / "short.npz", frames=1)
    (tmp_path / "text.npz").write_text("poses")
    (tmp_path / "cut.bvh").write_text("HIERARCHY\nROOT a\n{\n")
    _write_smpl(tmp_path / "z.npz")
    seen = []
    good, bad = usable(open_motions(tmp_path, 0), lambda done, total: seen.append((done, total)))
    assert good == [0, 4]
    assert list(bad) == ["cut.bvh", "short.npz", "text.npz"]
    assert "1 frames" in bad["short.npz"]
    assert seen == [(k, 5) for k in range(1, 6)]


def test_memory_stays_flat(tmp_path):
    from hfb.datasets.motions import folder

    for k in range(12):
        _write_smpl(tmp_path / f"{k:02d}.npz", frames=k + 2)
    source = FolderMotions(tmp_path)
    assert [len(source.load(k).poses) for k in range(12)] == list(range(2, 14))
    assert folder._load.cache_info().currsize <= 4
    assert source.load(11) is source.load(11)


def test_cape_sequences(tmp_path):
    rng = np.random.default_rng(0)
    clothed = _write_cape(tmp_path / "sequences" / "00032" / "long_hips", [3, 4, 5, 8, 9], rng)
    _write_cape(tmp_path / "sequences" / "00096" / "short_walk", [1, 2], rng)
    minimal = tmp_path / "minimal_body_shape" / "00032" / "00032_minimal.npy"
    minimal.parent.mkdir(parents=True)
    np.save(minimal, clothed - 0.02)
    source = open_motions(tmp_path / "sequences", 0)
    assert list(source.names()) == ["00032/long_hips", "00096/short_walk"]
    clip = source.load(0)
    assert clip.fps == pytest.approx(60)
    assert len(clip.poses) == 7  # frames 6 and 7 are missing and filled in
    np.testing.assert_allclose(clip.translations[:, 0], np.arange(3, 10) / 60, atol=1e-9)
    np.testing.assert_allclose(clip.poses[:, 5, 1], 0.01 * np.arange(3, 10), atol=1e-6)
    assert clip.clothing is not None
    np.testing.assert_allclose(clip.clothing, 0.02, atol=1e-12)
    assert source.load(1).clothing is None
    np.save(minimal, clothed[:100])
    with pytest.raises(InputError, match="same vertices"):
        FolderMotions(tmp_path / "sequences" / "00032").load(0)


def test_a_damaged_frame_of_cape_is_named(tmp_path):
    _write_cape(tmp_path / "walk", [1, 2, 3], np.random.default_rng(0))
    np.savez(tmp_path / "walk" / "walk.000002.npz", v_cano=np.zeros((6890, 3)))
    with pytest.raises(InputError, match=r"walk\.000002\.npz.*v_cano"):
        FolderMotions(tmp_path).load(0)


def test_a_folder_of_recordings():
    if not _MOCAP.is_dir():
        pytest.skip("the shared motion capture is not here")
    source = open_motions(_MOCAP, 0)
    assert len(source.names()) == 116
    clip = source.load(source.names().index("cmu_09_01.bvh"))
    assert clip.fps == 120
    assert clip.poses.shape == (145, 24, 3)
    run = np.linalg.norm(clip.translations[-1] - clip.translations[0]) / (144 / 120)
    assert 2.5 < run < 6  # m/s


def test_built_in_motions_are_many_and_follow_from_the_seed():
    source, same, other = ProceduralMotions(0), ProceduralMotions(0), ProceduralMotions(1)
    names = source.names()
    assert len(names) == len(set(names)) >= 40
    assert isinstance(source, MotionSource)
    for index in (0, 30, 60, 80):
        clip, again = source.load(index), same.load(index)
        assert clip.fps == 120
        assert 2 <= len(clip.poses) / clip.fps <= 4.01
        np.testing.assert_array_equal(clip.poses, again.poses)
        np.testing.assert_array_equal(clip.translations, again.translations)
        assert not np.array_equal(clip.poses[:100], other.load(index).poses[:100])
    assert open_motions(None, 0).names() == names


def test_built_in_motions_are_plausible():
    source = ProceduralMotions(0)
    prior = AnatomicalPrior()
    fastest = []
    for index in range(0, len(source.names()), 2):
        clip = source.load(index)
        limits = prior.limit_penalty(torch.from_numpy(clip.poses[::6, 1:]))
        assert limits.mean() < 2, clip.name
        world = to_world(from_axis_angle(clip.poses))
        joints = joint_positions(world, clip.translations, rest_joints())
        lowest = joints[..., 1].min(1)
        assert lowest.min() > -0.06, clip.name  # soles on the ground
        assert lowest.min() < 0.12, clip.name
        assert lowest.max() < 0.9, clip.name
        assert rotate(world[:, 0], np.array([0, 1.0, 0]))[:, 1].min() > 0.5  # nobody falls over
        speed = np.linalg.norm(np.diff(joints, axis=0), axis=-1) * clip.fps
        assert np.percentile(speed, 99.9) < 15, clip.name
        fastest.append(np.percentile(speed.max(1), 90))
        steps = 2 * np.arccos(np.clip(np.abs((world[1:] * world[:-1]).sum(-1)), 0, 1)) * clip.fps
        assert np.degrees(steps.max()) < 2500, clip.name  # no jumps
    assert np.median(fastest) > 2.0  # lively: m/s of the fastest joint
    assert max(fastest) > 5.0


def test_a_walk_stands_on_one_foot_while_the_other_swings():
    source = ProceduralMotions(2)
    clip = source.load(next(k for k, name in enumerate(source.names()) if "walk" in name))
    joints = joint_positions(to_world(from_axis_angle(clip.poses)), clip.translations, rest_joints())
    feet = joints[:, [JOINT_NAMES.index("left_foot"), JOINT_NAMES.index("right_foot")]]
    speed = np.linalg.norm(np.gradient(feet, axis=0)[..., [0, 2]], axis=-1) * clip.fps
    assert np.median(speed.min(1)) < 0.25 * np.median(speed.max(1))
    gone = clip.translations[-1, [0, 2]] - clip.translations[0, [0, 2]]
    pace = np.linalg.norm(gone) / (len(clip.poses) / clip.fps)
    assert 0.6 < pace < 2.2
    heading = rotate(from_axis_angle(clip.poses[:, 0]), np.array([0, 0, 1.0])).mean(0)[[0, 2]]
    assert gone @ heading / np.linalg.norm(gone) / np.linalg.norm(heading) > 0.9  # forward, not backward


def test_the_book_of_gestures_reads_as_written():
    names = [gesture.name for gesture in GESTURES]
    assert len(names) == len(set(names)) >= 35
    for gesture in GESTURES:
        assert 0.3 < gesture.seconds < 3
        assert len(gesture.keys) >= 2
        for share, pose in gesture.keys:
            assert share > 0
            for name, angle in pose.items():
                assert name in CHANNELS, (gesture.name, name)
                low, high = RANGES[name.removeprefix("l_").removeprefix("r_")]
                assert low - 10 <= angle <= high + 10, (gesture.name, name)  # softly brought into the range
