"""The fusion network: joint depth from four cues.

Before a fit's stages of full size there are four depths of a joint: the joint network's for the frame, the joint
network's for the fit's own image (of which the truth is known, see `hfb.fitting.refine`), the lifting network's, and
the fit's. The best weighting depends on the joint and on the differences between them. All joints share the network's
parameters, so that some thousand fits are enough training data.
"""

from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import torch
from safetensors.torch import load_file
from torch import nn

from hfb.body.skeleton import JOINT_COUNT, MIRROR, PARENT_OR_SELF
from hfb.evidence.lifting_network import lift_depth, match_spread
from hfb.kernels.determinism import one_torch_thread
from hfb.typing import Float, Tensor

FACTS = 33

_WIDTH = 96
_OUTPUT_SCALE = 0.1
"""Scale of a correction in units of the window."""


class DepthFusion(nn.Module):
    """MLP with two hidden layers per joint; joints share all parameters but an embedding.

    Attributes:
        mean: mean of the training inputs, (FACTS,).
        spread: standard deviation of the training inputs, (FACTS,).
    """

    mean: Tensor
    spread: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(FACTS))
        self.register_buffer("spread", torch.ones(FACTS))
        self.joint = nn.Parameter(torch.randn(JOINT_COUNT, _WIDTH))
        self.enter = nn.Linear(FACTS, _WIDTH)
        self.hidden = nn.Linear(_WIDTH, _WIDTH)
        self.forget = nn.Dropout(0.1)
        self.leave = nn.Linear(_WIDTH, 1)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self, facts: Float[Tensor, "*n 24 f"]) -> Float[Tensor, "*n 24"]:
        """Return correction of the lifting network's depth [units].

        Args:
            facts: see `DepthCues.facts`.
        """
        values = nn.functional.gelu(self.enter((facts - self.mean) / self.spread) + self.joint)
        values = self.forget(nn.functional.gelu(self.hidden(values)))
        corrections: Tensor = _OUTPUT_SCALE * self.leave(values)[..., 0]
        return corrections


@dataclass(frozen=True)
class DepthCues:
    """Depth cues of T neighbouring frames, in the units of their windows (`hfb.evidence.joint_network.Window`).

    Attributes:
        fitted: the fit's joints from the pelvis.
        start: joints of the first body.
        lengths: lengths of the fit's bones.
        perspective: `Window.units_to_tangents`.
        unit_m: a unit in metres at the pelvis' distance.
        claimed: the joint network's prediction for the frame.
        scale: Laplace scale of the error of `claimed`.
        shown: the joint network's prediction for the fit's own image.
    """

    fitted: Float[Tensor, "T 24 3"]
    start: Float[Tensor, "T 24 3"]
    lengths: Float[Tensor, "T 24"]
    perspective: Float[Tensor, "T"]
    unit_m: Float[Tensor, "T"]
    claimed: Float[Tensor, "T 24 3"]
    scale: Float[Tensor, "T 24 3"]
    shown: Float[Tensor, "T 24 3"]

    def lifted(self) -> Float[Tensor, "T 24"]:
        """Return depth by the lifting network."""
        return lift_depth(self.fitted, self.start, self.lengths, self.perspective)

    def mirrored(self) -> "DepthCues":
        """Return the cues of the mirror images."""
        mirror, turned = list(MIRROR), self.fitted.new_tensor([-1.0, 1.0, 1.0])
        fitted, start, claimed, shown = (
            one[:, mirror] * turned for one in (self.fitted, self.start, self.claimed, self.shown)
        )
        return DepthCues(
            fitted, start, self.lengths[:, mirror], self.perspective, self.unit_m, claimed, self.scale[:, mirror], shown
        )

    def facts(self, lifted: Float[Tensor, "T 24"]) -> Float[Tensor, "T 24 f"]:
        """Return inputs of `DepthFusion`: differences between the cues, of the joints and of their bones.

        Args:
            lifted: depth by the lifting network, see `lifted`.
        """
        fitted, start, claimed, shown = (
            (one - one[:, :1]).detach().float() for one in (self.fitted, self.start, self.claimed, self.shown)
        )
        start = match_spread(start, fitted[..., :2])
        apart = torch.stack([one[..., 2] - lifted for one in (claimed, shown, fitted, start)], -1)
        across = torch.cat([one[..., :2] - fitted[..., :2] for one in (claimed, shown)], -1)
        own = torch.cat([apart, lifted[..., None], across, fitted], -1)
        bones = own - own[:, list(PARENT_OR_SELF)]
        alone = torch.full_like(self.unit_m, float(len(fitted) == 1))
        of_frames = [one[:, None].expand_as(self.lengths) for one in (self.unit_m, alone)]
        rest = torch.cat([self.scale.log(), torch.stack([self.lengths, *of_frames], -1)], -1).detach().float()
        return torch.cat([own, bones, _of_neighbours(apart[..., :3]), rest], -1)


def _of_neighbours(values: Float[Tensor, "T *n"]) -> Float[Tensor, "T *n"]:
    """Return mean of the frames before and after; a single frame's own values."""
    if len(values) == 1:
        return values
    before, after = values[:-1], values[1:]
    return torch.cat([after[:1], (before[:-1] + after[1:]) / 2, before[-1:]])


def facts_both_ways(cues: DepthCues, lifted: Float[Tensor, "T 24"]) -> Float[Tensor, "2 T 24 f"]:
    """Return inputs for the frames and for their mirror images.

    Args:
        cues: depth cues of T frames.
        lifted: depth by the lifting network.
    """
    return torch.stack([cues.facts(lifted), cues.mirrored().facts(lifted[:, list(MIRROR)])])


def fuse_depth(cues: DepthCues) -> Float[Tensor, "T 24"]:
    """Predict depth behind the pelvis, by the shipped network: the mean for the frames and their mirror images.

    Args:
        cues: depth cues of T frames.
    """
    lifted = cues.lifted()
    with one_torch_thread(), torch.inference_mode():
        seen, reflected = shipped_depth_fusion()(facts_both_ways(cues, lifted))
        fused = lifted + (seen + reflected[:, list(MIRROR)]) / 2
    return fused.clone()  # inference tensors must not enter a graph


@lru_cache(maxsize=1)
def shipped_depth_fusion() -> DepthFusion:
    """Load the network of data/depth_fusion.safetensors; data/depth_fusion.json tells how it was trained."""
    network = DepthFusion()
    with resources.as_file(resources.files("hfb.evidence") / "data" / "depth_fusion.safetensors") as path:
        network.load_state_dict(load_file(path))
    return network.requires_grad_(False).eval()
