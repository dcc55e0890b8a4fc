"""Free variables of a fit, their start values and learning rates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from hfb.body.height import as_tall
from hfb.body.model import PARENT_TABLE, Body, bone_length
from hfb.config import FitConfig
from hfb.fitting.identity import Identity
from hfb.kernels.dispatch import compiled
from hfb.kernels.motion.rescale_operators import as_large
from hfb.motion.clock import next_opening, subframe_clock
from hfb.motion.static_pose import FirstBody
from hfb.motion.trajectory import Trajectory, move_towards_neighbours, trajectory_at_rest
from hfb.rendering.observation import Observation
from hfb.typing import Float, Tensor


@dataclass(frozen=True)
class Variables:
    """Free variables of one fit: leaf tensors that an optimiser changes in place.

    An image does not distinguish a tall person far away from a short one nearby. With a ``reference``, a change of
    shape rescales the translation so that the image size stays: the gradient of the shape is then about proportions.

    Attributes:
        trajectory: polynomials in metres, for a person with the reference's betas where there is a reference.
        betas: shape coefficients.
        texture: linear light.
        reference: betas that the trajectory is expressed for; None: the trajectory is in metres as it is.
        height_m: height that the shape keeps; None: it is free.
    """

    trajectory: Trajectory
    betas: Float[Tensor, "10"]
    texture: Float[Tensor, "A A 3"]
    reference: Float[Tensor, "10"] | None = None
    height_m: float | None = None

    def motion(self, body: Body) -> Trajectory:
        """Return the trajectory in metres for the current betas; differentiable in both.

        Args:
            body: the body model.
        """
        if self.reference is None:
            return self.trajectory
        if compiled(self.betas):
            like = self.trajectory.translation, self.betas, self.reference
            moved = as_large(*like, body.joint_template, body.shape_rows[1], PARENT_TABLE)
            return self.trajectory.with_coefficients(self.trajectory.rotation, moved)
        before, now = body.rest_joints(self.reference), body.rest_joints(self.betas)
        return self.trajectory.enlarged(bone_length(now) / bone_length(before), before[0], now[0])

    def project_(self, body: Body) -> None:
        """Project onto the constraints after a step: colours in [0, 1], a height that is kept.

        Args:
            body: the body model.
        """
        with torch.no_grad():
            self.texture.clamp_(0, 1)
            if self.height_m is not None and self.betas.requires_grad:
                self.betas.copy_(as_tall(self.betas, body, self.height_m))

    def joints_at_middle(self, body: Body) -> Float[Tensor, "T 24 3"]:
        """Return joints of every frame at u = 1/2, camera coordinates [m]; no gradient.

        Args:
            body: the body model.
        """
        with torch.no_grad():
            rotations, translations = self.motion(body).at(self.betas.new_tensor([0.5]))
            return body.shape(self.betas).joints_of(rotations[:, 0], translations[:, 0])

    def vertices(self, body: Body, subframes: int) -> Float[Tensor, "T S V 3"]:
        """Return vertices of every sub-frame, camera coordinates [m]; no gradient.

        Args:
            body: the body model.
            subframes: N.
        """
        with torch.no_grad():
            rotations, translations = self.motion(body).at(subframe_clock(subframes))
            posed = body.shape(self.betas).pose(rotations.flatten(0, 1), translations.flatten(0, 1))
            return posed.vertices.unflatten(0, rotations.shape[:2])

    def in_metres(self, body: Body) -> "Variables":
        """Return a copy whose trajectory is in metres, without a reference.

        Args:
            body: the body model.
        """
        with torch.no_grad():
            return Variables(self.motion(body), self.betas, self.texture).copy()

    def leaves(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return rotation, translation, betas and texture."""
        return self.trajectory.rotation, self.trajectory.translation, self.betas, self.texture

    def copy_from_(self, other: "Variables") -> None:
        """Copy the values of `other` into these tensors.

        Args:
            other: values of the same shapes.
        """
        with torch.no_grad():
            for mine, its in zip(self.leaves(), other.leaves(), strict=True):
                mine.copy_(its)

    def copy(self) -> "Variables":
        """Return a detached copy."""
        trajectory = self.trajectory.with_coefficients(
            self.trajectory.rotation.detach().clone(), self.trajectory.translation.detach().clone()
        )
        return replace(
            self, trajectory=trajectory, betas=self.betas.detach().clone(), texture=self.texture.detach().clone()
        )


