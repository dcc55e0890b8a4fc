"""The body as immutable stages: Body (a file) -> ShapedBody (one person) -> PosedBody (one instant each).

SMPL's layout and formulas (Loper et al., SMPL: A Skinned Multi-Person Linear Model, 2015), written from the paper:
shape blend shapes (eq. 8), pose blend shapes (eq. 9), joints from the rest shape (eq. 10), linear blend
skinning (eq. 2-4). Everything is differentiable in betas, rotations and translations.
"""

from dataclasses import dataclass
from typing import Literal

import torch

from hfb.body.mesh import Mesh
from hfb.body.skeleton import ANCESTORS_BY_DOUBLING, BONES, JOINT_COUNT, PARENTS
from hfb.shapes import Float, Tensor

BetasSpace = Literal["smpl", "hfb"]


@dataclass(frozen=True, eq=False)
class PosedBody:
    """Bodies at S instants, in the frame that the root rotation maps to (the camera's, in hfb) [m]."""

    vertices: Float[Tensor, "S V 3"]
    joints: Float[Tensor, "S 24 3"]


@dataclass(frozen=True, eq=False)
class Body:
    """A body model in the SMPL layout: rest pose T, y up, facing +z, left is +x [m].

    Attributes:
        name: what to call it in reports.
        betas_space: whose shape coefficients these are; ``"hfb"`` betas mean nothing to SMPL, and the reverse.
        licence: terms of the model's file. source: where it came from.
        template: mean rest shape. shape_directions: displacement of each vertex per unit of beta.
        pose_directions: SMPL's pose blend shapes, 9 entries of 23 matrices by the 3 V coordinates; None where the
            model has none.
        joint_regressor: joints of the rest pose as weighted means of its vertices.
        joint_template, joint_shape_directions: the regressor applied to the two above, so joints need no vertices.
        skinning_weights: share of each joint in each vertex; rows add up to 1.
        mesh: triangles, texture coordinates, edges.
    """

    name: str
    betas_space: BetasSpace
    licence: str
    source: str
    template: Float[Tensor, "V 3"]
    shape_directions: Float[Tensor, "V 3 K"]
    pose_directions: Float[Tensor, "207 Vx3"] | None
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

    def to(self, dtype: torch.dtype) -> "Body":
        """The same body in another precision."""
        return Body(
            self.name,
            self.betas_space,
            self.licence,
            self.source,
            self.template.to(dtype),
            self.shape_directions.to(dtype),
            None if self.pose_directions is None else self.pose_directions.to(dtype),
            self.joint_regressor.to(dtype),
            self.joint_template.to(dtype),
            self.joint_shape_directions.to(dtype),
            self.skinning_weights.to(dtype),
            self.mesh.to(dtype),
        )

    def rest_joints(self, betas: Float[Tensor, "K"]) -> Float[Tensor, "24 3"]:
        """Joints of the person with these betas in the rest pose [m]."""
        return self.joint_template + self.joint_shape_directions @ betas

    def shape(self, betas: Float[Tensor, "K"]) -> "ShapedBody":
        """The person with these betas (unit variance each) in the rest pose."""
        vertices = self.template + self.shape_directions @ betas
        joints = self.rest_joints(betas)
        # Where no pose blend shape moves the rest vertices, skinning is one product of (S 3, 24 4) transforms
        # with this constant basis w_vj [x_v, 1]; it is computed once per person.
        homogeneous = torch.cat([vertices.T, vertices.new_ones(1, vertices.shape[0])])
        basis = (self.skinning_weights.T[:, None] * homogeneous).flatten(0, 1)
        return ShapedBody(self, vertices, joints, basis)


def bone_length(joints: Float[Tensor, "24 3"]) -> Float[Tensor, ""]:
    """Total length of the 23 bones [m]: a person's size, whatever the pose."""
    parents, children = ([bone[end] for bone in BONES] for end in (0, 1))
    return (joints[children] - joints[parents]).norm(dim=-1).sum()


