"""Pose estimation from a sharp image: by a user's network, or by an initialiser."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch

from hfb.body.model import Body
from hfb.errors import InputError
from hfb.evaluation.baselines.chain_spec import EstimatorLayout
from hfb.evaluation.baselines.estimates import Estimate
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle, six_d_to_matrix
from hfb.initialization.initializer import Initializer
from hfb.initialization.joint_layouts import joints_as_24
from hfb.initialization.person_crop import cut_square, person_square, weak_perspective_place
from hfb.networks.runtimes import Network, Outputs, normalised
from hfb.photometry import srgb_to_linear
from hfb.typing import Array, Float, Tensor

_ENTRIES = {72: "axis-angle", 144: "6D", 216: "matrix"}
_HALF_TURN = (torch.pi, 0.0, 0.0)  # about x: from y up, z towards the viewer, to the camera's axes


@dataclass(frozen=True)
class Sight:
    """One sub-frame as the input of an estimator.

    Attributes:
        person: the box is around this matte's person; the blurred frame's matte does.
    """

    picture_srgb: Float[Array, "H W 3"]
    plate_linear: Float[Tensor, "H W 3"]
    person: Float[Tensor, "H W"]
    camera: PinholeCamera


@runtime_checkable
class Estimator(Protocol):
    """Estimates a body from one image."""

    def __call__(self, sight: Sight, body: Body) -> Estimate:
        """Estimate the body.

        Args:
            sight: the sub-frame.
            body: model of the estimate.

        Raises:
            InputError: no person is found.
        """
        ...


class InitializerEstimator:
    """One of hfb's initialisers; the matte must belong to the same image.

    Args:
        initializer: estimates the body.
    """

    def __init__(self, initializer: Initializer) -> None:
        self._initializer = initializer

    def __call__(self, sight: Sight, body: Body) -> Estimate:
        """See `Estimator`."""
        linear = torch.from_numpy(srgb_to_linear(sight.picture_srgb).astype(np.float32))
        return Estimate.of(self._initializer(linear, sight.plate_linear, sight.person, sight.camera, body))


class NetworkEstimator:
    """A user's network on a square crop around the person.

    Args:
        network: the user's network.
        layout: its inputs and outputs.
    """

    def __init__(self, network: Network, layout: EstimatorLayout) -> None:
        self._network = network
        self._layout = layout

    def __call__(self, sight: Sight, body: Body) -> Estimate:
        """See `Estimator`."""
        layout = self._layout
        left, top, side = person_square(sight.person.numpy(), layout.margin)
        crop = cut_square(sight.picture_srgb, left, top, side, layout.size_px)
        outputs = self._network([normalised(crop, layout.normalisation, layout.channels)])
        if layout.pose is None:
            return Estimate(joints=_joints(outputs, layout, body))
        place = betas = None
        if layout.camera is not None:
            scale, x, y = _numbers(outputs, layout.camera, 3).tolist()
            place = weak_perspective_place(scale, x, y, (left + side / 2, top + side / 2), side, sight.camera)
        if layout.betas is not None and body.betas_space == "smpl":  # another body's betas are meaningless for ours
            betas = torch.from_numpy(_numbers(outputs, layout.betas, 10))
        return Estimate(_pose(outputs, layout), place, betas)


def _numbers(outputs: Outputs, key: int | str, count: int) -> Float[Array, "{count}"]:
    array = outputs.get(key).reshape(-1)
    if len(array) != count:
        raise InputError(f"{outputs.source}: output {key!r} has {len(array)} numbers instead of {count}")
    return array.astype(np.float32)


def _pose(outputs: Outputs, layout: EstimatorLayout) -> Float[Tensor, "24 3"]:
    assert layout.pose is not None
    flat = outputs.get(layout.pose).reshape(-1)
    kind = _ENTRIES.get(flat.size)
    if kind is None:
        raise InputError(
            f"{outputs.source}: a pose of {flat.size} numbers; 72 (axis-angle), 144 (6D) or 216 (matrices)"
        )
    numbers = torch.from_numpy(flat.astype(np.float64)).reshape(24, -1)
    if kind == "axis-angle":
        pose = numbers
    else:
        # A network's matrix is only nearly a rotation: its first two columns are made orthonormal.
        columns = numbers if kind == "6D" else numbers.reshape(24, 3, 3)[..., :2].transpose(1, 2).reshape(24, 6)
        pose = matrix_to_axis_angle(six_d_to_matrix(columns))
    if layout.y_up:
        turn = axis_angle_to_matrix(pose.new_tensor(_HALF_TURN))
        pose = torch.cat([matrix_to_axis_angle(turn @ axis_angle_to_matrix(pose[:1])), pose[1:]])
    return pose.float()


def _joints(outputs: Outputs, layout: EstimatorLayout, body: Body) -> Float[Array, "24 3"]:
    """Return joints from the mesh where it is the body model's own, else the network's joints."""
    key = layout.joints if layout.vertices is None else layout.vertices
    assert key is not None
    points = _points(outputs, key)
    if layout.vertices is not None:
        points = regress_joints(points, body, str(outputs.source))
    points = joints_as_24(points)
    return points * np.array([1.0, -1.0, -1.0]) if layout.y_up else points


def _points(outputs: Outputs, key: int | str) -> Float[Array, "n 3"]:
    array = outputs.get(key)
    if array.size == 0 or array.shape[-1] != 3:
        raise InputError(f"{outputs.source}: output {key!r} has the shape {array.shape} instead of (number, 3)")
    return array.reshape(-1, 3).astype(np.float64)


def regress_joints(vertices: Float[Array, "V 3"], body: Body, source: str) -> Float[Array, "24 3"]:
    """Regress SMPL's joints from a mesh.

    Args:
        vertices: vertices of the mesh [m].
        body: the model whose regressor is used.
        source: origin of the mesh, named in errors.

    Raises:
        InputError: the mesh is not the body model's.
    """
    if len(vertices) != len(body.template):
        raise InputError(
            f"{source}: a mesh of {len(vertices)} vertices is not one of {body.name} with {len(body.template)}; "
            "bring the SMPL file it belongs to (--body), or let the layout name the joints"
        )
    return body.joint_regressor.double().numpy() @ vertices
