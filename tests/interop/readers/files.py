"""A person before a camera, and what each system would write about it: its exact layout, its own camera formula."""

import json
import pickle
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.body.model import Body
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.typing import Array

HEIGHT, WIDTH, COUNT = 480, 640, 5
MHR70 = {
    "left_shoulder": 5,
    "right_shoulder": 6,
    "left_elbow": 7,
    "right_elbow": 8,
    "left_hip": 9,
    "right_hip": 10,
    "left_knee": 11,
    "right_knee": 12,
    "left_ankle": 13,
    "right_ankle": 14,
    "right_wrist": 41,
    "left_wrist": 62,
    "neck": 69,
}


def smpl() -> Body:
    """The embedded body in SMPL's place: the same layout, its betas taken for SMPL's."""
    return replace(load_default_body(torch.float64), betas_space="smpl")


@dataclass(frozen=True)
class Person:
    """Some frames of a person.

    Attributes:
        standing: joints [m] for a translation of zero.
    """

    poses: Array
    betas: Array
    standing: Array

    @staticmethod
    def some(seed: int = 0, count: int = COUNT) -> "Person":
        """Upright, facing the camera more or less, limbs somewhere."""
        random = np.random.default_rng(seed)
        poses = random.normal(0, 0.3, (count, 24, 3))
        poses[:, 0] = [np.pi, 0, 0] + random.normal(0, 0.1, (count, 3))
        betas = np.tile(random.normal(0, 1, 10), (count, 1))
        body = smpl()
        turns = axis_angle_to_matrix(torch.from_numpy(poses))
        standing = body.shape(torch.from_numpy(betas[0])).joints_of(turns, torch.zeros(count, 3).double()).numpy()
        return Person(poses, betas, standing)

    @property
    def matrices(self) -> Array:
        return axis_angle_to_matrix(torch.from_numpy(self.poses)).numpy()


@dataclass(frozen=True)
class Written:
    """A file, and where its system draws the person's 24 joints [px] (NaN where it has none)."""

    path: Path
    content: Any
    pixels: Array


def perspective(points: Array, focal_px: float | Array, centre: tuple[float, float] = (WIDTH / 2, HEIGHT / 2)) -> Array:
    return np.reshape(focal_px, (-1, 1, 1)) * points[..., :2] / points[..., 2:] + np.array(centre)


def pymaf(folder: Path, person: Person) -> Written:
    """demo.py: joblib.dump of {person: output_dict}; orig_cam by its convert_crop_cam_to_orig_img."""
    cam = np.stack([np.linspace(0.8, 1.0, COUNT), np.full(COUNT, 0.02), np.full(COUNT, 0.3)], 1)
    boxes = np.tile([350.0, 220.0, 260.0, 260.0], (COUNT, 1))
    sx, sy = cam[:, 0] * 260 / WIDTH, cam[:, 0] * 260 / HEIGHT
    tx = (350 - WIDTH / 2) / (WIDTH / 2) / sx + cam[:, 1]
    ty = (220 - HEIGHT / 2) / (HEIGHT / 2) / sy + cam[:, 2]
    content = {
        1: {
            "pred_cam": cam.astype(np.float32),
            "orig_cam": np.stack([sx, sy, tx, ty]).T,
            "verts": np.zeros((COUNT, 30, 3), np.float32),
            "pose": person.poses.reshape(-1, 72).astype(np.float32),
            "betas": person.betas.astype(np.float32),
            "joints3d": np.zeros((COUNT, 49, 3), np.float32),
            "joints2d": None,
            "bboxes": boxes,
            "frame_ids": np.arange(COUNT) + 2,
        }
    }
    u = (sx[:, None] * (person.standing[..., 0] + tx[:, None]) + 1) * WIDTH / 2
    v = (sy[:, None] * (person.standing[..., 1] + ty[:, None]) + 1) * HEIGHT / 2
    return _joblib(folder / "output.pkl", content, np.stack([u, v], -1))


def hybrik(folder: Path, person: Person) -> Written:
    """demo_video.py --save-pk: pickle of arrays over the frames."""
    place = np.stack([np.linspace(-0.1, 0.2, COUNT), np.full(COUNT, 0.1), np.linspace(8, 9, COUNT)], 1)
    boxes = np.tile([220.0, 100.0, 420.0, 300.0], (COUNT, 1))
    centred = person.standing - person.standing[:, :1]
    content = {
        "pred_uvd": np.zeros((COUNT, 29, 3), np.float32),
        "pred_thetas": person.matrices.reshape(COUNT, 216),
        "pred_betas": person.betas,
        "pred_phi": np.zeros((COUNT, 23, 2)),
        "transl": place,
        "transl_camsys": place,
        "pred_camera": np.ones((COUNT, 1)),
        "bbox": boxes,
        "height": np.full(COUNT, HEIGHT),
        "width": np.full(COUNT, WIDTH),
        "img_path": np.array([f"out/raw/clip-{3 + n:06d}.png" for n in range(COUNT)]),
    }
    return _pickle(folder / "res.pk", content, perspective(centred + place[:, None], 1000 / 256 * 200))


