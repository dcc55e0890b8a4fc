"""Joints along their chains and skinning as torch operators, so that autograd, torch.compile and export see them.

The readable formulas they are tested against are in `hfb.body.skinning`.
"""

import torch

from hfb.body import kernels_skinning as kernels
from hfb.shapes import Array, Tensor


def _arrays(*tensors: Tensor) -> list[Array]:
    return [tensor.detach().contiguous().numpy() for tensor in tensors]


@torch.library.custom_op("hfb::place_joints", mutates_args=())
def place_joints(
    rotations: Tensor, translations: Tensor, rest_joints: Tensor, parents: Tensor
) -> tuple[Tensor, Tensor]:
    """World transforms of the rest body (N, 24, 3, 4) and joints (N, 24, 3) [m].

    Args:
        rotations: (N, 24, 3, 3), each in its parent's frame. translations: (N, 3) [m]. rest_joints: (24, 3) [m].
        parents: (24) int32, -1 for the root, which comes first; a parent comes before its children.
    """
    transforms = rotations.new_empty(*rotations.shape[:2], 3, 4)
    joints = rotations.new_empty(*rotations.shape[:2], 3)
    kernels.place(*_arrays(rotations, translations, rest_joints, parents), transforms.numpy(), joints.numpy())
    return transforms, joints


@place_joints.register_fake
def _(rotations: Tensor, translations: Tensor, rest_joints: Tensor, parents: Tensor) -> tuple[Tensor, Tensor]:
    count = rotations.shape[:2]
    return rotations.new_empty(*count, 3, 4), rotations.new_empty(*count, 3)


