import pytest
import torch

from hfb.kernels.motion.motion_operators import move, move_gradient

Given = tuple[torch.Tensor, torch.Tensor, torch.Tensor, float]


def given(seed: int = 0) -> Given:
    generator = torch.Generator().manual_seed(seed)
    rotation = torch.randn(2, 3, 24, 4, generator=generator, dtype=torch.float64).requires_grad_()
    translation = torch.randn(2, 3, 4, generator=generator, dtype=torch.float64)
    return rotation, translation, torch.rand(5, generator=generator, dtype=torch.float64), 0.5


def loss(rotation: torch.Tensor, *others: object) -> torch.Tensor:
    matrices, path = move(rotation, *others)
    return matrices.square().sin().sum() + path.sum()


def test_the_short_way_has_the_bits_of_the_registered_operator() -> None:
    arguments = given()
    found = []
    for way in (move, move.registered):
        matrices, path = way(*arguments)
        found.append((matrices, path, *torch.autograd.grad(matrices.square().sin().sum(), arguments[0])))
    for one, other in zip(*found, strict=True):
        assert torch.equal(one, other)


def test_what_traces_sees_the_registered_operator() -> None:
    rotation, *others, origin = given()

    def way(*tensors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return move(*tensors, origin)

    seen = torch.fx.experimental.proxy_tensor.make_fx(way, tracing_mode="fake")(rotation.detach(), *others)
    assert any(node.target is torch.ops.hfb.move.default for node in seen.graph.nodes)


def test_torch_compile_has_the_same_gradient() -> None:
    rotation, *others = given()
    compiled = torch.compile(loss, backend="aot_eager", fullgraph=True)
    plain, traced = (torch.autograd.grad(way(rotation, *others), rotation)[0] for way in (loss, compiled))
    torch.testing.assert_close(traced, plain)


def test_a_gradient_of_the_gradient_is_an_error_and_not_a_wrong_number() -> None:
    rotation, *others = given()
    (gradient,) = torch.autograd.grad(loss(rotation, *others), rotation, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


def test_without_a_way_back_it_is_the_function() -> None:
    rotation, translation, clock, origin = given()
    matrices, path = (one.detach() for one in move(rotation, translation, clock, origin))
    assert all(one.grad_fn is None for one in move_gradient(rotation, translation, clock, matrices, path, origin))
