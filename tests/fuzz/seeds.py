"""Whole files of every kind that hfb reads from others: what the fuzzer damages. The same bytes each time."""

import json
import pickle
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import joblib
import numpy as np
import torch
from PIL import Image
from safetensors.numpy import save_file

from hfb.interop.writers.bvh import write_bvh
from hfb.motion.motion_file import save_motion
from hfb.motion.sampled import SampledMotion
from hfb.priors.motion_weights import make_networks, write_networks
from hfb.training.priors.training_spec import NetworkSizes
from tests.body.smpl_files import save_npz, save_pickle, smpl_arrays
from tests.datasets.real.videos import calibration_toml, cameras_json, write_trc
from tests.evaluation.baselines.networks import (
    ShiftedCopies,
    moments,
    save_identity_onnx,
    save_linear_onnx,
    save_torchscript,
)
from tests.fuzz.results import write_result
from tests.interop.readers import files
from tests.io.media.test_image_colours import P3, SRGB_CURVE, profile, save
from tests.io.media.test_image_depths import packed_tiff
from tests.io.media.videos import picture, write_video
from tests.priors.test_gmm import make_mixture
from tests.priors.test_vposer import make_vposer

CLIP_TOML = """transfer = "srgb"
video = "walk.mp4"
start_s = 1.5
stop_s = 3.0
background = "plate.png"
[camera]
calibration = "Calib.toml"
name = "cam01"
[exposure]
fps = 30.0
shutter_fraction = 0.6
position = "middle"
[person]
track = "tracks.csv"
id = 3
"""
OPTIONS_TOML = """preset = "best"
seed = 3
[fit]
subframes = 4
stages = [{ size_px = 64, iterations = 10 }, { size_px = 128, iterations = 5 }]
[fit.weights]
image = 1.5
[camera]
focal_px = 900.0
[exposure]
light = "linear"
"""
OPENCV_YAML = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 800., 0., 320., 0., 800., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0.1, -0.05, 0., 0., 0. ]
"""
OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>640</image_width>
<image_height>480</image_height>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows><cols>3</cols><dt>d</dt>
  <data>800. 0. 320. 0. 800. 240. 0. 0. 1.</data></camera_matrix>
</opencv_storage>
"""


@dataclass(frozen=True)
class Seed:
    """One whole file.

    Attributes:
        kind: which readers take it (`tests.fuzz.readers.READERS`). name: its file's name.
    """

    kind: str
    name: str
    data: bytes


@cache
def make_seeds() -> tuple[Seed, ...]:
    """Every kind of file, in a fixed order."""
    with tempfile.TemporaryDirectory(prefix="hfb-seeds-") as folder:
        place = Path(folder)
        makers = (_pictures, _videos, _texts, _archives, _results, _bodies, _priors, _networks, _records, write_result)
        return tuple(
            Seed(kind, path.name, _without_addresses(path.read_bytes()))
            for number, make in enumerate(makers)
            for kind, path in make(_made(place / str(number)))
        )


def _without_addresses(data: bytes) -> bytes:
    """Number tensors, which torch's older files name by their addresses in memory."""
    names: dict[bytes, bytes] = {}

    def number(found: re.Match[bytes]) -> bytes:
        return names.setdefault(found[0], b"%0*d" % (len(found[0]), len(names) + 1))

    return re.sub(rb"(?<![0-9.])[0-9]{14,15}(?![0-9.])", number, data)


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _pictures(folder: Path) -> Iterator[tuple[str, Path]]:
    levels = picture(3)
    noise = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    exif = Image.Exif()
    exif[0x0112] = 6
    exif.get_ifd(0x8769)[0x829A] = 0.02
    for name, options in (
        ("a.png", {"exif": exif}),
        ("a.jpg", {"exif": exif}),
        ("a.webp", {}),
        ("a.bmp", {}),
        ("a.tiff", {"compression": "tiff_deflate"}),
        ("b.tiff", {"compression": "tiff_lzw"}),
    ):
        Image.fromarray(levels).save(folder / name, **options)
        yield "picture", folder / name
    for name in ("deep.png", "deep.tiff"):
        cv2.imwrite(str(folder / name), noise.astype(np.uint16) * 257)
        yield "picture", folder / name
    Image.fromarray(levels).convert("P").save(folder / "palette.png")
    yield "picture", folder / "palette.png"
    yield "picture", packed_tiff(folder / "packed.tiff", noise / 255, 12)
    yield "picture", save(folder / "profile.png", noise, profile(P3, SRGB_CURVE))
    strip = np.dstack([np.concatenate([noise] * 8, 1), np.full((24, 256), 255, np.uint8)])
    cv2.imwrite(str(folder / "sharp_0.png"), strip)
    yield "sharp", folder / "sharp_0.png"


