"""motion.npz reads back bit for bit, without pickle, and bad files are said so."""

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hfb.errors import InputError
from hfb.geometry.placement import with_floor, world_of_pose
from hfb.motion.motion_file import load_motion, save_motion
from hfb.motion.sampled import SampledMotion


def motion() -> SampledMotion:
    rng = np.random.default_rng(0)
    return SampledMotion(
        poses=rng.normal(size=(6, 72)),
        trans=rng.normal(size=(6, 3)),
        betas=rng.normal(size=10),
        joints=rng.normal(size=(6, 24, 3)),
        times_s=np.arange(6) / 100,
        frame_index=np.repeat([0, 1], 3),
        K=np.eye(3),
    )


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "motion.npz"
    save_motion(path, motion(), "hfb")
    read, space = load_motion(path)
    assert space == "hfb"
    for name in ("poses", "trans", "betas", "joints", "times_s", "frame_index", "K"):
        np.testing.assert_array_equal(getattr(read, name), getattr(motion(), name))
    with np.load(path, allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04broken"])
def test_damaged_files_are_said_so(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "motion.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a motion file"):
        load_motion(path)


def test_a_missing_file_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no motion file"):
        load_motion(tmp_path / "none.npz")


def test_pickled_members_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "motion.npz"
    arrays = {"poses": np.array([{"a": 1}], dtype=object)}
    np.savez(path, **arrays)
    with pytest.raises(InputError, match="not a motion file"):
        load_motion(path)


def test_how_far_off_joints_may_be_is_kept_where_it_is_known(tmp_path: Path) -> None:
    path, radius = tmp_path / "motion.npz", np.random.default_rng(1).uniform(5, 90, (6, 24))
    save_motion(path, replace(motion(), joint_radius_mm=radius), "hfb")
    read, _ = load_motion(path)
    assert read.joint_radius_mm is not None
    np.testing.assert_array_equal(read.joint_radius_mm, radius)
    save_motion(path, motion(), "hfb")
    assert load_motion(path)[0].joint_radius_mm is None


def test_the_world_is_kept_where_it_is_known(tmp_path: Path) -> None:
    path, world = tmp_path / "motion.npz", world_of_pose(np.eye(3)[[1, 2, 0]], np.array([1.0, 2, 3]), "-z")
    on_floor = with_floor(world, (0.6, 0, 0.8, 2))
    save_motion(path, replace(motion(), world=on_floor), "hfb")
    assert load_motion(path)[0].world == on_floor
    save_motion(path, replace(motion(), world=world), "hfb")
    assert load_motion(path)[0].world == world
    with np.load(path, allow_pickle=False) as file:
        content = dict(file)
    np.testing.assert_allclose(content["R_world_camera"] @ [1, 2, 3] + content["t_world_camera"], 0)
    damages = {
        "R_world_camera": np.diag([1.0, 1, -1]),
        "t_world_camera": np.array([np.nan, 0, 0]),
        "floor": np.array([0, 0, np.nan, 0]),
        "floor_source": np.array("wall"),
        "world_up": np.array("w"),
        "world_source": np.array(3),
    }
    for name, damage in damages.items():
        np.savez(path, **(content | {name: damage}))
        with pytest.raises(InputError, match="world"):
            load_motion(path)
    np.savez(path, **{name: value for name, value in content.items() if name != "world_up"})
    with pytest.raises(InputError, match="world_up"):
        load_motion(path)
    save_motion(path, motion(), "hfb")
    assert load_motion(path)[0].world is None


@pytest.mark.parametrize("size", [[640], [640, 0], [640.0, 480.0], [640, 1 << 40]])
def test_the_images_size(size: list[float], tmp_path: Path) -> None:
    path = tmp_path / "motion.npz"
    save_motion(path, replace(motion(), size=(640, 480)), "hfb")
    assert load_motion(path)[0].size == (640, 480)
    with np.load(path, allow_pickle=False) as file:
        np.savez(path, **(dict(file) | {"size": np.array(size)}))
    with pytest.raises(InputError, match="its size is not the width and height of an image"):
        load_motion(path)
    save_motion(path, motion(), "hfb")
    assert load_motion(path)[0].size is None


def test_what_would_fill_the_memory_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "motion.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("poses.npy", "w") as member:
        for _ in range(65):
            member.write(bytes(1 << 24))
    assert path.stat().st_size < 2 << 20
    with pytest.raises(InputError, match="larger than 512 MB"):
        load_motion(path)