@dataclass(frozen=True, eq=False)
class ShapedBody:
    """One person in the rest pose.

    Attributes:
        body: the model it came from.
        vertices, joints: in the rest pose [m].
        skinning_basis: each joint's weight times the homogeneous rest vertex, (joint, xyz1) by vertex.
    """

    body: Body
    vertices: Float[Tensor, "V 3"]
    joints: Float[Tensor, "24 3"]
    skinning_basis: Float[Tensor, "96 V"]

    def pose(self, rotations: Float[Tensor, "S 24 3 3"], translations: Float[Tensor, "S 3"]) -> PosedBody:
        """Skin the person at S instants.

        Args:
            rotations: of each joint in its parent's frame; the root's maps the rest body into the target frame.
            translations: added to the posed vertices [m]; the root turns about its own joint, as in SMPL.
        """
        T_world_joint = self._joint_transforms(rotations, translations)
        joints = T_world_joint[:, :, :3, 3]
        # Rest vertices are given about the origin, not about the joint: subtract the rotated rest joint.
        offset = joints - (T_world_joint[:, :, :3, :3] @ self.joints[:, :, None]).squeeze(-1)
        T_world_rest = torch.cat([T_world_joint[:, :, :3, :3], offset[..., None]], -1)
        coordinates = self._skin(T_world_rest)
        if self.body.pose_directions is not None:
            coordinates = coordinates + self._rotated_pose_offsets(T_world_rest, rotations)
        return PosedBody(coordinates.transpose(1, 2).contiguous(), joints)

    def joints_of(
        self, rotations: Float[Tensor, "S 24 3 3"], translations: Float[Tensor, "S 3"]
    ) -> Float[Tensor, "S 24 3"]:
        """The posed joints alone, without skinning [m]; arguments as in `pose`."""
        return self._joint_transforms(rotations, translations)[:, :, :3, 3]

    def _joint_transforms(
        self, rotations: Float[Tensor, "S 24 3 3"], translations: Float[Tensor, "S 3"]
    ) -> Float[Tensor, "S 24 4 4"]:
        """World transform of every joint: the product of the local ones along its chain (SMPL's eq. 4)."""
        count = rotations.shape[0]
        parents = self.joints.new_tensor([max(parent, 0) for parent in PARENTS], dtype=torch.long)
        bones = torch.cat([self.joints[:1], (self.joints - self.joints[parents])[1:]])
        offsets = bones.expand(count, -1, -1)
        offsets = torch.cat([offsets[:, :1] + translations[:, None], offsets[:, 1:]], 1)
        upper = torch.cat([rotations, offsets[..., None]], -1)
        bottom = upper.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(count, JOINT_COUNT, 1, 4)
        above_root = torch.eye(4, dtype=upper.dtype, device=upper.device).expand(count, 1, 4, 4)
        transforms = torch.cat([torch.cat([upper, bottom], -2), above_root], 1)
        for ancestors in ANCESTORS_BY_DOUBLING:
            index = torch.tensor(ancestors, device=upper.device)
            transforms = transforms.index_select(1, index) @ transforms
        return transforms[:, :JOINT_COUNT]

    def _skin(self, T_world_rest: Float[Tensor, "S 24 3 4"]) -> Float[Tensor, "S 3 V"]:
        """Linear blend skinning of the rest vertices (SMPL's eq. 2) as one product."""
        rows = T_world_rest.transpose(1, 2).flatten(0, 1).flatten(1)
        return (rows @ self.skinning_basis).unflatten(0, (-1, 3))

    def _rotated_pose_offsets(
        self, T_world_rest: Float[Tensor, "S 24 3 4"], rotations: Float[Tensor, "S 24 3 3"]
    ) -> Float[Tensor, "S 3 V"]:
        """Pose blend shapes (SMPL's eq. 9), turned by each vertex's blended rotation.

        Skinning is linear in the rest vertex, so the offset is skinned apart from the shape. Vertices come last
        throughout: products of whole planes are several times faster than V small matrices.
        """
        assert self.body.pose_directions is not None
        identity = torch.eye(3, dtype=rotations.dtype, device=rotations.device)
        feature = (rotations[:, 1:] - identity).flatten(1)
        offsets = (feature @ self.body.pose_directions).unflatten(1, (-1, 3)).transpose(1, 2).contiguous()
        rows = T_world_rest[..., :3].permute(0, 2, 3, 1).flatten(0, 2)
        blended = (rows @ self.body.skinning_weights.T).unflatten(0, (-1, 3, 3))
        return (blended * offsets[:, None]).sum(2)