def _videos(folder: Path) -> Iterator[tuple[str, Path]]:
    frames = [picture(number) for number in range(8)]
    for name, codec, pixels in (
        ("a.mp4", "libx264", "yuv420p"),
        ("a.mkv", "libx264", "yuv420p10le"),
        ("a.avi", "mpeg4", "yuv420p"),
        ("a.mov", "mjpeg", "yuvj420p"),
        ("a.ts", "mpeg2video", "yuv420p"),
        ("a.gif", "gif", "rgb8"),
        ("a.webm", "libvpx", "yuv420p"),
    ):
        write_video(folder / name, frames, codec, pixels, container_options={"fflags": "+bitexact"})
        yield "video", folder / name


def _texts(folder: Path) -> Iterator[tuple[str, Path]]:
    for kind, name, text in (
        ("clip", "clip.toml", CLIP_TOML),
        ("options", "options.toml", OPTIONS_TOML),
        ("calibration", "Calib.toml", calibration_toml()),
        ("calibration", "cameras.json", cameras_json()),
        ("calibration", "camera.yaml", OPENCV_YAML),
        ("calibration", "camera.xml", OPENCV_XML),
        ("calibration", "camera.json", json.dumps({"K": [[800, 0, 320], [0, 800, 240], [0, 0, 1]], "dist": [0] * 5})),
        ("tracks", "tracks.csv", "frame,id,left,top,width,height\n" + "".join(f"{n},3,1,2,30,40\n" for n in range(9))),
        ("tracks", "mot.csv", "".join(f"{n},3,1.5,2,30,40,1,-1,-1,-1\n" for n in range(1, 9))),
        ("chains", "chains.toml", '[two]\ndeblurrer = "net.onnx"\nestimator = "matte"\n'),
    ):
        (folder / name).write_text(text)
        yield kind, folder / name
    points = np.random.default_rng(0).normal(0, 1, (6, 3, 3))
    write_trc(folder / "a.trc", points, ("RHip", "LHip", "RKnee"), 25.0)
    yield "markers", folder / "a.trc"


def _motion() -> SampledMotion:
    rng = np.random.default_rng(0)
    return SampledMotion(
        poses=rng.normal(0, 0.2, (6, 72)), trans=rng.normal(0, 1, (6, 3)), betas=np.zeros(10),
        joints=rng.normal(0, 1, (6, 24, 3)), times_s=np.arange(6) / 60, frame_index=np.repeat(np.arange(2), 3),
        K=np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]),
    )  # fmt: skip


def _archives(folder: Path) -> Iterator[tuple[str, Path]]:
    rng, motion = np.random.default_rng(1), _motion()
    save_motion(folder / "motion.npz", motion, "hfb")
    for kind in ("motion", "motions", "result"):
        yield kind, folder / "motion.npz"
    write_bvh(folder / "walk.bvh", motion)
    yield "motions", folder / "walk.bvh"
    arrays: dict[str, tuple[str, dict[str, np.ndarray]]] = {
        "amass.npz": (
            "motions",
            {
                "poses": rng.normal(0, 0.2, (20, 156)),
                "trans": rng.normal(0, 1, (20, 3)),
                "betas": np.zeros(16),
                "mocap_framerate": np.array(60.0),
                "gender": np.array("female"),
            },
        ),
        "first_body.npz": (
            "first body",
            {
                "pose": np.zeros((24, 3)),
                "translation": np.ones(3),
                "betas": np.zeros(10),
                "source": np.array("matte"),
            },
        ),
        "truth.npz": (
            "truth",
            {
                "joints": rng.normal(0, 1, (5, 2, 3)),
                "smpl_joints": np.array([1, 2]),
                "times_s": np.arange(5.0),
                "frame_index": np.arange(5),
                "names": np.array(["RHip", "LHip"]),
            },
        ),
        "tracks.npz": (
            "tracks",
            {
                "frame": np.arange(5),
                "id": np.full(5, 3),
                "box": np.tile([1.0, 2, 30, 40], (5, 1)),
            },
        ),
        "joints3d.npz": (
            "markers",
            {
                "frames": np.arange(4),
                "names": np.array(["RHip", "LHip"]),
                "xyz": rng.normal(0, 1, (4, 2, 3)),
            },
        ),
        "poses.npz": ("stored poses", {"poses": rng.normal(0, 0.2, (8, 72)), "trans": np.zeros((8, 3))}),
        "joints.npz": ("result", {"joints": rng.normal(0, 0.1, (5, 24, 3)) + [0, 0, 4], "K": motion.K}),
    }
    for name, (kind, content) in arrays.items():
        np.savez_compressed(folder / name, **content) if len(name) % 2 else np.savez(folder / name, **content)
        yield kind, folder / name


