"""The lifting network: joint depth from joints across the view, a first guess and bone lengths, without an image.

Its training data is cheap except for some thousand fits, whereas the joint network needs rendered images. Once a fit
has the joints across the view, this network predicts their depth better (2D-to-3D lifting: Martinez et al., A simple
yet effective baseline for 3d human pose estimation, ICCV 2017; here with a first guess and the lengths of the fit's
bones as further inputs: the part of a bone's length that is not across the view is in depth).
"""

from functools import lru_cache
from importlib import resources

import torch
from safetensors.torch import load_file
from torch import nn

from hfb.body.skeleton import JOINT_COUNT, MIRROR, PARENT_OR_SELF
from hfb.kernels.determinism import one_torch_thread
from hfb.typing import Float, Tensor

WIDTH = 768

_BLOCKS = 3
_INPUT_SCALE, _OUTPUT_SCALE = 3.0, 0.3
"""Scales to about unit size: a body is about one unit of its window high."""


class LiftingNetwork(nn.Module):
    """Residual MLP that corrects the inputs of a frame, given a neighbouring frame."""

    def __init__(self) -> None:
        super().__init__()
        self.enter = nn.Linear(2 * (JOINT_COUNT * 12 + 1), WIDTH)
        self.blocks = nn.Sequential(*(_Block(WIDTH) for _ in range(_BLOCKS)))
        self.leave = nn.Sequential(nn.LayerNorm(WIDTH), nn.Linear(WIDTH, JOINT_COUNT * 6))

    def forward(
        self,
        across: Float[Tensor, "N 2 24 2"],
        start: Float[Tensor, "N 2 24 3"],
        lengths: Float[Tensor, "N 2 24"],
        perspective: Float[Tensor, "N 2"],
    ) -> tuple[Float[Tensor, "N 24 3"], Float[Tensor, "N 24 3"]]:
        """Return joints of the first of two frames, and the logarithm of the Laplace scale of each coordinate.

        Args:
            across: x and y from the pelvis in the units of each frame's window (`hfb.evidence.joint_network.Window`);
                where there is one frame alone it is its own neighbour.
            start: first guesses in the same units, which seem as large (`match_spread`).
            lengths: lengths of bones in the same units (`lengths_in_window`).
            perspective: `Window.units_to_tangents`.
        """
        bones, deep = (one - one[:, :, list(PARENT_OR_SELF)] for one in (across, start))
        joints = torch.cat([across, bones, start, deep], -1)
        left = _left_for_depth(bones, start[..., 2] - deep[..., 2] / 2, lengths, perspective)
        facts = torch.cat([joints, lengths[..., None], left[..., None]], -1).flatten(2)
        facts = torch.cat([facts, perspective[..., None]], -1).flatten(1)
        told = self.leave(self.blocks(self.enter(_INPUT_SCALE * facts))).unflatten(1, (JOINT_COUNT, 6))
        guess = torch.cat([across[:, 0], start[:, 0, :, 2:]], -1)
        return guess + _OUTPUT_SCALE * told[..., :3], (told[..., 3:] - 3).clamp(-7, 1)


def _left_for_depth(
    bones: Float[Tensor, "N 2 24 2"],
    middle: Float[Tensor, "N 2 24"],
    lengths: Float[Tensor, "N 2 24"],
    perspective: Float[Tensor, "N 2"],
) -> Float[Tensor, "N 2 24"]:
    """Return the extent of each bone in depth; negative where it is longer across the view than in space.

    Args:
        bones: x and y of the bones' vectors, in window units.
        middle: depth of the bones' middles; bones beyond the pelvis look smaller.
        lengths: lengths of the bones, in window units.
        perspective: `Window.units_to_tangents`.
    """
    seen = bones.norm(dim=-1) * (1 + perspective[..., None] * middle)
    square = lengths.square() - seen.square()
    return square.sign() * (square.abs() + 1e-6).sqrt()


class _Block(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, values: Float[Tensor, "N W"]) -> Float[Tensor, "N W"]:
        return values + self.layers(values)


def bone_lengths(joints: Float[Tensor, "*n 24 3"]) -> Float[Tensor, "*n 24"]:
    """Return the distance from every joint to its parent, in the unit of the joints; 0 for the pelvis.

    Args:
        joints: camera coordinates [m].
    """
    return (joints - joints[..., list(PARENT_OR_SELF), :]).norm(dim=-1)


def lengths_in_window(joints: Float[Tensor, "*n 24 3"], perspective: Float[Tensor, "*n"]) -> Float[Tensor, "*n 24"]:
    """Return lengths of bones in units of windows, an input of `LiftingNetwork`.

    Args:
        joints: camera coordinates [m].
        perspective: `Window.units_to_tangents`.
    """
    return bone_lengths(joints) / (joints[..., 0, 2] * perspective)[..., None]


def match_spread(start: Float[Tensor, "N 24 3"], across: Float[Tensor, "N 24 2"]) -> Float[Tensor, "N 24 3"]:
    """Scale a first guess to the spread of the joints across the view: its true size is unknown.

    Args:
        start: first guess from the pelvis, units of the window.
        across: joints from the pelvis, units of the window.
    """
    spread, wanted = ((one - one.mean(1, keepdim=True)).square().sum((1, 2)).sqrt() for one in (start[..., :2], across))
    return start * (wanted / spread)[:, None, None]


def lift_depth(
    joints: Float[Tensor, "T 24 3"],
    start: Float[Tensor, "T 24 3"],
    lengths: Float[Tensor, "T 24"],
    perspective: Float[Tensor, "T"],
) -> Float[Tensor, "T 24"]:
    """Predict depth behind the pelvis in neighbouring frames, by the shipped network.

    The mean of the predictions for each frame with the one before and the one after, and for their mirror images.

    Args:
        joints: in the units of their windows; only x and y are looked at.
        start: start of the fit.
        lengths: as of `LiftingNetwork`.
        perspective: as of `LiftingNetwork`.
    """
    across, first = ((one - one[:, :1]).detach().float() for one in (joints[..., :2], start))
    first = match_spread(first, across)
    frames = len(across)
    pairs = [(one, one + step) for one in range(frames) for step in (-1, 1) if 0 <= one + step < frames] or [(0, 0)]
    across, first, lengths, perspective = (
        one.detach().float()[torch.tensor(pairs)] for one in (across, first, lengths, perspective)
    )
    mirror, turned = list(MIRROR), first.new_tensor([-1.0, 1.0, 1.0])
    with one_torch_thread(), torch.inference_mode():
        told, _ = shipped_lifting_network()(
            torch.cat([across, across[:, :, mirror] * turned[:2]]),
            torch.cat([first, first[:, :, mirror] * turned]),
            torch.cat([lengths, lengths[:, :, mirror]]),
            torch.cat([perspective, perspective]),
        )
        seen, reflected = told[..., 2].chunk(2)
        depth = (seen + reflected[:, mirror]) / 2
        means = [depth[[row for row, (one, _) in enumerate(pairs) if one == frame]].mean(0) for frame in range(frames)]
    return torch.stack(means).clone()  # inference tensors must not enter a graph


@lru_cache(maxsize=1)
def shipped_lifting_network() -> LiftingNetwork:
    """Load the network of data/lifting.safetensors; data/lifting.json tells how it was trained."""
    network = LiftingNetwork()
    with resources.as_file(resources.files("hfb.evidence") / "data" / "lifting.safetensors") as path:
        network.load_state_dict({name: weights.float() for name, weights in load_file(path).items()})
    return network.requires_grad_(False).eval()
