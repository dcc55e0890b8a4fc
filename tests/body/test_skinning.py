"""The compiled joints and skinning against the readable ones: values and gradients, as whole vectors."""

from contextlib import nullcontext
from dataclasses import replace

import pytest
import torch

from hfb.body import skinning
from hfb.body.assets import load_default_body
from hfb.body.skeleton import PARENTS
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.kernels.body import body_operators as operators
from hfb.kernels.dispatch import readable_formulas
from hfb.kernels.simd import LANES

CHAIN = torch.tensor(PARENTS, dtype=torch.int32)
CHECKS = ("test_schema", "test_autograd_registration", "test_faketensor")


def random(*size: int, dtype: torch.dtype = torch.float64, seed: int = 0) -> torch.Tensor:
    return torch.randn(*size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


def assert_near(found: torch.Tensor, expected: torch.Tensor, relative: float) -> None:
    assert found.dtype == expected.dtype
    assert expected.norm() > 0
    assert (found - expected).norm() <= relative * expected.norm()


@pytest.mark.parametrize(("dtype", "relative"), [(torch.float64, 1e-13), (torch.float32, 2e-6)])
@pytest.mark.parametrize("left_out", [0, 1, 7])
def test_a_shape_and_its_gradient_are_the_readable_ones(dtype: torch.dtype, relative: float, left_out: int) -> None:
    """Of numbers of vertices that fill the lanes and that do not."""
    body = load_default_body(dtype)
    vertices = len(body.template) - left_out
    body = replace(
        body,
        template=body.template[:vertices],
        shape_directions=body.shape_directions[:vertices],
        skinning_weights=body.skinning_weights[:vertices],
        joint_regressor=body.joint_regressor[:, :vertices],
    )
    pulls = random(vertices, 3, dtype=dtype, seed=1), random(24, 3, dtype=dtype, seed=2)
    results = []
    for readable in (False, True):
        betas = random(10, dtype=dtype).requires_grad_()
        with readable_formulas() if readable else nullcontext():
            shaped = body.shape(betas)
        ((shaped.vertices * pulls[0]).sum() + (shaped.joints * pulls[1]).sum()).backward()
        results.append((shaped.vertices.detach(), shaped.joints.detach(), betas.grad))
    for found, expected in zip(*results, strict=True):
        assert_near(found, expected, relative)
    arguments = (betas, body.template, body.joint_template, *body.shape_rows)
    torch.library.opcheck(operators.add_shape.registered, arguments, test_utils=CHECKS)


def directions_like_smpl(dtype: torch.dtype, vertices: int) -> torch.Tensor:
    """Pose blend shapes of millimetres, of which every vertex has a few of centimetres, as in such files."""
    return 1e-3 * random(vertices, 3, 207, dtype=dtype, seed=6) * random(vertices, 3, 207, dtype=dtype, seed=7) ** 2


@pytest.mark.parametrize("blended", [False, True], ids=["plain", "pose blend shapes"])
@pytest.mark.parametrize(("dtype", "relative"), [(torch.float64, 1e-12), (torch.float32, 5e-6)])
def test_values_and_gradients_are_the_readable_ones(dtype: torch.dtype, relative: float, blended: bool) -> None:
    body, instants = load_default_body(dtype), LANES + 3
    size = (instants, *body.template.shape)
    weigh_vertices, weigh_joints = random(*size, dtype=dtype, seed=4), random(instants, 24, 3, dtype=dtype, seed=5)
    weigh_vertices[:, ::2] = 0  # half of a body is turned away from the camera
    weigh_vertices[2:5, 1] = 0
    numbers, steps = skinning.rounded(directions_like_smpl(dtype, len(body.template)))
    results = []
    for fast in (True, False):
        leaves = [
            axis_angle_to_matrix(0.5 * random(instants, 24, 3, dtype=dtype)),
            random(instants, 3, dtype=dtype, seed=1),
            body.joint_template.clone(),
            body.template.clone(),
        ]
        rotations, translations, rest_joints, rest = (leaf.requires_grad_() for leaf in leaves)
        if fast:
            transforms, joints = operators.place_joints(rotations, translations, rest_joints, CHAIN)
            if blended:
                given = transforms, rotations, rest, numbers, steps
                vertices = operators.blend_and_skin(*given, *body.sparse_skinning)[0]
            else:
                vertices = operators.skin(transforms, rest, *body.sparse_skinning)
        else:
            transforms, joints = skinning.place_joints(rotations, translations, rest_joints)
            feature = (rotations[:, 1:] - torch.eye(3, dtype=dtype)).flatten(1)
            offsets = skinning.blend(feature, numbers[..., :207].to(dtype) * steps[..., None])
            vertices = skinning.skin(transforms, rest, offsets if blended else None, body.skinning_weights)
        ((vertices * weigh_vertices).sum() + (joints * weigh_joints).sum()).backward()
        results.append([vertices.detach(), joints.detach(), *(leaf.grad for leaf in leaves)])
    for found, expected in zip(*results, strict=True):
        assert_near(found, expected, relative)


def test_rounded_directions_lose_next_to_nothing() -> None:
    """Micrometres of a body, and 1e-4 of a gradient, which the whole project allows its fast paths."""
    directions = directions_like_smpl(torch.float32, 500)
    numbers, steps = skinning.rounded(directions)
    assert numbers.dtype == torch.int16
    error = numbers.double() * steps.double()[..., None] - torch.nn.functional.pad(directions, (0, 1)).double()
    assert (error.abs().amax(-1) <= 0.51 * steps).all()  # half a step, and float32's own rounding of 32,767 of them
    feature = (axis_angle_to_matrix(0.5 * random(8, 23, 3)) - torch.eye(3, dtype=torch.float64)).flatten(1)
    offsets = skinning.blend(feature, error[..., :207])
    assert offsets.abs().max() < 1e-5
    gradient = random(8, 500, 3, seed=1).flatten(1)
    lost = gradient @ error.flatten(0, 1)[:, :207]
    assert lost.norm() < 1e-4 * (gradient @ directions.double().flatten(0, 1)).norm()
    nothing, _ = skinning.rounded(torch.zeros(2, 3, 207))
    assert not nothing.any()
    for exact, ones in (skinning.padded(directions), skinning.rounded(directions.double())):
        assert torch.equal(exact[..., :207].double(), directions.double())
        assert (ones == 1).all()


def test_a_body_is_exact_where_no_gradient_is_asked_for() -> None:
    """And rounded, which is half as much to read, where a fit asks for one."""
    body = load_default_body()
    body = replace(body, pose_directions=directions_like_smpl(torch.float32, len(body.template)))
    shaped = body.shape(torch.zeros(10))
    rotations = axis_angle_to_matrix(0.5 * random(2, 24, 3)).float()
    exact = body.to(torch.float64).shape(torch.zeros(10, dtype=torch.float64))
    exact = exact.pose(rotations.double(), torch.zeros(2, 3, dtype=torch.float64)).vertices
    for asked, farthest_m in ((False, 2e-6), (True, 1e-5)):
        vertices = shaped.pose(rotations.clone().requires_grad_(asked), torch.zeros(2, 3)).vertices
        assert vertices.requires_grad == asked
        assert (vertices.detach() - exact).abs().max() < farthest_m


def test_gradients_are_finite_differences() -> None:
    weights = torch.softmax(3 * random(5, 24), 1)
    weights = torch.where(weights > 0.05, weights, 0.0)
    held = skinning.sparse_weights(weights)
    transforms, rotations, rest = random(2, 24, 3, 4), random(2, 24, 3, 3, seed=2), random(5, 3, seed=1)
    directions = skinning.rounded(random(5, 3, 207, seed=3))
    leaves = [leaf.requires_grad_() for leaf in (transforms, rotations, rest)]
    assert torch.autograd.gradcheck(lambda *given: operators.skin(*given, *held), [leaves[0], leaves[2]])
    assert torch.autograd.gradcheck(lambda *given: operators.blend_and_skin(*given, *directions, *held)[0], leaves)
    chain = [leaf.requires_grad_() for leaf in (random(1, 24, 3, 3), random(1, 3, seed=1), random(24, 3, seed=2))]
    assert torch.autograd.gradcheck(lambda *given: operators.place_joints(*given, CHAIN), chain)


def test_operators_are_well_formed() -> None:
    held = skinning.sparse_weights(torch.softmax(random(5, 24), 1))
    transforms, rotations, rest = random(2, 24, 3, 4), random(2, 24, 3, 3), random(5, 3)
    given = [leaf.requires_grad_() for leaf in (transforms, rotations, rest)]
    torch.library.opcheck(operators.skin.registered, (transforms, rest, *held), test_utils=CHECKS)
    for dtype in (torch.float32, torch.float64):
        leaves = [leaf.detach().to(dtype).requires_grad_() for leaf in given]
        constants = *skinning.rounded(random(5, 3, 207, dtype=dtype)), *held[:2], held[2].to(dtype)
        torch.library.opcheck(operators.blend_and_skin.registered, (*leaves, *constants), test_utils=CHECKS)
    chain = random(2, 24, 3, 3).requires_grad_(), random(2, 3).requires_grad_(), random(24, 3).requires_grad_()
    torch.library.opcheck(operators.place_joints.registered, (*chain, CHAIN), test_utils=CHECKS)


def test_lists_of_weights_hold_what_the_table_holds() -> None:
    weights = load_default_body().skinning_weights
    starts, joints, shares = skinning.sparse_weights(weights)
    rebuilt = torch.zeros_like(weights)
    vertices = torch.repeat_interleave(torch.arange(len(weights)), starts.diff())
    rebuilt[vertices, joints.long()] = shares
    assert torch.equal(rebuilt, weights)
