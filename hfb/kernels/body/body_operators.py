"""Joints along their chains and skinning as torch operators, for autograd, torch.compile and export.

The readable formulas they are tested against are in `hfb.body.skinning`.
"""

from typing import Any

from hfb.kernels.body import body_blend as kernels_blend
from hfb.kernels.body import body_skinning as kernels_skinning
from hfb.kernels.simd import LANES
from hfb.kernels.torch_op import arrays, operator
from hfb.typing import Tensor


@operator("hfb::add_shape")
def add_shape(
    betas: Tensor, template: Tensor, joint_template: Tensor, rows: Tensor, joint_rows: Tensor
) -> tuple[Tensor, Tensor]:
    """Return vertices (V, 3) and joints (24, 3) [m] of the person with some betas in the rest pose (SMPL's eq. 8).

    Args:
        betas: (K), shape coefficients.
        template: (V, 3), vertices with betas of zero [m]; a constant, as all that follow.
        joint_template: (24, 3), joints with betas of zero [m].
        rows: (K, 3 V), displacements per unit of each beta [m].
        joint_rows: (K, 72), of the joints, likewise.
    """
    vertices, joints = template.new_empty(template.shape), joint_template.new_empty(joint_template.shape)
    for start, directions, place in ((template, rows, vertices), (joint_template, joint_rows, joints)):
        kernels_skinning.add_shape(*arrays(betas, start.flatten(), directions), place.view(-1).numpy())
    return vertices, joints


@add_shape.register_fake
def _(
    betas: Tensor, template: Tensor, joint_template: Tensor, rows: Tensor, joint_rows: Tensor
) -> tuple[Tensor, Tensor]:
    return template.new_empty(template.shape), joint_template.new_empty(joint_template.shape)


@operator("hfb::add_shape_gradient")
def add_shape_gradient(rows: Tensor, joint_rows: Tensor, of_vertices: Tensor, of_joints: Tensor) -> Tensor:
    """Return the gradient by the betas.

    Args:
        rows: (K, 3 V), displacements per unit of each beta [m].
        joint_rows: (K, 72), of the joints, likewise.
        of_vertices: gradient by the vertices.
        of_joints: gradient by the joints.
    """
    of_betas = rows.new_empty(rows.shape[0])
    inputs = arrays(rows, joint_rows, of_vertices.flatten(), of_joints.flatten())
    kernels_skinning.add_shape_gradient(*inputs, of_betas.numpy())
    return of_betas


@add_shape_gradient.register_fake
def _(rows: Tensor, joint_rows: Tensor, of_vertices: Tensor, of_joints: Tensor) -> Tensor:
    return rows.new_empty(rows.shape[0])