def phalp(folder: Path, person: Person) -> Written:
    """trackers/PHALP.py: joblib.dump of {frame name: lists over the tracks}; a second, shorter track, a stale entry."""
    camera = np.stack([np.linspace(-0.3, 0.1, COUNT), np.full(COUNT, 0.2), np.full(COUNT, 70.0)], 1)
    content: dict[str, Any] = {}
    for n in range(COUNT):
        one = {
            "global_orient": person.matrices[n, :1].astype(np.float32),
            "body_pose": person.matrices[n, 1:].astype(np.float32),
            "betas": person.betas[n].astype(np.float32),
        }
        others = [4] if n < 2 else []
        content[f"_DEMO/img/{n + 1:06d}.jpg"] = {
            "time": n,
            "shot": 0,
            "tid": [7, *others],
            "bbox": [np.array([1.0, 2, 3, 4])] * (1 + len(others)),
            "tracked_ids": [7],
            "tracked_time": [0, *(3 for _ in others)],
            "smpl": [one] * (1 + len(others)),
            "camera": [camera[n].astype(np.float32)] * (1 + len(others)),
            "size": [[HEIGHT, WIDTH]] * (1 + len(others)),
            "embedding": [torch.zeros(8)] * (1 + len(others)),
            "mask": [{"size": [HEIGHT, WIDTH], "counts": b"abc"}],
            "conf": [np.float32(0.9)],
        }
    # In a picture of 256 px that the padded frame fills.
    square = perspective(person.standing + camera[:, None], 5000.0, (128.0, 128.0)) / 256 * WIDTH
    return _joblib(folder / "demo_clip.pkl", content, square - [0, (WIDTH - HEIGHT) / 2])


def wham(folder: Path, person: Person) -> Written:
    """demo.py --save_pkl: joblib.dump of a defaultdict."""
    place = np.stack([np.linspace(-0.2, 0.3, COUNT), np.full(COUNT, 0.1), np.full(COUNT, 4.0)], 1)
    content: Any = defaultdict(dict)
    content[0] = {
        "pose": person.poses.reshape(-1, 72),
        "trans": place,
        "pose_world": person.poses.reshape(-1, 72),
        "trans_world": place,
        "betas": person.betas,
        "verts": np.zeros((COUNT, 40, 3), np.float32),
        "frame_ids": np.arange(COUNT),
    }
    focal_px = (WIDTH**2 + HEIGHT**2) ** 0.5
    return _joblib(folder / "wham_output.pkl", content, perspective(person.standing + place[:, None], focal_px))


def tram(folder: Path, person: Person) -> Written:
    """estimate_humans.py: numpy.save of a dictionary of tensors, and camera.npy one folder up."""
    place = np.stack([np.linspace(-0.2, 0.3, COUNT), np.full(COUNT, 0.1), np.full(COUNT, 4.0)], 1)
    camera = {
        "pred_cam_R": np.tile(np.eye(3), (COUNT, 1, 1)),
        "pred_cam_T": np.zeros((COUNT, 3)),
        "img_focal": torch.tensor(700.0),
        "img_center": torch.tensor([WIDTH / 2 + 3, HEIGHT / 2]),
    }
    content = {
        "pred_cam": torch.ones(COUNT, 3),
        "pred_pose": torch.zeros(COUNT, 144),
        "pred_shape": torch.from_numpy(person.betas),
        "pred_rotmat": torch.from_numpy(person.matrices),
        "pred_trans": torch.from_numpy(place)[:, None],
        "frame": torch.arange(COUNT),
    }
    (folder / "hps").mkdir(exist_ok=True)
    np.save(folder / "camera.npy", np.array(camera, dtype=object), allow_pickle=True)
    path = folder / "hps" / "hps_track_0.npy"
    np.save(path, np.array(content, dtype=object), allow_pickle=True)
    return Written(path, content, perspective(person.standing + place[:, None], 700.0, (WIDTH / 2 + 3, HEIGHT / 2)))


def gvhmr(folder: Path, person: Person, pelvis: Array) -> Written:
    """tools/demo/demo.py: torch.save. `pelvis`: SMPL-X's rest pelvis; the joints are SMPL-X's about it."""
    place = np.stack([np.linspace(-0.2, 0.3, COUNT), np.full(COUNT, 0.4), np.full(COUNT, 4.0)], 1)
    K = np.array([[800.0, 0, WIDTH / 2], [0, 800.0, HEIGHT / 2], [0, 0, 1]])
    tensor = torch.from_numpy
    body = {
        "body_pose": tensor(person.poses[:, 1:22].reshape(COUNT, 63)).float(),
        "betas": tensor(person.betas).float(),
        "global_orient": tensor(person.poses[:, 0]).float(),
        "transl": tensor(place).float(),
    }
    content = {
        "smpl_params_global": body,
        "smpl_params_incam": body,
        "K_fullimg": tensor(np.tile(K, (COUNT, 1, 1))).float(),
        "net_outputs": {"static_conf_logits": torch.zeros(1, COUNT, 6)},
    }
    path = folder / "hmr4d_results.pt"
    torch.save(content, path)
    joints = person.standing - person.standing[:, :1] + (place + pelvis)[:, None]
    return Written(path, content, perspective(joints, 800.0))


