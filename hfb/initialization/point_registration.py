"""Registration of the body to another model's joints or vertices: rotations, translation and shape.

The paper starts from a network's mesh, to which SMPL is fitted (IPNet's registration). Angles are computed in closed
form (`hfb.initialization.limb_angles`) and refined by Adam to the most likely body: Gaussian distances of points, the
anatomical prior, betas of unit variance.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from hfb.body.model import Body, PosedBody, ShapedBody
from hfb.body.skeleton import BONES, JOINT_COUNT
from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.limb_angles import kabsch, rotations_from_joints
from hfb.initialization.registration import natural_pose
from hfb.initialization.torch_adam import Adam
from hfb.priors.anatomy import AnatomicalPrior
from hfb.typing import Array, Bool, Float, Int, Tensor

_LEAST_JOINTS = 6
_JOINT_SPREAD_M = 0.012
_VERTEX_SPREAD_M = 0.02
"""Standard deviation of single vertices; errors of neighbours are correlated, so hundreds of them count less."""
_PRIOR = 0.1
_SHAPE_INSTANTS, _CHUNK = 12, 128
_MOSTLY, _PARTLY, _LEAST_MEMBERS = 0.5, 0.2, 10
"""Skinning weights from which on a vertex moves with a joint, and how many such vertices tell its turn."""
_ENOUGH_VERTICES = 1500
_ROUNDS, _RATE = 3, 0.02
_WORTH_OF_A_MESH = 240
"""Weight of a mesh, that of ten points at every joint."""


@dataclass(frozen=True)
class Registered:
    """A body at S instants.

    Attributes:
        poses: axis-angle [rad].
        translations: SMPL's [m].
        betas: shape of the one person.
        residual_m: mean distance of the points that were known, per instant.
    """

    poses: Float[Tensor, "S 24 3"]
    translations: Float[Tensor, "S 3"]
    betas: Float[Tensor, "K"]
    residual_m: Float[Tensor, "S"]


def register_joints(
    joints: Float[Array, "S 24 3"],
    body: Body,
    betas: Float[Tensor, "K"] | None = None,
    iterations: int = 120,
) -> Registered:
    """Lay the body onto joints.

    Args:
        joints: SMPL's [m] in the target frame, NaN where unknown (`hfb.initialization.joint_layouts`).
        body: the body model.
        betas: held fixed where given.
        iterations: number of Adam's iterations.

    Raises:
        InputError: fewer than six joints are known at some instant.
    """
    dtype = body.template.dtype
    target = torch.as_tensor(joints).to(dtype)
    known = torch.isfinite(target).all(-1)
    if not len(target) or int(known.sum(1).min()) < _LEAST_JOINTS:
        raise InputError(f"fewer than {_LEAST_JOINTS} joints are known; a body needs more to be laid onto them")
    shape = _shape_of_bones(target, known, body) if betas is None else betas.to(dtype)
    natural = axis_angle_to_matrix(torch.cat([torch.zeros(1, 3, dtype=dtype), natural_pose(dtype)]))
    rotations = rotations_from_joints(target, body.rest_joints(shape), natural)
    goal = torch.where(known[..., None], target, torch.zeros_like(target))

    def misfit(shaped: ShapedBody, turns: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        square = ((shaped.joints_of(turns, places) - goal) ** 2).sum(-1) * known
        return square.sum(1) / (2 * _JOINT_SPREAD_M**2), square.detach().sqrt().sum(1) / known.sum(1)

    places = _places(body.shape(shape).joints_of(rotations, target.new_zeros(len(target), 3)), goal, known)
    start = Start(rotations, places, shape, betas is None)
    return fit_points(start, body, misfit, iterations, 0.03)


def register_vertices(
    vertices: Float[Array, "S V 3"], body: Body, betas: Float[Tensor, "K"] | None = None, iterations: int = 100
) -> Registered:
    """Lay the body onto meshes of its own vertices.

    The shape is fitted to a dozen instants, then the others are fitted one by one, so that memory and results do not
    depend on their number.

    Args:
        vertices: vertices of this body's mesh [m].
        body: the body model.
        betas: known shape; fitted when not given.
        iterations: number of Adam's iterations.

    Raises:
        InputError: meshes of another body; only the model that they belong to can be fitted to them.
    """
    if vertices.ndim != 3 or vertices.shape[1] != len(body.template):
        raise InputError(
            f"a mesh of {vertices.shape[1]} vertices is not one of {body.name} with {len(body.template)}: "
            "give the SMPL file it belongs to with --body.model, or a result with joints"
        )
    if not len(vertices) or not np.isfinite(vertices).all():
        raise InputError("a mesh to be registered has vertices that are not finite")
    count = len(vertices)
    some = np.arange(0, len(body.template), max(1, len(body.template) // _ENOUGH_VERTICES))
    vertices, body = vertices[:, some], only_vertices(body, torch.from_numpy(some))
    if betas is None:
        chosen = np.unique(np.linspace(0, count - 1, min(count, _SHAPE_INSTANTS)).round().astype(int))
        first = _laid(vertices[chosen], body, None, iterations)
        if count <= _SHAPE_INSTANTS:
            return first
        betas = first.betas
    parts = [_laid(vertices[at : at + _CHUNK], body, betas, iterations) for at in range(0, count, _CHUNK)]
    return Registered(
        torch.cat([part.poses for part in parts]),
        torch.cat([part.translations for part in parts]),
        betas,
        torch.cat([part.residual_m for part in parts]),
    )


def only_vertices(body: Body, chosen: Int[Tensor, "n"]) -> Body:
    """Return the body with some of its vertices, which are enough to determine the pose; not to be drawn.

    Args:
        body: the body model.
        chosen: numbers of the vertices.
    """
    return replace(
        body,
        template=body.template[chosen],
        shape_directions=body.shape_directions[chosen],
        pose_directions=None if body.pose_directions is None else body.pose_directions[chosen],
        joint_regressor=body.joint_regressor[:, chosen],
        skinning_weights=body.skinning_weights[chosen],
    )


def _laid(vertices: Float[Array, "S V 3"], body: Body, betas: Tensor | None, iterations: int) -> Registered:
    target = torch.as_tensor(vertices).to(body.template.dtype)
    every = torch.ones(target.shape[:2], dtype=torch.bool)
    shape = torch.zeros(body.shape_count, dtype=target.dtype) if betas is None else betas.to(target.dtype)
    for _ in range(_ROUNDS):
        rotations = _part_rotations(target, body, shape)
        if betas is None:
            shape = _shape_given_turns(body, rotations, target, every, lambda posed: posed.vertices, _VERTEX_SPREAD_M)
    still = body.shape(shape).pose(rotations, target.new_zeros(len(target), 3)).vertices

    def misfit(shaped: ShapedBody, turns: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        square = ((shaped.pose(turns, places).vertices - target) ** 2).sum(-1)
        return _WORTH_OF_A_MESH * square.mean(1) / (2 * _VERTEX_SPREAD_M**2), square.detach().sqrt().mean(1)

    start = Start(rotations, _places(still, target, every), shape, betas is None)
    return fit_points(start, body, misfit, iterations, _RATE)


def _part_rotations(target: Float[Tensor, "S V 3"], body: Body, betas: Float[Tensor, "K"]) -> Float[Tensor, "S 24 3 3"]:
    """Return each part's rotation by the vertices that move mostly with its joint."""
    rest = body.shape(betas).vertices
    local: list[Tensor] = []
    world: list[Tensor] = []
    for joint in range(JOINT_COUNT):
        parent = body.parents[joint]
        above = world[parent] if parent >= 0 else torch.eye(3, dtype=target.dtype).expand(len(target), 3, 3)
        own = body.skinning_weights[:, joint]
        members = own > (_MOSTLY if int((own > _MOSTLY).sum()) >= _LEAST_MEMBERS else _PARTLY)
        turn = above
        if int(members.sum()) >= _LEAST_MEMBERS:
            weight = own[members] / own[members].sum()
            before, after = rest[members], target[:, members]
            before, after = before - weight @ before, after - torch.einsum("v,svc->sc", weight, after)[:, None]
            turn = kabsch(before.expand(len(target), -1, -1), after, weight.expand(len(target), -1))
        local.append(above.transpose(1, 2) @ turn)
        world.append(turn)
    return torch.stack(local, 1)


