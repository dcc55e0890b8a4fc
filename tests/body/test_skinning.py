"""The compiled joints and skinning against the readable ones: values and gradients, as whole vectors."""

import pytest
import torch

from hfb.body import operators, skinning
from hfb.body.assets import load_default_body
from hfb.body.kernels_skinning import LANES
from hfb.body.skeleton import PARENTS
from hfb.rotations import axis_angle_to_matrix

CHAIN = torch.tensor(PARENTS, dtype=torch.int32)
CHECKS = ("test_schema", "test_autograd_registration", "test_faketensor")


def random(*size: int, dtype: torch.dtype = torch.float64, seed: int = 0) -> torch.Tensor:
    return torch.randn(*size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


def assert_near(found: torch.Tensor, expected: torch.Tensor, relative: float) -> None:
    assert found.dtype == expected.dtype
    assert expected.norm() > 0
    assert (found - expected).norm() <= relative * expected.norm()


@pytest.mark.parametrize("offset", [False, True], ids=["plain", "pose blend shapes"])
@pytest.mark.parametrize(("dtype", "relative"), [(torch.float64, 1e-12), (torch.float32, 5e-6)])
def test_values_and_gradients_are_the_readable_ones(dtype: torch.dtype, relative: float, offset: bool) -> None:
    body, instants = load_default_body(dtype), LANES + 3
    size = (instants, *body.template.shape)
    weigh_vertices, weigh_joints = random(*size, dtype=dtype, seed=4), random(instants, 24, 3, dtype=dtype, seed=5)
    weigh_vertices[:, ::2] = 0  # half of a body is turned away from the camera
    results = []
    for fast in (True, False):
        leaves = [
            axis_angle_to_matrix(0.5 * random(instants, 24, 3, dtype=dtype)), random(instants, 3, dtype=dtype, seed=1),
            body.joint_template.clone(), body.template.clone(), 0.01 * random(*size, dtype=dtype, seed=3),
        ]  # fmt: skip
        rotations, translations, rest_joints, rest, offsets = (leaf.requires_grad_() for leaf in leaves)
        if fast:
            transforms, joints = operators.place_joints(rotations, translations, rest_joints, CHAIN)
            none = rest.new_empty(0, 0, 3)
            vertices = operators.skin(transforms, rest, offsets if offset else none, *body.sparse_skinning)
        else:
            transforms, joints = skinning.place_joints(rotations, translations, rest_joints)
            vertices = skinning.skin(transforms, rest, offsets if offset else None, body.skinning_weights)
        ((vertices * weigh_vertices).sum() + (joints * weigh_joints).sum()).backward()
        gradients = [leaf.grad for leaf in leaves[: 5 if offset else 4]]
        results.append([vertices.detach(), joints.detach(), *gradients])
    for found, expected in zip(*results, strict=True):
        assert_near(found, expected, relative)


def test_gradients_are_finite_differences() -> None:
    weights = torch.softmax(3 * random(5, 24), 1)
    weights = torch.where(weights > 0.05, weights, 0.0)
    held = skinning.sparse_weights(weights)
    transforms, rest, offsets = random(2, 24, 3, 4), random(5, 3, seed=1), random(2, 5, 3, seed=2)
    leaves = [leaf.requires_grad_() for leaf in (transforms, rest, offsets)]
    assert torch.autograd.gradcheck(lambda *given: operators.skin(*given, *held), leaves)
    chain = [leaf.requires_grad_() for leaf in (random(1, 24, 3, 3), random(1, 3, seed=1), random(24, 3, seed=2))]
    assert torch.autograd.gradcheck(lambda *given: operators.place_joints(*given, CHAIN), chain)


@pytest.mark.parametrize(("dtype", "relative"), [(torch.float64, 1e-12), (torch.float32, 5e-6)])
def test_pose_blend_shapes_are_one_product(dtype: torch.dtype, relative: float) -> None:
    directions, weights = random(50, 3, 207, dtype=dtype), random(9, 50, 3, dtype=dtype, seed=1)
    weights[:, ::3], weights[2:5, 1] = 0, 0  # not seen: by nobody, by some
    results = []
    for blend in (operators.blend, skinning.blend):
        feature = random(9, 207, dtype=dtype, seed=2).requires_grad_()
        whole = blend(feature, operators.padded(directions) if blend is operators.blend else directions)
        (whole * weights).sum().backward()
        results.append([whole.detach(), feature.grad])
    for found, expected in zip(*results, strict=True):
        assert_near(found, expected, relative)


def test_operators_are_well_formed() -> None:
    held = skinning.sparse_weights(torch.softmax(random(5, 24), 1))
    given = random(2, 24, 3, 4).requires_grad_(), random(5, 3).requires_grad_()
    for offsets in (torch.empty(0, 0, 3, dtype=torch.float64), random(2, 5, 3).requires_grad_()):
        torch.library.opcheck(operators.skin, (*given, offsets, *held), test_utils=CHECKS)
    chain = random(2, 24, 3, 3).requires_grad_(), random(2, 3).requires_grad_(), random(24, 3).requires_grad_()
    torch.library.opcheck(operators.place_joints, (*chain, CHAIN), test_utils=CHECKS)
    blended = random(2, 207).requires_grad_(), operators.padded(random(5, 3, 207))
    torch.library.opcheck(operators.blend, blended, test_utils=CHECKS)


def test_lists_of_weights_hold_what_the_table_holds() -> None:
    weights = load_default_body().skinning_weights
    starts, joints, shares = skinning.sparse_weights(weights)
    rebuilt = torch.zeros_like(weights)
    vertices = torch.repeat_interleave(torch.arange(len(weights)), starts.diff())
    rebuilt[vertices, joints.long()] = shares
    assert torch.equal(rebuilt, weights)