@torch.library.custom_op("hfb::place_joints_gradient", mutates_args=())
def place_joints_gradient(
    rotations: Tensor, rest_joints: Tensor, parents: Tensor, transforms: Tensor, of_transforms: Tensor,
    of_joints: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
    """Gradients of the rotations, the translations and the rest joints."""
    of_rotations = rotations.new_empty(rotations.shape)
    of_translations, of_rest = rotations.new_empty(rotations.shape[0], 3), rest_joints.new_zeros(rest_joints.shape)
    given = _arrays(rotations, rest_joints, parents, transforms, of_transforms, of_joints)
    kernels.place_gradient(*given, of_rotations.numpy(), of_translations.numpy(), of_rest.numpy())
    return of_rotations, of_translations, of_rest


@place_joints_gradient.register_fake
def _(
    rotations: Tensor, rest_joints: Tensor, parents: Tensor, transforms: Tensor, of_transforms: Tensor,
    of_joints: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
    of_translations = rotations.new_empty(rotations.shape[0], 3)
    return rotations.new_empty(rotations.shape), of_translations, rest_joints.new_empty(rest_joints.shape)


def _keep_chain(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    rotations, _, rest_joints, parents = inputs
    ctx.save_for_backward(rotations, rest_joints, parents, output[0])


def _chain_backward(ctx, of_transforms, of_joints):  # type: ignore[no-untyped-def]
    return *place_joints_gradient(*ctx.saved_tensors, of_transforms, of_joints), None


place_joints.register_autograd(_chain_backward, setup_context=_keep_chain)


@torch.library.custom_op("hfb::skin", mutates_args=())
def skin(transforms: Tensor, rest: Tensor, offsets: Tensor, starts: Tensor, joints: Tensor, weights: Tensor) -> Tensor:
    """Vertices (S, V, 3) [m] of the rest body turned by the transforms of the joints that hold them.

    Args:
        transforms: (S, 24, 3, 4), rest body to world. rest: (V, 3) [m]. offsets: (S, V, 3) pose blend shapes [m], or
            empty. starts, joints, weights: of each vertex in turn, see `hfb.body.skinning.sparse_weights`.
    """
    vertices = rest.new_empty(transforms.shape[0], *rest.shape)
    kernels.skin(*_arrays(transforms, rest, offsets, starts, joints, weights), vertices.numpy())
    return vertices


@skin.register_fake
def _(transforms: Tensor, rest: Tensor, offsets: Tensor, starts: Tensor, joints: Tensor, weights: Tensor) -> Tensor:
    return rest.new_empty(transforms.shape[0], *rest.shape)


@torch.library.custom_op("hfb::skin_gradient", mutates_args=())
def skin_gradient(
    transforms: Tensor, rest: Tensor, offsets: Tensor, starts: Tensor, joints: Tensor, weights: Tensor,
    given: Tensor, wants_rest: bool, wants_offsets: bool,
) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
    """Gradients of the transforms, the rest vertices and the offsets; the last two empty where not asked for."""
    of_transforms = transforms.new_empty(transforms.shape)
    of_rest = rest.new_zeros(rest.shape if wants_rest else (0, 3))
    of_offsets = rest.new_zeros(offsets.shape if wants_offsets else (0, 0, 3))
    arrays = _arrays(transforms, rest, offsets, starts, joints, weights, given)
    kernels.skin_gradient(*arrays, of_transforms.numpy(), of_rest.numpy(), of_offsets.numpy())
    return of_transforms, of_rest, of_offsets


@skin_gradient.register_fake
def _(
    transforms: Tensor, rest: Tensor, offsets: Tensor, starts: Tensor, joints: Tensor, weights: Tensor,
    given: Tensor, wants_rest: bool, wants_offsets: bool,
) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
    of_rest = rest.new_empty(rest.shape if wants_rest else (0, 3))
    of_offsets = rest.new_empty(offsets.shape if wants_offsets else (0, 0, 3))
    return transforms.new_empty(transforms.shape), of_rest, of_offsets


def _keep_skin(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.save_for_backward(*inputs)


def _skin_backward(ctx, given):  # type: ignore[no-untyped-def]
    transforms, rest, offsets = ctx.needs_input_grad[:3]
    gradients = skin_gradient(*ctx.saved_tensors, given, rest, offsets)
    wanted = (gradient if want else None for gradient, want in zip(gradients, (transforms, rest, offsets), strict=True))
    return *wanted, None, None, None


skin.register_autograd(_skin_backward, setup_context=_keep_skin)


def padded(feature: Tensor) -> Tensor:
    """Features of poses, or directions along them, with zeros up to the number that the kernels know: (.., 208)."""
    return torch.nn.functional.pad(feature, (0, kernels.FEATURES - feature.shape[-1]))


@torch.library.custom_op("hfb::blend", mutates_args=())
def blend(feature: Tensor, directions: Tensor) -> Tensor:
    """Pose blend shapes (SMPL's eq. 9) of S poses (S, V, 3) [m].

    Args:
        feature: (S, n), what the poses differ in from the rest pose. directions: (V, 3, 208), `padded`, constants [m].
    """
    count = len(feature)
    fours = torch.nn.functional.pad(padded(feature), (0, 0, 0, -count % 4))  # the kernel works on four poses at once
    offsets = feature.new_empty(len(fours), len(directions), 3)
    kernels.blend(*_arrays(fours, directions), offsets.numpy())
    return offsets[:count]


@blend.register_fake
def _(feature: Tensor, directions: Tensor) -> Tensor:
    return feature.new_empty(feature.shape[0], directions.shape[0], 3)


@torch.library.custom_op("hfb::blend_gradient", mutates_args=())
def blend_gradient(given: Tensor, directions: Tensor, features: int) -> Tensor:
    """Gradient of the features (S, n)."""
    of_feature = given.new_zeros(len(given), kernels.FEATURES)
    kernels.blend_gradient(*_arrays(given, directions), of_feature.numpy())
    return of_feature[:, :features].contiguous()


@blend_gradient.register_fake
def _(given: Tensor, directions: Tensor, features: int) -> Tensor:
    return given.new_empty(given.shape[0], features)


def _keep_blend(ctx, inputs, output) -> None:  # type: ignore[no-untyped-def]
    ctx.features = inputs[0].shape[1]
    ctx.save_for_backward(inputs[1])


def _blend_backward(ctx, given):  # type: ignore[no-untyped-def]
    return blend_gradient(given, *ctx.saved_tensors, ctx.features), None


blend.register_autograd(_blend_backward, setup_context=_keep_blend)