def _results(folder: Path) -> Iterator[tuple[str, Path]]:
    person = files.Person.some()
    for write in (files.pymaf, files.hybrik, files.phalp, files.wham, files.tram):
        yield "result", write(folder, person).path
    yield "result", files.gvhmr(folder, person, np.zeros((1, 3))).path
    for suffix in (".pkl", ".npz", ".json"):
        yield "result", files.sam3d(folder, person, suffix).path
    for suffix in (".pt", ".pkl"):
        yield "result", files.nlf(folder, person, suffix).path
    content = files.pymaf(folder, person).content
    for name, how in (("packed.pkl", "zlib"), ("packed.pkl.gz", "gzip"), ("packed.pkl.xz", "xz")):
        joblib.dump(content, folder / name, compress=(how, 3))
        yield "result", folder / name


def _bodies(folder: Path) -> Iterator[tuple[str, Path]]:
    arrays = smpl_arrays()
    arrays["posedirs"] = np.round(arrays["posedirs"], 2)
    yield "body", save_npz(folder / "SMPL_NEUTRAL.npz", arrays)
    yield "body", save_pickle(folder / "SMPL_MALE.pkl", arrays)
    step = {"D": np.array([np.eye(6)[:3], np.eye(3)[:2]], dtype=object)}
    np.savez(folder / "mesh_downsampling.npz", **step, allow_pickle=True)
    yield "sampling", folder / "mesh_downsampling.npz"


def _priors(folder: Path) -> Iterator[tuple[str, Path]]:
    mixture = {name: np.asarray(one)[:2] for name, one in make_mixture().items()}
    (folder / "gmm_08.pkl").write_bytes(pickle.dumps(mixture, 2))
    np.savez(folder / "mixture.npz", **mixture)
    save_file({name: one.astype(np.float32) for name, one in mixture.items()}, folder / "mixture.safetensors")
    state = dict(make_vposer(2, hidden=8, latent=4).float().state_dict())
    torch.save(state, folder / "vposer.pt")
    flat = torch.cat([one.flatten().float() for one in state.values()])  # one storage: several are sorted by address
    views = zip(flat.split([one.numel() for one in state.values()]), state.items(), strict=True)
    older = {"state_dict": {name: view.view(one.shape) for view, (name, one) in views}, "epoch": 3}
    torch.save(older, folder / "vposer.ckpt", _use_new_zipfile_serialization=False)
    for name in ("gmm_08.pkl", "mixture.npz", "mixture.safetensors", "vposer.pt", "vposer.ckpt"):
        yield "pose prior", folder / name
    torch.manual_seed(0)
    sizes = NetworkSizes(discriminator_width=16, discriminator_depth=1, corrector_width=16, corrector_depth=1)
    write_networks(folder / "motion.safetensors", *make_networks(sizes), sizes)
    yield "motion prior", folder / "motion.safetensors"


def _networks(folder: Path) -> Iterator[tuple[str, Path]]:
    torch.save({"backbone.weight": torch.zeros(4, 3)}, folder / "weights.pth")
    yield "weights", folder / "weights.pth"
    yield "network", save_linear_onnx(moments(4), 4, folder / "linear.onnx")
    yield "network", save_identity_onnx(folder / "identity.onnx")
    yield "network", save_torchscript(ShiftedCopies(1), folder / "copies.pt")


def _records(folder: Path) -> Iterator[tuple[str, Path]]:
    recipe = {
        "format": 1,
        "command": "fit",
        "config": {"seed": 1},
        "inputs": {},
        "options": {},
        "results": {"a": "0" * 64},
        "files": {"frame_0": {"path": "frame.png", "sha256": "0" * 64, "bytes": 10}},
        "code": "1",
    }
    ledger = {"walk": {"stamp": "a", "status": "done"}, "wave": {"stamp": "b", "status": "failed", "due": 3.5}}
    contents = {
        "recipe.json": ("recipe", recipe),
        "batch.json": ("ledger", ledger),
        "result.json": ("own result", {"mlflow_run_id": "ab" * 16, "config": {"body": {"model": None}}}),
        "case.json": ("case", {"number": 1, "frames": 1, "blur_rate": 0.3, "sharp": [[0, 0, 32, 24]]}),
    }
    for name, (kind, content) in contents.items():
        (folder / name).write_text(json.dumps(content))
        yield kind, folder / name
