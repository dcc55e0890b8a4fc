"""Joint evidence: the joint network's predictions for an observation, and the terms that compare a fit with them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib import resources

import numpy as np
import torch
from safetensors.torch import load_file

from hfb.body.height import height_line, height_m
from hfb.body.model import Body
from hfb.body.skeleton import MIRROR
from hfb.evidence.depth_fusion import DepthCues, fuse_depth
from hfb.evidence.joint_network import JointClaim, JointNetwork, Window, in_units, picture_channels
from hfb.evidence.lifting_network import lengths_in_window, lift_depth
from hfb.evidence.robust import evidence_loss
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.kernels.determinism import one_torch_thread
from hfb.kernels.dispatch import compiled, constant
from hfb.kernels.objective import evidence_operators as operators
from hfb.motion.static_pose import FirstBody
from hfb.rendering.observation import Observation
from hfb.typing import Bool, Float, Tensor


@dataclass(frozen=True)
class JointEvidence:
    """Predicted joints of every frame, in the units of that frame's window.

    Attributes:
        windows: one square window per frame.
        middle: joints at u = 1/2.
        scale: Laplace scale of the error of `middle`.
        path: displacement from u = 0 to u = 1. Its sign is the likelier one for one frame, the neighbours' for several.
        log_odds: the network's log odds, from each frame alone, that the sign of `path` is right.
        start: joints of the first body, which the network starts from.
        log_height: logarithm of the standing height [m], by proportions; the same for all frames.
        height_scale: standard deviation of `log_height`.
        height_refined: `log_height` is a fit's, corrected (`hfb.fitting.refine`), instead of the network's own.
        lenses: parameters of the windows for `in_units`; computed from `windows` when not given.
    """

    windows: tuple[Window, ...]
    middle: Float[Tensor, "T 24 3"]
    scale: Float[Tensor, "T 24 3"]
    path: Float[Tensor, "T 24 3"]
    log_odds: Float[Tensor, "T"]
    start: Float[Tensor, "T 24 3"]
    log_height: Float[Tensor, ""]
    height_scale: Float[Tensor, ""]
    height_refined: bool = False
    lenses: Float[Tensor, "T 5"] = field(default_factory=lambda: torch.empty(0, 5))

    def __post_init__(self) -> None:
        if len(self.lenses) == 0:
            lenses = torch.tensor([window.lens() for window in self.windows], dtype=torch.float64)
            object.__setattr__(self, "lenses", lenses)

    def units(self, joints: Float[Tensor, "T *n 24 3"]) -> Float[Tensor, "T *n 24 3"]:
        """Convert joints [m, camera] of every frame to units of its window.

        Args:
            joints: camera coordinates [m].
        """
        lenses = self.lenses.to(joints.dtype)
        return in_units(joints, lenses.view(-1, *(1,) * (joints.ndim - 2), lenses.shape[1]))

    def middle_loss(self, joints: Float[Tensor, "T S 24 3"], share: tuple[float, float, float]) -> Float[Tensor, ""]:
        """Return the distance of the joints at each frame's last instant from the predicted ones of mid-exposure.

        Args:
            joints: camera coordinates [m].
            share: factor of each axis.
        """
        if compiled(joints):
            weights = constant(share, torch.float64, joints.device)
            return operators.off_middle(joints, self.lenses, self.middle, self.scale, weights)[0]
        off = (self.units(joints[:, -1]) - self.middle) / self.scale
        return evidence_loss(off, constant(share, joints.dtype, joints.device))

    def path_loss(self, joints: Float[Tensor, "T S 24 3"], both_ways: bool) -> Float[Tensor, ""]:
        """Return the distance of the joints' displacement, first instant to last but one, from the predicted path.

        Args:
            joints: camera coordinates [m].
            both_ways: the sign of the path is free; the nearer one counts.
        """
        if compiled(joints):
            return operators.off_path(joints, self.lenses, self.path, self.scale, both_ways)[0]
        way = self.units(joints[:, -2]) - self.units(joints[:, 0])
        forth = evidence_loss((way - self.path) / self.scale)
        return torch.minimum(forth, evidence_loss((-way - self.path) / self.scale)) if both_ways else forth

    def height_loss(self, body: Body, betas: Float[Tensor, "10"]) -> Float[Tensor, ""]:
        """Return distance of the height from the predicted one.

        Args:
            body: the body model.
            betas: shape coefficients.
        """
        if compiled(betas):
            mean_m, per_beta = height_line(body)
            claim = self.log_height.item(), self.height_scale.item()
            return operators.off_height(betas, per_beta.to(betas), mean_m, *claim)[0]
        return evidence_loss((height_m(body, betas).log() - self.log_height) / self.height_scale)

    def backwards_logit(self, way: Float[Tensor, "T 24 3"]) -> Float[Tensor, "T"]:
        """Log odds, from each frame alone, that a displacement from u = 0 to u = 1 is opposite to the true one.

        The network's log odds times the cosine between its path and this displacement.

        Args:
            way: displacement in units of the windows.
        """
        return -self.log_odds * torch.cosine_similarity(way.flatten(1), self.path.flatten(1))

    def lift(self, joints: Float[Tensor, "T 24 3"], share: float) -> "JointEvidence":
        """Blend the depth with that of the lifting network, which sees a fit's joints across the view.

        Args:
            joints: the fit's at mid-exposure, camera coordinates [m].
            share: weight of the lifting network.
        """
        perspective = self.lenses[:, 4].to(joints.dtype)
        lengths = lengths_in_window(joints, perspective)
        depth = lift_depth(self.units(joints), self.start, lengths, perspective).to(self.middle)
        return self._with_depth(torch.lerp(self.middle[..., 2], depth, share))

    def fuse(self, rendered: "JointEvidence", joints: Float[Tensor, "T 24 3"]) -> "JointEvidence":
        """Replace the depth by that of the fusion network, which weighs all depth cues.

        Args:
            rendered: the joint network's prediction for a fit's own images.
            joints: the fit's at mid-exposure, camera coordinates [m].
        """
        perspective = self.lenses[:, 4].to(joints.dtype)
        cues = DepthCues(
            self.units(joints),
            self.start,
            lengths_in_window(joints, perspective),
            perspective,
            joints[:, 0, 2] * perspective,
            self.middle,
            self.scale,
            rendered.middle,
        )
        return self._with_depth(fuse_depth(cues))

    def _with_depth(self, depth: Float[Tensor, "T 24"]) -> "JointEvidence":
        return replace(self, middle=torch.cat([self.middle[..., :2], depth[..., None].to(self.middle)], -1))

    def predict_for(self, observation: Observation) -> "JointEvidence":
        """Predict joints for other images in the same windows, starting from the same first bodies.

        Args:
            observation: the same lines of sight, possibly cropped or of another size.
        """
        return _predict(observation, self.windows, self.start)

    def spread_m(self, joints: Float[Tensor, "T 24 3"]) -> Float[Tensor, "T 24"]:
        """Return expected error of the prediction [m], at the distance of these joints [m, camera].

        Args:
            joints: a fit's at mid-exposure, camera coordinates [m].
        """
        unit_m = joints[:, :1, 2] * joints.new_tensor([window.units_to_tangents() for window in self.windows])[:, None]
        return (2 * self.scale.square()).sum(-1).sqrt() * unit_m


def predict_joint_evidence(observation: Observation, first_bodies: Sequence[FirstBody], body: Body) -> JointEvidence:
    """Run the shipped network on every frame, starting from its first body.

    Args:
        observation: whole frames with their mattes.
        first_bodies: one static body per frame.
        body: the body model.

    Raises:
        InputError: a matte is empty.
    """
    mattes = observation.mattes
    windows = tuple(Window.around(matte.numpy(), observation.camera) for matte in mattes)
    starts = [window.to_units(_joints(one, body)) for window, one in zip(windows, first_bodies, strict=True)]
    return _predict(observation, windows, torch.stack(starts).to(mattes))


def _predict(observation: Observation, windows: tuple[Window, ...], start: Float[Tensor, "T 24 3"]) -> JointEvidence:
    plate = observation.plate_linear.numpy()
    predictions: list[tuple[Tensor, ...]] = []
    inputs = zip(observation.frames_linear, observation.mattes, windows, start, strict=True)
    for frame, matte, window, first in inputs:
        image = picture_channels(frame.numpy(), plate, matte.numpy(), window.within(observation.camera))
        claim = _predict_mirrored(torch.from_numpy(image.astype(np.float32)) / 127.5 - 1, first)
        said = claim.joints, claim.log_scale.exp(), claim.path, claim.log_odds, claim.log_height, claim.height_scale
        predictions.append(said)
    # Copied: inference tensors must not enter a graph.
    middle, scale, path, odds, log_height, height_scale = (
        torch.cat(values).clone() for values in zip(*predictions, strict=True)
    )
    forwards = odds >= 0 if len(windows) == 1 else _along_neighbours(windows, middle, path)
    sign = torch.where(forwards, 1.0, -1.0)
    return JointEvidence(
        windows,
        middle,
        scale,
        sign[:, None, None] * path,
        sign * odds,
        start.to(middle),
        # The frames show the same proportions of the same person: their errors are alike, and no less for being many.
        log_height.mean(),
        height_scale.mean(),
    )


def _along_neighbours(
    windows: Sequence[Window], middle: Float[Tensor, "T 24 3"], path: Float[Tensor, "T 24 3"]
) -> Bool[Tensor, "T"]:
    """Return whether each frame's path points along the joints' displacement from frame to frame, across the view."""
    sides = middle.new_tensor([window.side for window in windows])[:, None, None]
    corners = middle.new_tensor([[window.left, window.top] for window in windows])[:, None]
    places = corners + (middle[..., :2] + 1) / 2 * sides
    way = torch.gradient(places, dim=0)[0]
    return (way * path[..., :2]).sum((1, 2)) >= 0


def _predict_mirrored(seen: Float[Tensor, "C h w"], start: Float[Tensor, "24 3"]) -> JointClaim:
    """Return mean of the predictions for the image and for its mirror image."""
    mirror = list(MIRROR)
    across = torch.tensor([-1.0, 1.0, 1.0])
    pictures = torch.stack([seen, seen.flip(-1)]).contiguous(memory_format=torch.channels_last)
    with one_torch_thread(), torch.inference_mode():
        claim = shipped_joint_network()(pictures, torch.stack([start, start[mirror] * across]))
    joints, log_scale, path = (
        torch.stack([values[0], values[1, mirror] * turned])
        for values, turned in ((claim.joints, across), (claim.log_scale, 1.0), (claim.path, across))
    )
    # The sign of a path is free: both are made to agree before they are averaged.
    agree = 1.0 if float((path[0] * path[1]).sum()) >= 0 else -1.0
    log_odds = (claim.log_odds[0] + agree * claim.log_odds[1]) / 2
    path = torch.stack([path[0], agree * path[1]]).mean(0)
    log_height, height_scale = claim.log_height.mean()[None], claim.height_scale.mean()[None]
    return JointClaim(
        joints.mean(0)[None], log_scale.mean(0)[None], path[None], log_odds[None], log_height, height_scale, ()
    )


def _joints(first: FirstBody, body: Body) -> Float[Tensor, "24 3"]:
    """Return joints of a first body, camera coordinates [m]."""
    shaped = body.shape(first.betas.float())
    return shaped.joints_of(axis_angle_to_matrix(first.pose.float())[None], first.translation.float()[None])[0]


@lru_cache(maxsize=1)
def shipped_joint_network() -> JointNetwork:
    """Load the network of data/joints.safetensors; data/joints.json tells how it was trained."""
    network = JointNetwork()
    with resources.as_file(resources.files("hfb.evidence") / "data" / "joints.safetensors") as path:
        state = {name: weights.float() for name, weights in load_file(path).items()}
    network.load_state_dict(state | {name: value for name, value in network.state_dict().items() if "batches" in name})
    network.requires_grad_(False)
    return network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
