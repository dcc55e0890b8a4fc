"""`--init keypoints`: a user's network of 2D keypoints through every chain that looks for first bodies."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.config import ExportConfig, FitConfig, InitConfig, RunConfig, Stage
from hfb.datasets.set_spec import SetSpec
from hfb.errors import InputError
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.flows.benchmark import BenchmarkPlan, run_benchmark
from hfb.flows.fit_image import fit_image
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.joint_layouts import COCO_17
from hfb.initialization.silhouette_fit import silhouette
from hfb.motion.static_pose import FirstBody, load_first_body
from hfb.rendering.backends import make_rasterizer
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.inputs.given_networks import with_pose_network
from hfb.tasks.inputs.inputs import pose_networks
from tests.initialization.keypoint_networks import colour_network, constant_network, paint, simcc_of
from tests.orchestration import Problem, example, true_first_body
from tests.scenes import standing_pose
from tests.small_clips import FRAMES, run_clip, small_clip

BODY = load_default_body()
KNOWN = tuple(name for name in COCO_17 if name in JOINT_NAMES)


def pixels_of(first: FirstBody, camera: PinholeCamera) -> dict[str, np.ndarray]:
    joints = BODY.shape(first.betas).joints_of(axis_angle_to_matrix(first.pose)[None], first.translation[None])[0]
    pixels = camera.project(joints).numpy()
    return {name: pixels[JOINT_NAMES.index(name)] for name in KNOWN}


def standing_network(path: Path) -> Path:
    """Sees a person who stands upright in the middle of every crop."""
    camera = PinholeCamera.from_focal(500.0, 256, 192)
    first = FirstBody(standing_pose(), torch.tensor([0.0, 0.0, 4.0]), torch.zeros(10), "truth")
    matte = silhouette(first, camera, BODY, make_rasterizer()).numpy()
    rows, columns = (np.flatnonzero((matte > 0.1).any(axis)) for axis in (1, 0))
    middle = np.array([columns[0] + columns[-1] + 1, rows[0] + rows[-1] + 1]) / 2
    scale = 256 / 1.25 / (rows[-1] + 1 - rows[0])
    at = pixels_of(first, camera)
    points = np.array([at.get(name, middle - (0, 0.45 * len(rows))) for name in COCO_17])
    return constant_network(path, *simcc_of((points - middle) * scale + (96, 128) - 0.5))


def test_a_fit_from_what_the_network_saw(store: Path, tmp_path: Path) -> None:
    """The example's picture, its joints marked, found through the whole chain; another network is another start."""
    true = load_first_body(true_first_body(tmp_path / "true.npz"))
    frame = cv2.imread(str(example() / "frame_0.png"))[..., ::-1] / np.float32(255)
    height, width = frame.shape[:2]
    camera = PinholeCamera.from_focal(float(np.hypot(height, width)), height, width)
    at = pixels_of(true, camera)
    marked = (255 * paint(frame, at, 3.0)).round().astype(np.uint8)
    cv2.imwrite(str(tmp_path / "marked.png"), marked[..., ::-1])
    weights = colour_network(tmp_path / "rtmpose.onnx", "simcc")
    config = RunConfig(
        init=InitConfig(method="keypoints", weights=weights),
        fit=FitConfig(subframes=2, texture_px=16, stages=(Stage(size_px=32, iterations=3),)),
        export=ExportConfig(films=(), report=False),
    )
    given = [tmp_path / "marked.png"], example() / "background.png", tmp_path / "out"
    result = fit_image(*given, config)
    assert result["first_bodies"] == ["keypoints"]
    assert result["pose_networks"] == ["rtmpose.onnx"]
    assert "keypoints were not calibrated" in result["confidence"]["holds_for"]
    assert "network_0" in result["inputs"]
    first = tmp_path / "out" / "intermediate" / "first_body_0.npz"
    found = pixels_of(load_first_body(first), camera)
    away = np.array([np.hypot(*(found[name] - at[name])) for name in KNOWN])
    assert away.mean() < 0.02 * height, away

    before = first.read_bytes()
    standing_network(weights)
    again = fit_image(*given, config)
    assert again["inputs"]["network_0"] != result["inputs"]["network_0"]
    assert first.read_bytes() != before


def test_a_wrong_network_ends_in_one_sentence(problem: Problem, store: Path, tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "yolo.onnx", np.zeros((1, 84, 8400)))
    config = RunConfig(init=InitConfig(method="keypoints", weights=weights))
    with pytest.raises(InputError, match=r"yolo\.onnx gives \(1, 84, 8400\) for an input of 256 x 192 px"):
        fit_image([problem.frame], problem.background, tmp_path / "out", config)
    assert not (tmp_path / "out" / "result.json").exists()


def test_a_clip_whose_workers_take_the_network_as_a_file(store: Path, tmp_path: Path) -> None:
    made = small_clip()
    weights = standing_network(tmp_path / "rtmpose.onnx")
    words = "--init", "keypoints", "--init-weights", str(weights)
    result = run_clip(made.truth.parent, tmp_path / "out", *words, truth=made.truth)
    assert result["frames"] == FRAMES
    assert result["pose_networks"] == ["rtmpose.onnx"]
    assert result["gaps"] == []


def test_a_benchmark_of_its_starts(store: Path, tmp_path: Path) -> None:
    """The plan's network reaches the workers; cases that they share between them come out the same."""
    weights = standing_network(tmp_path / "rtmpose.onnx")
    plan = BenchmarkPlan(
        spec=SetSpec(set="bt-amass", size_px=64, seed=3, fill="even"),
        count=2,
        methods=(method_spec("static"),),
        start="estimated",
        init=InitConfig(method="keypoints", weights=weights),
    )
    cells = []
    for workers in (1, 2):
        result = run_benchmark(plan, tmp_path / f"out_{workers}", workers)
        assert result["skipped"] == 0
        cells.append(result["methods"]["static"]["all"]["initial_mpjpe_mm"])
    assert cells[0] == cells[1] > 0
    assert "starts: estimated (keypoints)" in (tmp_path / "out_1" / "table.md").read_text()


def test_the_file_counts_where_it_lies_now(tmp_path: Path) -> None:
    """A worker has the network under another name than the option says."""
    here = standing_network(tmp_path / "here.onnx")
    config = InitConfig(method="keypoints", weights=Path("/elsewhere/rtmpose.onnx"))
    assert with_pose_network(config, (FileHandle.of(here),)).weights == here
    handles = pose_networks(InitConfig(method="keypoints", weights=here))
    assert [one.path.name for one in handles] == ["here.onnx"]