def sam3d(folder: Path, person: Person, suffix: str = ".pkl") -> Written:
    """A list of frames of persons as process_one_image returns them."""
    from hfb.body.skeleton import JOINT_NAMES

    place = np.array([0.1, 0.3, 4.0])
    pixels = np.full((COUNT, 24, 2), np.nan)
    content = []
    for n in range(COUNT):
        points = np.tile(person.standing[n, :1], (70, 1))
        for name, keypoint in MHR70.items():
            points[keypoint] = person.standing[n, JOINT_NAMES.index(name)]
        seen = perspective((points + place)[None], 900.0, (WIDTH / 2 + 5, HEIGHT / 2 - 4))[0]
        for name, keypoint in MHR70.items():
            pixels[n, JOINT_NAMES.index(name)] = seen[keypoint]
        one = {
            "bbox": np.zeros(4),
            "focal_length": np.float32(900.0),
            "pred_keypoints_3d": points.astype(np.float32),
            "pred_keypoints_2d": seen.astype(np.float32),
            "pred_cam_t": place.astype(np.float32),
            "mask": None,
            "global_rot": np.zeros(3),
        }
        content.append([one])
    path = folder / f"people{suffix}"
    if suffix == ".pkl":
        path.write_bytes(pickle.dumps(content))
    elif suffix == ".npz":
        np.savez(path, data=np.array(content, dtype=object))
    elif suffix == ".npy":
        np.save(path, np.array(content, dtype=object), allow_pickle=True)
    else:
        path.write_text(json.dumps(content, default=lambda one: one.tolist()))
    return Written(path, content, pixels)


def nlf(folder: Path, person: Person, suffix: str = ".pt", joints: int = 24) -> Written:
    """Lists of tensors (people, ...) per frame as detect_smpl_batched returns them, with a frame without people."""
    place, focal_px = np.array([0.1, 0.3, 4.0]), WIDTH / (2 * np.tan(np.radians(55) / 2))
    content: dict[str, list[torch.Tensor]] = {
        name: [] for name in ("boxes", "pose", "betas", "trans", "joints3d", "joints2d", "joint_uncertainties")
    }
    pixels = np.full((COUNT, 24, 2), np.nan)
    for n in range(COUNT):
        points = person.standing[n] + place
        pixels[n] = perspective(points[None], focal_px, (WIDTH / 2, HEIGHT / 2))[0]
        pose = person.poses[n] if joints == 24 else np.concatenate([person.poses[n, :22], np.zeros((33, 3))])
        spare = np.zeros((joints - 24, 3)) + points[0]
        points = np.concatenate([points, spare])
        seen = perspective(points[None], focal_px, (WIDTH / 2, HEIGHT / 2))[0]
        rows = {
            "boxes": np.zeros(5),
            "pose": pose.ravel(),
            "betas": person.betas[n],
            "trans": place,
            "joints3d": 1000 * points,
            "joints2d": seen,
            "joint_uncertainties": np.zeros(joints),
        }
        for name, row in rows.items():
            content[name].append(torch.from_numpy(row).float()[None])
    for name, entries in content.items():
        entries.append(torch.zeros(0, *((joints, 3) if name == "pose" else entries[0].shape[1:])))
    path = folder / f"prediction{suffix}"
    if suffix == ".pt":
        torch.save(content, path)
    else:
        path.write_bytes(pickle.dumps({name: tuple(entries) for name, entries in content.items()}))
    return Written(path, content, pixels)


def _joblib(path: Path, content: Any, pixels: Array) -> Written:
    joblib.dump(content, path)
    return Written(path, content, pixels)


def _pickle(path: Path, content: Any, pixels: Array) -> Written:
    path.write_bytes(pickle.dumps(content))
    return Written(path, content, pixels)


PICKLED: dict[str, Callable[[Any, Path], object]] = {
    "output.pkl": joblib.dump,
    "res.pk": lambda content, path: path.write_bytes(pickle.dumps(content)),
    "demo_clip.pkl": joblib.dump,
    "wham_output.pkl": joblib.dump,
    "hps_track_0.npy": lambda content, path: np.save(path, np.array(content, dtype=object), allow_pickle=True),
    "hmr4d_results.pt": torch.save,
    "prediction.pt": torch.save,
    "people.pkl": lambda content, path: path.write_bytes(pickle.dumps(content)),
}
"""How each system writes its file again."""
