import pytest
import torch

from hfb.motion.operators import turn, turn_gradient


def given(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    coefficients = torch.randn(2, 3, 24, 4, generator=generator, dtype=torch.float64).requires_grad_()
    return coefficients, torch.rand(5, 3, generator=generator, dtype=torch.float64)


def test_the_short_way_has_the_bits_of_the_registered_operator() -> None:
    coefficients, powers = given()
    found = []
    for way in (turn, turn.registered):
        matrices = way(coefficients, powers)
        found.append((matrices, *torch.autograd.grad(matrices.square().sin().sum(), coefficients)))
    for one, other in zip(*found, strict=True):
        assert torch.equal(one, other)


def test_what_traces_sees_the_registered_operator() -> None:
    coefficients, powers = given()
    seen = torch.fx.experimental.proxy_tensor.make_fx(turn, tracing_mode="fake")(coefficients.detach(), powers)
    assert any(node.target is torch.ops.hfb.turn.default for node in seen.graph.nodes)


def test_torch_compile_has_the_same_gradient() -> None:
    coefficients, powers = given()

    def loss(coefficients: torch.Tensor) -> torch.Tensor:
        return turn(coefficients, powers).square().sin().sum()

    compiled = torch.compile(loss, backend="aot_eager", fullgraph=True)
    plain, traced = (torch.autograd.grad(way(coefficients), coefficients)[0] for way in (loss, compiled))
    torch.testing.assert_close(traced, plain)


def test_a_gradient_of_the_gradient_is_an_error_and_not_a_wrong_number() -> None:
    coefficients, powers = given()
    (gradient,) = torch.autograd.grad(turn(coefficients, powers).square().sum(), coefficients, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


def test_without_a_way_back_it_is_the_function() -> None:
    coefficients, powers = given()
    way = turn(coefficients, powers).detach()
    assert turn_gradient(coefficients, powers, way).grad_fn is None
