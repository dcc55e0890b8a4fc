"""The body as immutable stages: Body (a file) -> ShapedBody (one person) -> PosedBody (one instant each).

SMPL's layout and formulas (Loper et al., SMPL: A Skinned Multi-Person Linear Model, 2015), written from the paper:
shape blend shapes (eq. 8), pose blend shapes (eq. 9), joints from the rest shape (eq. 10), linear blend
skinning (eq. 2-4). Everything is differentiable in betas, rotations and translations.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal

import torch

from hfb.body import skinning
from hfb.body.mesh import Mesh
from hfb.body.skeleton import BONES, PARENTS
from hfb.kernels.body import body_operators as operators
from hfb.kernels.dispatch import compiled, constant
from hfb.typing import Float, Int, Shaped, Tensor

BetasSpace = Literal["smpl", "hfb"]

PARENT_TABLE = torch.tensor(PARENTS, dtype=torch.int32)
_BONE_ENDS = tuple(parent for parent, _ in BONES) + tuple(child for _, child in BONES)


@dataclass(frozen=True, eq=False)
class PosedBody:
    """Bodies at S instants, in the frame that the root rotation maps to (the camera's, in hfb) [m]."""

    vertices: Float[Tensor, "S V 3"]
    joints: Float[Tensor, "S 24 3"]


@dataclass(frozen=True, eq=False)
class Body:
    """A body model in the SMPL layout: rest pose T, y up, facing +z, left is +x [m].

    Attributes:
        name: name in reports.
        betas_space: space of the shape coefficients; ``"hfb"`` betas are meaningless for SMPL, and vice versa.
        licence: terms of the model's file.
        source: origin of the model.
        template: mean rest shape.
        shape_directions: displacement of each vertex per unit of beta.
        pose_directions: SMPL's pose blend shapes: displacement of each vertex per unit of the 9 entries of 23 matrices;
            None where the model has none.
        joint_regressor: joints of the rest pose as weighted means of its vertices.
        joint_template: the regressor applied to the two above, so joints need no vertices.
        joint_shape_directions: the regressor applied to the two above, so joints need no vertices.
        skinning_weights: share of each joint in each vertex; rows add up to 1.
        mesh: triangles, texture coordinates, edges.
    """

    name: str
    betas_space: BetasSpace
    licence: str
    source: str
    template: Float[Tensor, "V 3"]
    shape_directions: Float[Tensor, "V 3 K"]
    pose_directions: Float[Tensor, "V 3 207"] | None
    joint_regressor: Float[Tensor, "24 V"]
    joint_template: Float[Tensor, "24 3"]
    joint_shape_directions: Float[Tensor, "24 3 K"]
    skinning_weights: Float[Tensor, "V 24"]
    mesh: Mesh

    @property
    def parents(self) -> tuple[int, ...]:
        """Parent joint of every joint; -1 for the root."""
        return PARENTS

    @property
    def shape_count(self) -> int:
        """K, the number of betas."""
        return self.shape_directions.shape[2]

    @cached_property
    def sparse_skinning(self) -> tuple[Int[Tensor, "V1"], Int[Tensor, "n"], Float[Tensor, "n"]]:
        """The skinning weights as lists, see `hfb.body.skinning.sparse_weights`."""
        return skinning.sparse_weights(self.skinning_weights)

    @cached_property
    def shape_rows(self) -> tuple[Float[Tensor, "K n"], Float[Tensor, "K m"]]:
        """`shape_directions` and `joint_shape_directions`, all coordinates in one row per beta."""
        vertices, joints = self.shape_directions, self.joint_shape_directions
        return vertices.flatten(0, 1).T.contiguous(), joints.flatten(0, 1).T.contiguous()

    @cached_property
    def pose_rows(self) -> tuple[Float[Tensor, "V 3 208"], Float[Tensor, "V 3"]]:
        """The pose blend shapes, see `hfb.body.skinning.padded`; of no vertices where the model has none."""
        none = self.template.new_empty(0, 3, 207)
        return skinning.padded(none if self.pose_directions is None else self.pose_directions)

    @cached_property
    def rounded_pose_rows(self) -> tuple[Shaped[Tensor, "V 3 208"], Float[Tensor, "V 3"]]:
        """The same in half as many bytes, see `hfb.body.skinning.rounded`."""
        return skinning.rounded(self.pose_rows[0])

    def to(self, dtype: torch.dtype) -> "Body":
        """Return the body in another precision.

        Args:
            dtype: precision of the tensors.
        """
        return replace(self._with_tensors_to(dtype), mesh=self.mesh.to(dtype))

    def on(self, device: torch.device) -> "Body":
        """Return the body in a device's memory; its mesh, which a rasteriser copies for itself, is not moved.

        Args:
            device: device for the tensors.
        """
        return self._with_tensors_to(device)

    def _with_tensors_to(self, there: torch.dtype | torch.device) -> "Body":
        parts = {one.name: getattr(self, one.name) for one in fields(self)}
        moved: dict[str, Any] = {name: one.to(there) for name, one in parts.items() if isinstance(one, Tensor)}
        return replace(self, **moved)

    def rest_joints(self, betas: Float[Tensor, "K"]) -> Float[Tensor, "24 3"]:
        """Return the joints of the person with these betas in the rest pose [m].

        Args:
            betas: shape coefficients, unit variance.
        """
        return self.joint_template + _weighed(self.joint_shape_directions, betas)

    def shape(self, betas: Float[Tensor, "K"]) -> "ShapedBody":
        """Return the person with these betas in the rest pose.

        Args:
            betas: shape coefficients, unit variance.
        """
        if compiled(betas):
            places = operators.add_shape(betas, self.template, self.joint_template, *self.shape_rows)
            return ShapedBody(self, *places)
        vertices = self.template + _weighed(self.shape_directions, betas)
        return ShapedBody(self, vertices, self.rest_joints(betas))


def bone_length(joints: Float[Tensor, "24 3"]) -> Float[Tensor, ""]:
    """Return the total length of the 23 bones [m]: a person's size in any pose.

    Args:
        joints: joints of one pose [m].
    """
    if compiled(joints):
        ends = joints.index_select(0, constant(_BONE_ENDS, torch.long, joints.device)).view(2, -1, 3)
    else:
        ends = (constant(skinning.chosen(_BONE_ENDS, 24), joints.dtype, joints.device) @ joints).view(2, -1, 3)
    return (ends[1] - ends[0]).norm(dim=-1).sum()


@dataclass(frozen=True, eq=False)
class ShapedBody:
    """One person in the rest pose.

    Attributes:
        body: the model it came from.
        vertices: in the rest pose [m].
        joints: in the rest pose [m].
    """

    body: Body
    vertices: Float[Tensor, "V 3"]
    joints: Float[Tensor, "24 3"]

    def pose(self, rotations: Float[Tensor, "S 24 3 3"], translations: Float[Tensor, "S 3"]) -> PosedBody:
        """Skin the person at S instants.

        Args:
            rotations: rotations of each joint in its parent's frame; the root's maps the rest body into the target
                frame.
            translations: added to the posed vertices [m]; the root turns about its own joint, as in SMPL.
        """
        T_world_rest, joints = self._placed(rotations, translations)
        return PosedBody(self._skinned(T_world_rest, rotations), joints)

    def pose_frames(
        self, rotations: Float[Tensor, "T S1 24 3 3"], translations: Float[Tensor, "T S1 3"]
    ) -> tuple[Float[Tensor, "n V 3"], Float[Tensor, "T S1 24 3"]]:
        """Return vertices at all but the last instant of every frame, and joints at all instants [m]; see `pose`.

        Args:
            rotations: rotations of each joint in its parent's frame; the root's maps the rest body to the camera's
                frame.
            translations: SMPL's [m], camera coordinates.
        """
        size = rotations.shape[:2]
        T_world_rest, joints = self._placed(rotations.flatten(0, 1), translations.flatten(0, 1))
        shown = T_world_rest.unflatten(0, size)[:, :-1].flatten(0, 1)
        return self._skinned(shown, rotations[:, :-1].flatten(0, 1)), joints.unflatten(0, size)

    def joints_of(
        self, rotations: Float[Tensor, "S 24 3 3"], translations: Float[Tensor, "S 3"]
    ) -> Float[Tensor, "S 24 3"]:
        """Return the posed joints [m], without skinning.

        Args:
            rotations: rotations of each joint in its parent's frame; the root's maps the rest body to the camera's
                frame.
            translations: SMPL's [m], camera coordinates.
        """
        return self._placed(rotations, translations)[1]

    def _placed(
        self, rotations: Float[Tensor, "S 24 3 3"], translations: Float[Tensor, "S 3"]
    ) -> tuple[Float[Tensor, "S 24 3 4"], Float[Tensor, "S 24 3"]]:
        """Return transforms of the rest body to the world, and the joints."""
        return placed(rotations, translations, self.joints)

    def _skinned(
        self, T_world_rest: Float[Tensor, "S 24 3 4"], rotations: Float[Tensor, "S 24 3 3"]
    ) -> Float[Tensor, "S V 3"]:
        """Return vertices, displaced by pose blend shapes (SMPL's eq. 9) where the model has them, and skinned."""
        body, directions = self.body, self.body.pose_directions
        if compiled(rotations):
            held = body.sparse_skinning
            if directions is None:
                return operators.skin(T_world_rest, self.vertices, *held)
            # Reading them dominates the cost in a fit, which calls this with gradients; its result is posed exactly.
            searched = torch.is_grad_enabled() and (T_world_rest.requires_grad or self.vertices.requires_grad)
            rows = body.rounded_pose_rows if searched else body.pose_rows
            return operators.blend_and_skin(T_world_rest, rotations, self.vertices, *rows, *held)[0]
        offsets = None
        if directions is not None:
            identity = torch.eye(3, dtype=rotations.dtype, device=rotations.device)
            offsets = skinning.blend((rotations[:, 1:] - identity).flatten(1), directions)
        return skinning.skin(T_world_rest, self.vertices, offsets, body.skinning_weights)


def _weighed(directions: Float[Tensor, "*n K"], betas: Float[Tensor, "K"]) -> Float[Tensor, "*n"]:
    """Return the sum of directions times betas.

    With many fits at once a CPU's matrix product sums the gradient in an order that depends on a fit's place among
    them, so there every fit has its own sum.
    """
    if betas.device.type == "cpu" and not compiled(betas):
        return (directions * betas).sum(-1)
    return directions @ betas


def placed(
    rotations: Float[Tensor, "S 24 3 3"], translations: Float[Tensor, "S 3"], rest_joints: Float[Tensor, "24 3"]
) -> tuple[Float[Tensor, "S 24 3 4"], Float[Tensor, "S 24 3"]]:
    """Return transforms of the rest body to the world, and the posed joints [m].

    Args:
        rotations: rotations of each joint in its parent's frame.
        translations: SMPL's [m].
        rest_joints: joints of the rest pose [m].
    """
    if compiled(rotations):
        return operators.place_joints(rotations, translations, rest_joints, PARENT_TABLE)
    return skinning.place_joints(rotations, translations, rest_joints)