def _keep_shape(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(*inputs[3:])


def _shape_backward(ctx, of_vertices, of_joints):  # type: ignore[no-untyped-def]
    return add_shape_gradient(*ctx.saved_tensors, of_vertices, of_joints), None, None, None, None


add_shape.register_autograd(_shape_backward, _keep_shape)


@operator("hfb::place_joints")
def place_joints(
    rotations: Tensor, translations: Tensor, rest_joints: Tensor, parents: Tensor
) -> tuple[Tensor, Tensor]:
    """Return world transforms of the rest body (N, 24, 3, 4) and joints (N, 24, 3) [m].

    Args:
        rotations: (N, 24, 3, 3), each in its parent's frame.
        translations: (N, 3) [m].
        rest_joints: (24, 3) [m].
        parents: (24) int32, -1 for the root, which comes first; a parent comes before its children.
    """
    transforms = rotations.new_empty(*rotations.shape[:2], 3, 4)
    joints = rotations.new_empty(*rotations.shape[:2], 3)
    kernels_skinning.place(*arrays(rotations, translations, rest_joints, parents), transforms.numpy(), joints.numpy())
    return transforms, joints


@place_joints.register_fake
def _(rotations: Tensor, translations: Tensor, rest_joints: Tensor, parents: Tensor) -> tuple[Tensor, Tensor]:
    count = rotations.shape[:2]
    return rotations.new_empty(*count, 3, 4), rotations.new_empty(*count, 3)


@operator("hfb::place_joints_gradient")
def place_joints_gradient(
    rotations: Tensor,
    rest_joints: Tensor,
    parents: Tensor,
    transforms: Tensor,
    of_transforms: Tensor,
    of_joints: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the gradients by the rotations, the translations and the rest joints.

    Args:
        rotations: (S, 24, 3, 3), of each joint in its parent's frame.
        rest_joints: (24, 3) [m].
        parents: (24) int32, -1 for the root.
        transforms: (S, 24, 3, 4), rest body to world.
        of_transforms: gradient by the transforms.
        of_joints: gradient by the joints.
    """
    of_rotations = rotations.new_empty(rotations.shape)
    of_translations, of_rest = rotations.new_empty(rotations.shape[0], 3), rest_joints.new_zeros(rest_joints.shape)
    inputs = arrays(rotations, rest_joints, parents, transforms, of_transforms, of_joints)
    kernels_skinning.place_gradient(*inputs, of_rotations.numpy(), of_translations.numpy(), of_rest.numpy())
    return of_rotations, of_translations, of_rest


@place_joints_gradient.register_fake
def _(rotations: Tensor, rest_joints: Tensor, *_: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    of_translations = rotations.new_empty(rotations.shape[0], 3)
    return rotations.new_empty(rotations.shape), of_translations, rest_joints.new_empty(rest_joints.shape)


def _keep_chain(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    rotations, _, rest_joints, parents = inputs
    ctx.save_for_backward(rotations, rest_joints, parents, output[0])


def _chain_backward(ctx, of_transforms, of_joints):  # type: ignore[no-untyped-def]
    return *place_joints_gradient(*ctx.saved_tensors, of_transforms, of_joints), None


place_joints.register_autograd(_chain_backward, _keep_chain)


@operator("hfb::skin")
def skin(transforms: Tensor, rest: Tensor, starts: Tensor, joints: Tensor, weights: Tensor) -> Tensor:
    """Return vertices (S, V, 3) [m] of the rest body moved by the transforms of their joints.

    Args:
        transforms: (S, 24, 3, 4), rest body to world.
        rest: (V, 3) [m].
        starts: starts of each vertex in turn, see `hfb.body.skinning.sparse_weights`.
        joints: joints of each vertex in turn, see `hfb.body.skinning.sparse_weights`.
        weights: weights of each vertex in turn, see `hfb.body.skinning.sparse_weights`.
    """
    vertices = rest.new_empty(transforms.shape[0], *rest.shape)
    kernels_skinning.skin(*arrays(transforms, rest, starts, joints, weights), vertices.numpy())
    return vertices


@skin.register_fake
def _(transforms: Tensor, rest: Tensor, starts: Tensor, joints: Tensor, weights: Tensor) -> Tensor:
    return rest.new_empty(transforms.shape[0], *rest.shape)


@operator("hfb::skin_gradient")
def skin_gradient(
    transforms: Tensor,
    rest: Tensor,
    starts: Tensor,
    joints: Tensor,
    weights: Tensor,
    grad_output: Tensor,
    wants_rest: bool,
) -> tuple[Tensor, Tensor]:
    """Return the gradients by the transforms and by the rest vertices.

    Args:
        transforms: (S, 24, 3, 4), rest body to world.
        rest: (V, 3), rest vertices [m].
        starts: (V + 1), where each vertex's joints and weights begin.
        joints: joint of each skinning weight.
        weights: skinning weights.
        grad_output: (S, V, 3), gradient by the vertices.
        wants_rest: compute the second one, else it is empty.
    """
    of_transforms = transforms.new_empty(transforms.shape)
    of_rest = rest.new_zeros(rest.shape if wants_rest else (0, 3))
    known = arrays(transforms, rest, starts, joints, weights, grad_output)
    kernels_skinning.skin_gradient(*known, of_transforms.numpy(), of_rest.numpy())
    return of_transforms, of_rest


@skin_gradient.register_fake
def _(transforms: Tensor, rest: Tensor, *others: Any) -> tuple[Tensor, Tensor]:
    return transforms.new_empty(transforms.shape), rest.new_empty(rest.shape if others[-1] else (0, 3))


def _keep_skin(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(*inputs)


def _skin_backward(ctx, grad_output):  # type: ignore[no-untyped-def]
    wants_rest = ctx.needs_input_grad[1]
    of_transforms, of_rest = skin_gradient(*ctx.saved_tensors, grad_output, wants_rest)
    return of_transforms, of_rest if wants_rest else None, None, None, None


skin.register_autograd(_skin_backward, _keep_skin)


def _kept(transforms: Tensor, rest: Tensor) -> tuple[int, ...]:
    """Return the shape of the values that `blend_and_skin` saves for its backward pass."""
    return -(-transforms.shape[0] // LANES), rest.shape[0], 3 * LANES


@operator("hfb::blend_and_skin")
def blend_and_skin(
    transforms: Tensor,
    rotations: Tensor,
    rest: Tensor,
    directions: Tensor,
    steps: Tensor,
    starts: Tensor,
    joints: Tensor,
    weights: Tensor,
) -> tuple[Tensor, Tensor]:
    """Apply `skin` to a rest body with pose blend shapes (SMPL's eq. 9): vertices (S, V, 3) [m], and saved values.

    Args:
        transforms: (S, 24, 3, 4), rest body to world.
        rotations: (S, 24, 3, 3), of each joint in its parent's frame, which determine the displacements.
        rest: (V, 3), rest vertices [m].
        directions: (V, 3, 208) in units of `steps`, see `hfb.body.skinning.rounded`; a constant.
        steps: (V, 3) [m]; a constant.
        starts: (V + 1), where each vertex's joints and weights begin.
        joints: joint of each skinning weight.
        weights: skinning weights.
    """
    vertices = rest.new_empty(transforms.shape[0], *rest.shape)
    points = rest.new_empty(_kept(transforms, rest))
    inputs = arrays(transforms, rotations, rest, directions, steps, starts, joints, weights)
    kernels_blend.blend_and_skin(*inputs, points.numpy(), vertices.numpy())
    return vertices, points


@blend_and_skin.register_fake
def _(transforms: Tensor, _rotations: Tensor, rest: Tensor, *_: Tensor) -> tuple[Tensor, Tensor]:
    return rest.new_empty(transforms.shape[0], *rest.shape), rest.new_empty(_kept(transforms, rest))


@operator("hfb::blend_and_skin_gradient")
def blend_and_skin_gradient(
    transforms: Tensor,
    directions: Tensor,
    steps: Tensor,
    starts: Tensor,
    joints: Tensor,
    weights: Tensor,
    points: Tensor,
    grad_output: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the gradients by the transforms, the rotations through their displacements, and the rest vertices.

    Args:
        transforms: (S, 24, 3, 4), rest body to world.
        directions: (V, 3, 208), pose blend shapes in units of `steps`.
        steps: (V, 3) [m].
        starts: (V + 1), where each vertex's joints and weights begin.
        joints: joint of each skinning weight.
        weights: skinning weights.
        points: vertices before skinning, by the forward pass.
        grad_output: (S, V, 3), gradient by the vertices.
    """
    of_transforms = transforms.new_empty(transforms.shape)
    of_rotations = transforms.new_zeros(*transforms.shape[:2], 3, 3)
    of_rest = transforms.new_zeros(grad_output.shape[1:])
    known = arrays(transforms, directions, steps, starts, joints, weights, points, grad_output)
    kernels_blend.blend_and_skin_gradient(*known, of_transforms.numpy(), of_rotations.numpy(), of_rest.numpy())
    return of_transforms, of_rotations, of_rest


@blend_and_skin_gradient.register_fake
def _(transforms: Tensor, *others: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    of_rotations = transforms.new_empty(*transforms.shape[:2], 3, 3)
    return transforms.new_empty(transforms.shape), of_rotations, transforms.new_empty(others[-1].shape[1:])


def _keep_blend(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    transforms, _, _, *constants = inputs
    ctx.save_for_backward(transforms, *constants, output[1])
    ctx.mark_non_differentiable(output[1])


def _blend_backward(ctx, grad_output, _):  # type: ignore[no-untyped-def]
    return *blend_and_skin_gradient(*ctx.saved_tensors, grad_output), None, None, None, None, None


blend_and_skin.register_autograd(_blend_backward, _keep_blend)
