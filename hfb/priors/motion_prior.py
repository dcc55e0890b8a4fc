"""The adversarial short motion prior, which judges the direction of motion (the paper's section of that name)."""

import copy
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TypeVar

import torch
from torch import nn

from hfb.body.model import ShapedBody
from hfb.motion.trajectory import Trajectory
from hfb.priors.motion_columns import mean_rest_joints, motion_columns
from hfb.priors.motion_networks import Corrector, Discriminator
from hfb.priors.motion_weights import read_networks
from hfb.typing import Float, Tensor

NetworkT = TypeVar("NetworkT", bound=nn.Module)
_SHIPPED = torch.float32, torch.device("cpu")


class MotionPrior:
    """D and G, trained and frozen, applied in the body's own frame, so that results do not depend on the camera.

    Args:
        discriminator: the networks; their weights are never changed through a prior.
        corrector: the networks; their weights are never changed through a prior.
    """

    def __init__(self, discriminator: Discriminator, corrector: Corrector) -> None:
        self._networks = {_SHIPPED: (_frozen(discriminator), _frozen(corrector))}

    def __call__(self, trajectory: Trajectory, shaped: ShapedBody) -> Float[Tensor, ""]:
        """Return L_A = |G(D(C), C) - C|_1 as the mean over C's entries and the frames; for single frames.

        Args:
            trajectory: polynomials of the motion.
            shaped: the person, whose bones the joints' places follow from. L_A is differentiable in the trajectory and
                treats the shape as given.
        """
        discriminator, corrector = self._in(trajectory.rotation)
        columns = motion_columns(trajectory)
        backwards, unrealistic, _ = discriminator(columns, shaped.joints.detach())
        return (corrector(columns, backwards, unrealistic) - columns).abs().mean()

    def reversed_logits(self, trajectory: Trajectory, shaped: ShapedBody | None = None) -> Float[Tensor, "T 25"]:
        """Log odds per column of C that it runs backwards in time: the 24 joints (the root first), the translation.

        Reversing the whole motion changes all signs. Differentiable in the trajectory.

        Args:
            trajectory: polynomials of the motion.
            shaped: the person; the embedded body's mean shape when not given.
        """
        return self._judged(trajectory, shaped)[0]

    def whole_body_logit(self, trajectory: Trajectory, shaped: ShapedBody | None = None) -> Float[Tensor, "T"]:
        """Log odds that the motion as a whole runs backwards, where its parts agree with each other.

        Args:
            trajectory: polynomials of the motion.
            shaped: the body with its shape.
        """
        return self._judged(trajectory, shaped)[1]

    def _judged(self, trajectory: Trajectory, shaped: ShapedBody | None) -> tuple[Tensor, Tensor]:
        rest = mean_rest_joints().to(trajectory.rotation) if shaped is None else shaped.joints.detach()
        return self._in(trajectory.rotation)[0].odds(motion_columns(trajectory), rest)

    def _in(self, like: Tensor) -> tuple[Discriminator, Corrector]:
        """Return the networks in the precision and on the device of their input."""
        key = like.dtype, like.device
        if key not in self._networks:
            discriminator, corrector = self._networks[_SHIPPED]
            self._networks[key] = _moved(discriminator, like), _moved(corrector, like)
        return self._networks[key]


def load_motion_prior(path: Path | None) -> MotionPrior:
    """Load the shipped prior for None, or one that `hfb train-prior` made.

    Args:
        path: a file of `hfb train-prior`; the shipped one when None.

    Raises:
        InputError: the file is missing, damaged, or holds something else.
    """
    return _shipped() if path is None else MotionPrior(*read_networks(path))


@lru_cache(maxsize=1)
def _shipped() -> MotionPrior:
    """Load the weights of data/motion_prior.safetensors; data/motion_prior.json tells how they were trained."""
    with resources.as_file(resources.files("hfb.priors") / "data" / "motion_prior.safetensors") as path:
        return MotionPrior(*read_networks(path))


def _frozen(network: NetworkT) -> NetworkT:
    return copy.deepcopy(network).to(torch.float32).requires_grad_(False).eval()


def _moved(network: NetworkT, like: Tensor) -> NetworkT:
    """Return a copy of a frozen network; may be called inside `torch.func.vmap`, which forbids to freeze one."""
    return copy.deepcopy(network).to(like.device, like.dtype)
