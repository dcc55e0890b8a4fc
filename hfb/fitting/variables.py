"""What is free in a fit, and where it starts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from hfb.body.height import as_tall
from hfb.body.model import PARENT_TABLE, Body, bone_length
from hfb.config import FitConfig
from hfb.fitting.clip_person import ClipPerson
from hfb.kernels.dispatch import compiled
from hfb.kernels.motion.rescale_operators import as_large
from hfb.motion.clock import next_opening, subframe_clock
from hfb.motion.static_pose import FirstBody
from hfb.motion.trajectory import Trajectory, move_towards_neighbours, trajectory_at_rest
from hfb.rendering.observation import Observation
from hfb.typing import Float, Tensor


@dataclass(frozen=True)
class Variables:
    """The free parameters of one fit: leaf tensors that an optimiser changes in place.

    A picture does not tell a tall person far away from a short one nearby: where only the shape changed, the outline
    would grow, and the fit would have to move two parameters in step. With a ``reference`` the person keeps the place
    in the picture whatever the shape, and the shape's gradient is about proportions.

    Attributes:
        trajectory: in metres for a person with the reference's betas, who stands as far away as the real one seems
            large; simply in metres without a reference.
    """

    trajectory: Trajectory
    betas: Float[Tensor, "10"]
    texture: Float[Tensor, "A A 3"]
    reference: Float[Tensor, "10"] | None = None

    def motion(self, body: Body) -> Trajectory:
        """In metres for the person with the present betas; differentiable in both."""
        if self.reference is None:
            return self.trajectory
        if compiled(self.betas):
            like = self.trajectory.translation, self.betas, self.reference
            moved = as_large(*like, body.joint_template, body.shape_rows[1], PARENT_TABLE)
            return self.trajectory.with_coefficients(self.trajectory.rotation, moved)
        before, now = body.rest_joints(self.reference), body.rest_joints(self.betas)
        return self.trajectory.enlarged(bone_length(now) / bone_length(before), before[0], now[0])

    def keep_within(self, config: FitConfig, body: Body) -> None:
        """After a step: colours between black and white, the height that is known."""
        with torch.no_grad():
            self.texture.clamp_(0, 1)
            if config.height_m is not None and self.betas.requires_grad:
                self.betas.copy_(as_tall(self.betas, body, config.height_m))

    def joints_at_middle(self, body: Body) -> Float[Tensor, "T 24 3"]:
        """Of every frame at u = 1/2, camera coordinates [m]; no gradient."""
        with torch.no_grad():
            rotations, translations = self.motion(body).at(self.betas.new_tensor([0.5]))
            return body.shape(self.betas).joints_of(rotations[:, 0], translations[:, 0])

    def vertices(self, body: Body, subframes: int) -> Float[Tensor, "T S V 3"]:
        """Of every frame's sub-frames, camera coordinates [m]; no gradient."""
        with torch.no_grad():
            rotations, translations = self.motion(body).at(subframe_clock(subframes))
            posed = body.shape(self.betas).pose(rotations.flatten(0, 1), translations.flatten(0, 1))
            return posed.vertices.unflatten(0, rotations.shape[:2])

    def in_metres(self, body: Body) -> "Variables":
        """The same person and motion without a reference, as a snapshot."""
        with torch.no_grad():
            return Variables(self.motion(body), self.betas, self.texture).copy()

    def leaves(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """What an optimiser changes: rotation, translation, betas and texture."""
        return self.trajectory.rotation, self.trajectory.translation, self.betas, self.texture

    def take(self, other: "Variables") -> None:
        """Copy another's numbers into these."""
        with torch.no_grad():
            for mine, its in zip(self.leaves(), other.leaves(), strict=True):
                mine.copy_(its)

    def copy(self) -> "Variables":
        """A snapshot that later steps leave alone."""
        trajectory = self.trajectory.with_coefficients(
            self.trajectory.rotation.detach().clone(), self.trajectory.translation.detach().clone()
        )
        return Variables(trajectory, self.betas.detach().clone(), self.texture.detach().clone(), self.reference)


def falling(iteration: int, iterations: int) -> float:
    """Share of the learning rate: from 1 along a half cosine to a twentieth."""
    return 0.05 + 0.95 * (1 + math.cos(math.pi * iteration / iterations)) / 2


def rates(config: FitConfig, rate: float) -> tuple[float, float, float, float]:
    """Learning rates of rotation, translation, betas and texture, where motion has this one."""
    return rate, rate, rate * config.shape_rate, rate * config.texture_rate


def start_variables(
    first_bodies: Sequence[FirstBody],
    observation: Observation,
    config: FitConfig,
    generator: torch.Generator,
    person: ClipPerson | None = None,
) -> Variables:
    """A body at rest per frame (moving towards its neighbours' where there are several), one shape, one texture.

    The texture starts at the mean foreground colour. A single frame cannot tell a motion from its reverse,
    and a body at rest is the saddle between the two: the root gets a small velocity in a random direction.
    A known person's shape and texture are constants: no gradient, no step.
    """
    poses = torch.stack([first.pose for first in first_bodies]).to(observation.mattes)
    translations = torch.stack([first.translation for first in first_bodies]).to(observation.mattes)
    betas = torch.stack([first.betas for first in first_bodies]).to(observation.mattes).mean(0)
    trajectory = trajectory_at_rest(poses, translations, config.degree, config.rotation, config.origin)
    trajectory = move_towards_neighbours(trajectory, next_opening(observation.exposure_s, observation.interval_s))
    if len(first_bodies) == 1 and config.rotation == "quaternion":
        direction = torch.nn.functional.normalize(torch.randn(3, generator=generator), dim=0)
        trajectory.translation[0, 1, :3] += config.root_kick * direction.to(trajectory.translation)
    if person is None:
        texture = mean_foreground(observation).expand(config.texture_px, config.texture_px, 3)
        reference = betas.clone() if config.size_moves_away and config.rotation == "quaternion" else None
        leaves = Variables(trajectory, betas, texture, reference).copy()
        free = [leaves.betas, leaves.texture]
    else:
        leaves = Variables(trajectory, person.betas.to(betas), person.texture.to(betas)).copy()
        free = []
    for leaf in (leaves.trajectory.rotation, leaves.trajectory.translation, *free):
        leaf.requires_grad_(True)
    return leaves


def mean_foreground(observation: Observation) -> Float[Tensor, "3"]:
    """The person's mean colour, linear light: eq. (1) solved for one colour, weighted by the mattes."""
    alpha = observation.mattes[..., None]
    foreground = observation.frames_linear - (1 - alpha) * observation.plate_linear
    colour = (alpha * foreground).sum((0, 1, 2)) / (alpha * alpha).sum((0, 1, 2)).clamp_min(1e-6)
    return colour.clamp(0.0, 1.0)
