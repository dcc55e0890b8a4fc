"""Human from Blur as one method among others."""

from pathlib import Path

import numpy as np
import torch

from hfb.body.assets import load_default_body
from hfb.config import RunConfig, Stage
from hfb.evaluation.baselines.build import make_method
from hfb.evaluation.baselines.fitted import HumanFromBlur
from hfb.evaluation.baselines.frames import one_by_one
from hfb.evaluation.baselines.method import Method
from hfb.evaluation.baselines.method_spec import METHOD_NAMES, method_spec
from hfb.evaluation.metrics import silhouette_iou
from hfb.fitting.fit import fit
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.priors.anatomy import AnatomicalPrior
from hfb.rendering.backends import make_rasterizer
from tests.evaluation.baselines.cases import bare_case
from tests.scenes import moving_scene


def tiny(name: str) -> RunConfig:
    """A method's configuration, cut down to what a test can wait for."""
    config = method_spec(name).config
    changes = {"stages": (Stage(size_px=32, iterations=15),), "subframes": 4, "texture_px": 16, "settle": 5}
    return config.model_copy(update={"fit": config.fit.model_copy(update=changes)})


def test_it_is_the_fit_and_nothing_else(tmp_path: Path) -> None:
    body, scene, config = load_default_body(), moving_scene(load_default_body(), 32), tiny("best")
    prediction = HumanFromBlur("best", config, False, body)(bare_case(tmp_path), scene.observation, scene.middle)
    alone = fit(scene.observation, scene.middle, body, config.fit, config.seed, AnatomicalPrior())
    assert prediction.motion is not None
    assert np.array_equal(prediction.motion.poses, alone.motion.poses)
    assert prediction.seconds > 0


def test_its_pictures_are_of_its_motion(tmp_path: Path) -> None:
    body, scene = load_default_body(), moving_scene(load_default_body(), 48)
    prediction = HumanFromBlur("paper", tiny("paper"), False, body)(
        bare_case(tmp_path), scene.observation, scene.middle
    )
    assert prediction.pictures is not None
    assert prediction.pictures.shape == (4, 48, 48, 4)
    motion = prediction.motion
    assert motion is not None
    drawn = (prediction.pictures[..., 3] >= 0.5).astype(np.float32)
    rotations = axis_angle_to_matrix(torch.from_numpy(motion.poses).float().unflatten(1, (24, 3)))
    posed = body.shape(torch.from_numpy(motion.betas).float()).pose(rotations, torch.from_numpy(motion.trans).float())
    own = make_rasterizer().render(posed.vertices, None, scene.observation.camera, body.mesh)[..., 3].numpy()
    assert silhouette_iou(drawn, (own >= 0.5).astype(np.float32)) > 0.95
    nearest = np.abs(scene.truth.motion.times_s[None] - motion.times_s[:, None]).argmin(1)
    true = scene.truth.silhouettes[nearest].astype(np.float32)
    # One picture does not tell which way the body moved.
    assert max(silhouette_iou(drawn, each) for each in (true, true[::-1])) > 0.5
    assert prediction.pictures[..., :3].max() <= prediction.pictures[..., 3].max() + 1e-5  # premultiplied


def test_frames_alone_are_the_single_fits_joined(tmp_path: Path) -> None:
    body, scene, config = load_default_body(), moving_scene(load_default_body(), 32, frames=2), tiny("best")
    case = bare_case(tmp_path, 2)
    joined = HumanFromBlur("best-frames", config, True, body)(case, scene.observation, scene.middle)
    together = HumanFromBlur("best", config, False, body)(case, scene.observation, scene.middle)
    second = HumanFromBlur("best", config, False, body)(
        bare_case(tmp_path), one_by_one(scene.observation)[1], scene.middle[1:]
    )
    assert joined.motion is not None
    assert together.motion is not None
    assert second.motion is not None
    assert np.array_equal(joined.motion.joints[4:], second.motion.joints)
    assert np.array_equal(joined.motion.times_s, together.motion.times_s)
    assert joined.motion.frame_index.tolist() == [0] * 4 + [1] * 4
    assert not np.allclose(joined.motion.joints, together.motion.joints, atol=1e-4)
    assert joined.silhouettes is not None
    assert joined.pictures is not None
    assert np.array_equal(joined.silhouettes, joined.pictures[..., 3] >= 0.5)


def test_an_ablation_takes_effect(tmp_path: Path) -> None:
    body, scene, case = load_default_body(), moving_scene(load_default_body(), 32), bare_case(tmp_path)
    motions = [
        HumanFromBlur(name, tiny(name), False, body)(case, scene.observation, scene.middle).motion
        for name in ("best", "best-no-image", "best-no-matte", "best-dibr", "best-degree1", "best-axis-angle")
    ]
    poses = [motion.poses for motion in motions if motion is not None]
    assert len(poses) == 6
    for index, one in enumerate(poses):
        assert np.isfinite(one).all()
        assert all(not np.array_equal(one, other) for other in poses[:index])


def test_every_name_makes_a_method() -> None:
    body = load_default_body()
    for name in METHOD_NAMES:
        if "=" not in name and name != "oracle-mediapipe":  # the networks need not be there
            method = make_method(method_spec(name), body)
            assert isinstance(method, Method)
            assert method.name == name