def _shape_given_turns(
    body: Body,
    rotations: Float[Tensor, "S 24 3 3"],
    goal: Float[Tensor, "S n 3"],
    known: Bool[Tensor, "S n"],
    points: Callable[[PosedBody], Tensor],
    spread_m: float,
) -> Float[Tensor, "K"]:
    """Fit betas by least squares: with the rotations known, posed points are linear in betas and translation.

    Args:
        body: body to fit.
        rotations: rotations of each joint in its parent's frame.
        goal: the points' targets [m].
        known: which targets are known.
        points: selects the points of a posed body.
        spread_m: standard deviation of the targets.
    """
    nowhere = goal.new_zeros(len(goal), 3)
    weight = known.to(goal.dtype)[..., None]

    def centred(values: Tensor) -> Tensor:  # the translation drops out
        return ((values - (values * weight).sum(1, keepdim=True) / weight.sum(1, keepdim=True)) * weight).flatten()

    def posed(betas: Tensor) -> Tensor:
        return points(body.shape(betas).pose(rotations, nowhere))

    zero = goal.new_zeros(body.shape_count)
    mean = posed(zero)
    columns = torch.stack([centred(posed(one) - mean) for one in torch.eye(body.shape_count, dtype=goal.dtype)], 1)
    normal = columns.double().T @ columns.double() / spread_m**2 + torch.eye(body.shape_count).double()
    return torch.linalg.solve(normal, columns.double().T @ centred(goal - mean).double() / spread_m**2).to(goal)


