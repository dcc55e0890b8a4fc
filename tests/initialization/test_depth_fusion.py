"""One depth of all that is told of it."""

import hashlib
import json
from dataclasses import fields, replace
from importlib import resources

import torch

from hfb.body.skeleton import MIRROR
from hfb.evidence.depth_fusion import DepthCues, fuse_depth, shipped_depth_fusion
from tests.initialization.test_lifting_network import people


def cues(frames: slice, seed: int = 0) -> tuple[DepthCues, torch.Tensor]:
    """Generated gestures of which everything errs by a hand's width: what is told, and the true joints."""
    truth, start, lengths = (one[frames] for one in people(60))
    generator = torch.Generator().manual_seed(seed)

    def erring(size: float) -> torch.Tensor:
        return size * torch.randn(truth.shape, generator=generator) * (torch.arange(24) > 0)[:, None]

    fitted = truth + erring(0.02)
    common = erring(0.05)  # of the joint network, whatever it looks at
    told = DepthCues(
        fitted,
        start,
        lengths,
        torch.full((len(truth),), 0.15),
        torch.full((len(truth),), 1.2),
        truth + common,
        torch.full(truth.shape, 0.03),
        fitted + common,
    )
    return told, truth


def test_what_two_looks_have_in_common_is_no_error() -> None:
    off = {name: [] for name in ("claimed", "lifted", "fused")}
    for frame in range(0, 60, 2):
        told, truth = cues(slice(frame, frame + 2), frame)
        for name, depth in (("claimed", told.claimed[..., 2]), ("lifted", told.lifted()), ("fused", fuse_depth(told))):
            off[name].append((depth - truth[..., 2]).abs().mean())
    claimed, lifted, fused = (float(torch.stack(values).mean()) for values in off.values())
    assert fused < 0.9 * min(claimed, lifted)


def test_time_has_no_arrow_and_a_frame_knows_its_neighbours() -> None:
    told, _ = cues(slice(0, 5))
    backwards = DepthCues(*(getattr(told, one.name).flip(0) for one in fields(told)))
    torch.testing.assert_close(fuse_depth(backwards).flip(0), fuse_depth(told))
    moved = replace(told, claimed=told.claimed + torch.cat([torch.zeros(4, 24, 3), torch.full((1, 24, 3), 0.1)]))
    differs = (fuse_depth(moved) != fuse_depth(told)).any(1)
    assert differs.tolist() == [False, False, False, True, True]


def test_it_knows_neither_place_nor_side() -> None:
    told, _ = cues(slice(0, 2))
    aside = torch.tensor([0.3, -0.2, 5.0])
    moved = replace(told, **{name: getattr(told, name) + aside for name in ("fitted", "start", "claimed", "shown")})
    torch.testing.assert_close(fuse_depth(moved), fuse_depth(told), atol=1e-5, rtol=0)
    torch.testing.assert_close(fuse_depth(told.mirrored())[:, list(MIRROR)], fuse_depth(told))


def test_the_record_is_of_these_weights_and_says_what_they_are_worth() -> None:
    folder = resources.files("hfb.evidence") / "data"
    about = json.loads((folder / "depth_fusion.json").read_text())
    assert hashlib.sha256((folder / "depth_fusion.safetensors").read_bytes()).hexdigest() == about["sha256"]
    assert sum(one.numel() for one in shipped_depth_fusion().parameters()) == about["parameters"]
    for figures in about["held_out"].values():
        assert figures["fused"] < min(figures["fixed shares"], figures["lifted"], figures["claimed"])
