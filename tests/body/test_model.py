"""The stages against an independent slow skinning, against body-models, and against the laws they must obey."""

from pathlib import Path

import numpy as np
import pytest
import torch

from hfb.body.assets import load_body, load_default_body
from hfb.body.model import Body
from hfb.body.skeleton import ANCESTORS_BY_DOUBLING, PARENTS
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.kernels.dispatch import readable_formulas
from tests.body.smpl_files import save_npz, save_pickle, smpl_arrays


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory: pytest.TempPathFactory) -> Body:
    path = save_npz(tmp_path_factory.mktemp("model") / "SMPL_NEUTRAL.npz", smpl_arrays())
    return load_body(path, torch.float64)


@pytest.fixture(scope="module")
def default() -> Body:
    return load_default_body(torch.float64)


@pytest.fixture(scope="module", params=["synthetic", "default"])
def body(request: pytest.FixtureRequest) -> Body:
    return request.getfixturevalue(request.param)


def random_motion(count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(betas, axis-angles (S, 24, 3), translations (S, 3)) in float64."""
    generator = torch.Generator().manual_seed(seed)
    options = {"dtype": torch.float64, "generator": generator}
    return torch.randn(10, **options), 0.5 * torch.randn(count, 24, 3, **options), torch.randn(count, 3, **options)


def slow_skinning(body: Body, betas: np.ndarray, rotations: np.ndarray, translation: np.ndarray) -> tuple:
    """(vertices, joints) of one instant, vertex by vertex and joint by joint from the definitions."""
    rest = body.template.numpy() + body.shape_directions.numpy() @ betas
    joints = body.joint_regressor.numpy() @ rest
    if body.pose_directions is not None:
        feature = np.concatenate([(rotation - np.eye(3)).reshape(-1) for rotation in rotations[1:]])
        rest = rest + body.pose_directions.numpy() @ feature
    world: list[np.ndarray] = []
    for joint, parent in enumerate(PARENTS):
        local = np.eye(4)
        local[:3, :3] = rotations[joint]
        local[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0)
        world.append(local if parent < 0 else world[parent] @ local)
    vertices = np.zeros_like(rest)
    for weights, point, posed in zip(body.skinning_weights.numpy(), rest, vertices, strict=True):
        for joint in np.flatnonzero(weights):
            posed += weights[joint] * (world[joint][:3, :3] @ (point - joints[joint]) + world[joint][:3, 3])
    return vertices + translation, np.stack([matrix[:3, 3] for matrix in world]) + translation


def test_doubling_reaches_the_root_of_every_chain() -> None:
    covered = [1] * 24 + [0]
    for ancestors in ANCESTORS_BY_DOUBLING:
        covered = [covered[joint] + covered[above] for joint, above in enumerate(ancestors)]
    depth = [0] * 24
    for joint, parent in enumerate(PARENTS):
        depth[joint] = 1 + (depth[parent] if parent >= 0 else 0)
    assert covered[:24] == depth


def test_agrees_with_slow_skinning(body: Body) -> None:
    betas, axis_angles, translations = random_motion(3)
    rotations = axis_angle_to_matrix(axis_angles)
    posed = body.shape(betas).pose(rotations, translations)
    for instant in range(3):
        vertices, joints = slow_skinning(body, betas.numpy(), rotations[instant].numpy(), translations[instant].numpy())
        np.testing.assert_allclose(posed.vertices[instant].numpy(), vertices, atol=1e-12)
        np.testing.assert_allclose(posed.joints[instant].numpy(), joints, atol=1e-12)


def test_agrees_with_body_models(tmp_path: Path, synthetic: Body) -> None:
    smpl = pytest.importorskip("body_models.smpl.torch")
    theirs = smpl.SMPL(model_path=save_pickle(tmp_path / "SMPL_NEUTRAL.pkl", smpl_arrays()))
    betas, axis_angles, translations = (value.float() for value in random_motion(4))
    vertices = theirs.forward_vertices(
        body_pose=axis_angles[:, 1:],
        pelvis_rotation=axis_angles[:, 0],
        shape=betas.expand(4, -1),
        global_translation=translations,
    )
    ours = synthetic.to(torch.float32).shape(betas).pose(axis_angle_to_matrix(axis_angles), translations)
    torch.testing.assert_close(ours.vertices, vertices, atol=2e-6, rtol=0)


def test_zero_pose_is_the_shaped_template(body: Body) -> None:
    betas, _, translations = random_motion(2)
    shaped = body.shape(betas)
    posed = shaped.pose(torch.eye(3, dtype=torch.float64).expand(2, 24, 3, 3), translations)
    torch.testing.assert_close(posed.vertices, shaped.vertices + translations[:, None])
    torch.testing.assert_close(posed.joints, shaped.joints + translations[:, None])
    torch.testing.assert_close(shaped.vertices, body.template + body.shape_directions @ betas)


def test_turning_the_root_turns_everything_about_the_root(body: Body) -> None:
    betas, axis_angles, _ = random_motion(2)
    still = torch.zeros(2, 3, dtype=torch.float64)
    turn = axis_angle_to_matrix(torch.tensor([0.3, -1.2, 2.0], dtype=torch.float64))
    shaped = body.shape(betas)
    rotations = axis_angle_to_matrix(axis_angles)
    before = shaped.pose(rotations, still)
    turned = torch.cat([(turn @ rotations[:, 0])[:, None], rotations[:, 1:]], 1)
    after = shaped.pose(turned, still)
    root = shaped.joints[0]
    torch.testing.assert_close(after.vertices, (before.vertices - root) @ turn.T + root)
    torch.testing.assert_close(after.joints, (before.joints - root) @ turn.T + root)


def test_instants_are_independent(body: Body) -> None:
    betas, axis_angles, translations = random_motion(5)
    shaped = body.shape(betas)
    together = shaped.pose(axis_angle_to_matrix(axis_angles), translations)
    alone = shaped.pose(axis_angle_to_matrix(axis_angles[3:4]), translations[3:4])
    torch.testing.assert_close(together.vertices[3:4], alone.vertices)
    torch.testing.assert_close(
        shaped.joints_of(axis_angle_to_matrix(axis_angles), translations), together.joints, atol=0, rtol=0
    )


def test_bones_keep_their_length(body: Body) -> None:
    betas, axis_angles, translations = random_motion(4)
    shaped = body.shape(betas)
    joints = shaped.joints_of(axis_angle_to_matrix(axis_angles), translations)
    parents = list(PARENTS[1:])
    lengths = (joints[:, 1:] - joints[:, parents]).norm(dim=-1)
    torch.testing.assert_close(lengths, (shaped.joints[1:] - shaped.joints[parents]).norm(dim=-1).expand(4, -1))


@pytest.mark.parametrize("at", ["anywhere", "rest"])
def test_gradients_match_finite_differences(body: Body, at: str) -> None:
    """Along random directions, through axis-angles as in a fit; at rest too, where the motion starts."""
    betas, axis_angles, translations = random_motion(2)
    if at == "rest":
        betas, axis_angles = torch.zeros_like(betas), torch.zeros_like(axis_angles)
    generator = torch.Generator().manual_seed(1)
    probe = torch.randn(2, len(body.template), 3, dtype=torch.float64, generator=generator)
    joint_probe = torch.randn(2, 24, 3, dtype=torch.float64, generator=generator)

    def energy(betas: torch.Tensor, axis_angles: torch.Tensor, translations: torch.Tensor) -> torch.Tensor:
        posed = body.shape(betas).pose(axis_angle_to_matrix(axis_angles), translations)
        return (probe * posed.vertices).sum() + (joint_probe * posed.joints).sum()

    inputs = [value.clone().requires_grad_() for value in (betas, axis_angles, translations)]
    gradients = torch.autograd.grad(energy(*inputs), inputs)
    step = 1e-5
    for index, (value, gradient) in enumerate(zip(inputs, gradients, strict=True)):
        assert torch.isfinite(gradient).all()
        for _ in range(4):
            direction = torch.randn(value.shape, dtype=torch.float64, generator=generator)
            moved = []
            for sign in (1, -1):
                trial = [other.detach() for other in inputs]
                trial[index] = trial[index] + sign * step * direction
                moved.append(energy(*trial))
            expected = (moved[0] - moved[1]) / (2 * step)
            torch.testing.assert_close((gradient * direction).sum(), expected, rtol=1e-6, atol=1e-6)


def test_float32_is_close_to_float64(body: Body) -> None:
    betas, axis_angles, translations = random_motion(3)
    exact = body.shape(betas).pose(axis_angle_to_matrix(axis_angles), translations)
    single = body.to(torch.float32).shape(betas.float())
    rough = single.pose(axis_angle_to_matrix(axis_angles.float()), translations.float())
    assert rough.vertices.dtype == torch.float32
    torch.testing.assert_close(rough.vertices.double(), exact.vertices, atol=2e-5, rtol=0)


def test_a_shape_among_others_has_the_gradient_it_has_anywhere() -> None:
    """To the bit: from a last one on, fits at once go their own ways."""
    body = load_default_body()
    generator = torch.Generator().manual_seed(0)
    betas = torch.randn(10, generator=generator).expand(3, -1).clone().requires_grad_()
    wanted = torch.randn(body.template.shape, generator=generator)
    with readable_formulas():
        off = torch.func.vmap(lambda one: (body.shape(one).vertices * wanted).sum() + body.rest_joints(one).sum())(
            betas
        )
    first, *others = torch.autograd.grad(off.sum(), betas)[0]
    assert all(torch.equal(first, other) for other in others)