def cosine_decay(iteration: int, iterations: int) -> float:
    """Return the factor of the learning rate: from 1 to 1/20 along a half cosine.

    Args:
        iteration: number of the iteration, from 0 on.
        iterations: number of the stage's iterations.
    """
    return 0.05 + 0.95 * (1 + math.cos(math.pi * iteration / iterations)) / 2


def learning_rates(config: FitConfig, rate: float) -> tuple[float, float, float, float]:
    """Return learning rates of rotation, translation, betas and texture.

    Args:
        config: options of the fit.
        rate: rate of the motion.
    """
    return rate, rate, rate * config.shape_rate, rate * config.texture_rate


def start_variables(
    first_bodies: Sequence[FirstBody],
    observation: Observation,
    config: FitConfig,
    generator: torch.Generator,
    identity: Identity | None = None,
    height_m: float | None = None,
) -> Variables:
    """Start values: a body at rest per frame, moving towards its neighbours' where there are several.

    The texture starts at the mean foreground colour. A single frame does not distinguish a motion from its reverse, and
    a body at rest is the saddle point between the two: its root gets a small velocity in a random direction.

    Args:
        first_bodies: one static body per frame; their mean shape is used.
        observation: for the texture's colour and the frames' times.
        config: options of the fit.
        generator: draws the random direction.
        identity: known shape and texture, held constant; both are free when not given.
        height_m: height of the first bodies, which the shape is to keep.
    """
    poses = torch.stack([first.pose for first in first_bodies]).to(observation.mattes)
    translations = torch.stack([first.translation for first in first_bodies]).to(observation.mattes)
    betas = torch.stack([first.betas for first in first_bodies]).to(observation.mattes).mean(0)
    trajectory = trajectory_at_rest(poses, translations, config.degree, config.rotation, config.origin)
    trajectory = move_towards_neighbours(trajectory, next_opening(observation.exposure_s, observation.interval_s))
    if len(first_bodies) == 1 and config.rotation == "quaternion":
        direction = torch.nn.functional.normalize(torch.randn(3, generator=generator), dim=0)
        trajectory.translation[0, 1, :3] += config.initial_root_velocity * direction.to(trajectory.translation)
    if identity is None:
        texture = mean_foreground(observation).expand(config.texture_px, config.texture_px, 3)
        reference = betas.clone() if config.keep_image_size and config.rotation == "quaternion" else None
        leaves = Variables(trajectory, betas, texture, reference, height_m).copy()
        free = [leaves.betas, leaves.texture]
    else:
        leaves = Variables(trajectory, identity.betas.to(betas), identity.texture.to(betas)).copy()
        free = []
    for leaf in (leaves.trajectory.rotation, leaves.trajectory.translation, *free):
        leaf.requires_grad_(True)
    return leaves


def mean_foreground(observation: Observation) -> Float[Tensor, "3"]:
    """Return the mean colour of the person, linear light: eq. (1) solved for one colour, weighted by the mattes.

    Args:
        observation: frames, plate and mattes.
    """
    alpha = observation.mattes[..., None]
    foreground = observation.frames_linear - (1 - alpha) * observation.plate_linear
    colour = (alpha * foreground).sum((0, 1, 2)) / (alpha * alpha).sum((0, 1, 2)).clamp_min(1e-6)
    return colour.clamp(0.0, 1.0)
