"""The motion prior inside a fit: laws of any weights, what the shipped ones know, and bad files."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

import hfb
from hfb.body.assets import load_default_body
from hfb.body.model import ShapedBody
from hfb.datasets.motions.motion_windows import draw_columns
from hfb.datasets.motions.sources import open_motions
from hfb.errors import InputError
from hfb.kernels.dispatch import readable_formulas
from hfb.priors.motion_columns import COLUMN_COUNT
from hfb.priors.motion_measures import measure_motion_prior
from hfb.priors.motion_prior import MotionPrior, load_motion_prior
from hfb.priors.motion_weights import make_networks, read_networks, write_networks
from hfb.priors.training_spec import NetworkSizes
from tests.priors.motions import backwards, moving, seen_by_another_camera

SMALL = NetworkSizes(discriminator_width=16, discriminator_depth=2, corrector_width=16, corrector_depth=2)
MOTIONS = Path(__file__).parents[2] / "../shared/data/cmu_bvh"
DATA = Path(hfb.__file__).parent / "priors" / "data"


@pytest.fixture
def prior() -> MotionPrior:
    torch.manual_seed(0)
    discriminator, corrector = make_networks(SMALL)
    torch.nn.init.normal_(corrector.exit.weight, std=0.05)
    return MotionPrior(discriminator, corrector)


def person(dtype: torch.dtype = torch.float32) -> ShapedBody:
    return load_default_body(dtype).shape(torch.zeros(10, dtype=dtype))


def test_reversing_the_motion_turns_the_odds_round(prior: MotionPrior) -> None:
    motion = moving(frames=2)
    forwards, reverse = prior.reversed_logits(motion), prior.reversed_logits(backwards(motion))
    assert forwards.shape == (2, COLUMN_COUNT)
    assert forwards.abs().max() > 1e-3
    torch.testing.assert_close(reverse, -forwards, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(
        prior.whole_body_logit(backwards(motion)), -prior.whole_body_logit(motion), rtol=1e-4, atol=1e-5
    )


def test_a_still_body_has_no_direction(prior: MotionPrior) -> None:
    motion = moving()
    still = motion.with_coefficients(
        torch.cat([motion.rotation[:, :1], 0 * motion.rotation[:, 1:]], 1),
        torch.cat([motion.translation[:, :1], 0 * motion.translation[:, 1:]], 1),
    )
    assert prior.reversed_logits(still).abs().max() < 1e-4


def test_no_camera_changes_it(prior: MotionPrior) -> None:
    motion = moving(dtype=torch.float64)
    elsewhere, shaped = seen_by_another_camera(motion), person(torch.float64)
    torch.testing.assert_close(prior(elsewhere, shaped), prior(motion, shaped))
    torch.testing.assert_close(prior.reversed_logits(elsewhere), prior.reversed_logits(motion))


def test_gradients_match_finite_differences(prior: MotionPrior) -> None:
    motion, shaped = moving(dtype=torch.float64), person(torch.float64)
    leaf, path = motion.rotation.clone().requires_grad_(), motion.translation.clone().requires_grad_()

    def value(rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
        changed = replace(motion, rotation=rotation, translation=translation)
        return prior(changed, shaped) + 0.01 * prior.reversed_logits(changed).square().sum()

    gradients = torch.autograd.grad(value(leaf, path), (leaf, path))
    generator = torch.Generator().manual_seed(2)
    for index, gradient in enumerate(gradients):
        assert torch.isfinite(gradient).all()
        direction = torch.randn(gradient.shape, generator=generator, dtype=torch.float64)
        moved = [[motion.rotation, motion.translation] for _ in range(2)]
        for values, step in zip(moved, (1e-6, -1e-6), strict=True):
            values[index] = values[index] + step * direction
        numeric = float(value(*moved[0]) - value(*moved[1])) / 2e-6
        assert numeric == pytest.approx(float((gradient * direction).sum()), rel=2e-3)


def test_many_motions_at_once_are_the_motions_one_by_one(prior: MotionPrior) -> None:
    """Also where the networks are first copied, here to another precision, inside the transform."""
    motions = [moving(seed=seed, dtype=torch.float64) for seed in range(3)]
    shaped = person(torch.float64)

    def loss(rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
        return prior(motions[0].with_coefficients(rotation, translation), shaped)

    parts = (torch.stack([getattr(one, part) for one in motions]) for part in ("rotation", "translation"))
    with readable_formulas():
        found = torch.func.vmap(loss)(*parts)
    assert found.tolist() == pytest.approx([prior(one, shaped).item() for one in motions])


def test_a_fit_does_not_change_the_prior_nor_the_shape(prior: MotionPrior) -> None:
    betas = torch.zeros(10, requires_grad=True)
    motion = moving()
    leaf = motion.rotation.clone().requires_grad_()
    before = prior.reversed_logits(motion)
    prior(replace(motion, rotation=leaf), load_default_body().shape(betas)).backward()
    assert leaf.grad is not None
    assert betas.grad is None
    torch.testing.assert_close(prior.reversed_logits(motion), before, rtol=0, atol=0)


def test_the_file_keeps_what_was_learned(tmp_path: Path) -> None:
    torch.manual_seed(1)
    networks = make_networks(SMALL)
    for network in networks:
        network.half().float()  # the file has half precision
    for name in ("one", "two"):
        write_networks(tmp_path / name, *networks, SMALL)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    motion = moving()
    torch.testing.assert_close(
        load_motion_prior(tmp_path / "one").reversed_logits(motion), MotionPrior(*networks).reversed_logits(motion)
    )


@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "text", "other", "sizes", "nan", "huge"])
def test_bad_files_are_told(damage: str, tmp_path: Path) -> None:
    good, path = tmp_path / "good.safetensors", tmp_path / "prior.safetensors"
    write_networks(good, *make_networks(SMALL), SMALL)
    whole = good.read_bytes()
    key = "hfb.motion-prior"
    tensors = load_file(good)
    match damage:
        case "empty":
            path.write_bytes(b"")
        case "cut":
            path.write_bytes(whole[: len(whole) // 2])
        case "text":
            path.write_text("not a network")
        case "other":
            save_file({"a": torch.zeros(3)}, path)
        case "sizes":
            save_file(tensors, path, {key: json.dumps(SMALL.model_dump() | {"discriminator_width": 17})})
        case "nan":
            broken = {name: one * float("nan") for name, one in tensors.items()}
            save_file(broken, path, {key: json.dumps(SMALL.model_dump())})
        case "huge":
            save_file(tensors, path, {key: json.dumps(SMALL.model_dump() | {"discriminator_width": 10**9})})
    with pytest.raises(InputError, match=r"prior\.safetensors.*hfb train-prior"):
        load_motion_prior(path)


def test_shipped_weights_are_the_documented_ones() -> None:
    import hashlib

    about = json.loads((DATA / "motion_prior.json").read_text())
    weights = DATA / "motion_prior.safetensors"
    assert hashlib.sha256(weights.read_bytes()).hexdigest() == about["sha256"]
    assert weights.stat().st_size < 5_000_000
    assert {"trained", "held_out", "tested"} <= about["data"].keys()
    assert not any(name.split("_")[1] in ("09", "10", "13") for name in about["data"]["trained"])
    assert load_motion_prior(None) is load_motion_prior(None)


def test_shipped_prior_knows_the_direction_of_motions_it_never_saw() -> None:
    if not MOTIONS.is_dir():
        pytest.skip("needs the motion capture of ../shared/data")
    about = json.loads((DATA / "motion_prior.json").read_text())
    source = open_motions(MOTIONS, 0)
    held_out = set(about["data"]["held_out"])  # in two conversions, of which the folder has one
    numbers = [number for number, name in enumerate(source.names()) if name in held_out]
    assert len(numbers) >= 10
    columns, exposure_s = draw_columns(source, numbers, 15, 3, {})
    networks = [network.eval() for network in read_networks(DATA / "motion_prior.safetensors")]
    found = measure_motion_prior(*networks, torch.from_numpy(columns), exposure_s, 0)["all"]
    assert found["whole_body"] > 0.8
    assert found["joint"] > 0.7
    assert found["adversarial_reversed"] > 2 * found["adversarial_true"]


def test_walking_forwards_is_likelier_than_backwards() -> None:
    """On the built-in motions, which were not learned from either: people walk to where they look."""
    source = open_motions(None, 0)
    walks = [number for number, name in enumerate(source.names()[:60]) if "walk" in name or "run" in name]
    assert walks
    columns, exposure_s = draw_columns(source, walks[:6], 10, 0, {})
    networks = [network.eval() for network in read_networks(DATA / "motion_prior.safetensors")]
    found = measure_motion_prior(*networks, torch.from_numpy(columns), exposure_s, 0)["all"]
    assert np.isfinite(found["joint_cross_entropy"])
    assert found["whole_body"] > 0.7