def _places(
    found: Float[Tensor, "S n 3"], goal: Float[Tensor, "S n 3"], known: Bool[Tensor, "S n"]
) -> Float[Tensor, "S 3"]:
    """Return the translations that align points on average."""
    weight = known.to(found.dtype)[..., None]
    return ((goal - found) * weight).sum(1) / weight.sum(1)


def _shape_of_bones(joints: Float[Tensor, "S 24 3"], known: Bool[Tensor, "S 24"], body: Body) -> Float[Tensor, "K"]:
    """Return betas by the lengths of bones, which no pose changes: least squares with the betas' prior."""
    parents, children = (torch.tensor([bone[end] for bone in BONES]) for end in (0, 1))
    both = (known[:, parents] & known[:, children]).to(joints.dtype)
    length = torch.nan_to_num((joints[:, children] - joints[:, parents]).norm(dim=-1)) * both
    seen = both.sum(0)
    mean = length.sum(0) / seen.clamp_min(1)
    bones = body.joint_template[children] - body.joint_template[parents]
    directions = body.joint_shape_directions[children] - body.joint_shape_directions[parents]
    rest = bones.norm(dim=-1)
    slope = torch.einsum("bc,bck->bk", bones / rest[:, None].clamp_min(1e-9), directions)
    weight = seen.clamp_max(4) / 4 / _JOINT_SPREAD_M**2
    normal = (slope * weight[:, None]).T @ slope + torch.eye(body.shape_count, dtype=joints.dtype)
    return torch.linalg.solve(normal.double(), ((slope * weight[:, None]).T @ (mean - rest)).double()).to(joints)


@dataclass(frozen=True)
class Start:
    """The start of `fit_points`: turns, positions [m] and betas, which may be held."""

    rotations: Float[Tensor, "S 24 3 3"]
    places: Float[Tensor, "S 3"]
    betas: Float[Tensor, "K"]
    shape_is_free: bool


def fit_points(
    start: Start,
    body: Body,
    misfit: Callable[[ShapedBody, Tensor, Tensor], tuple[Tensor, Tensor]],
    iterations: int,
    rate: float,
) -> Registered:
    """Run Adam on turns relative to the start (no wrap-around at pi), positions and betas; deterministic.

    Args:
        start: turns, places and betas.
        body: the body model.
        misfit: loss of posed joints and vertices.
        iterations: number of Adam's iterations.
        rate: learning rate.
    """
    turns = torch.zeros_like(start.rotations[..., 0]).requires_grad_()
    places = start.places.clone().requires_grad_()
    betas = start.betas.clone().requires_grad_(start.shape_is_free)
    leaves = [(turns, rate), (places, rate / 2), (betas, 2 * rate)]
    optimiser = Adam(leaves if start.shape_is_free else leaves[:2], cosine=(max(1, iterations), rate / 20))
    prior, fixed = AnatomicalPrior(), None if start.shape_is_free else body.shape(start.betas)
    for _ in range(iterations):
        rotations = start.rotations @ axis_angle_to_matrix(turns)
        loss, _ = misfit(fixed or body.shape(betas), rotations, places)
        likely = _PRIOR * prior(matrix_to_axis_angle(rotations[:, 1:]))
        (loss.sum() + likely.sum() + len(places) * (betas * betas).sum() / 20).backward()
        optimiser.step()
    with torch.no_grad():
        rotations = start.rotations @ axis_angle_to_matrix(turns)
        _, residual = misfit(fixed or body.shape(betas), rotations, places)
        return Registered(matrix_to_axis_angle(rotations), places.detach(), betas.detach(), residual)
