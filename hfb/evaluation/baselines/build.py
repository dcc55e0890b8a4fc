"""Construction of a method from its spec."""

from hfb.body.model import Body
from hfb.config import InitConfig
from hfb.evaluation.baselines.chain import Chain
from hfb.evaluation.baselines.fitted import HumanFromBlur
from hfb.evaluation.baselines.method import Method
from hfb.evaluation.baselines.method_spec import MethodSpec
from hfb.evaluation.baselines.oracles import (
    Floor,
    SharpMiddle,
    TrueFront,
    TrueHeight,
    TrueMatte,
    TrueStart,
    TwoStageOracle,
)
from hfb.evaluation.baselines.own_function import OwnFunction
from hfb.evaluation.baselines.shape_from_blur import ShapeFromBlur
from hfb.evaluation.baselines.static import Static
from hfb.initialization.initializer import make_initializer


def make_method(spec: MethodSpec, body: Body) -> Method:
    """Build the method that a spec describes.

    Args:
        spec: by `method_spec`.
        body: the model in which starts and predictions are given.

    Raises:
        InputError: one of its networks, priors or folders cannot be used.
    """
    method = _plain(spec, body)
    if "true-height" in spec.oracles and isinstance(method, HumanFromBlur):
        method = TrueHeight(spec.name, method, body)
    if "true-start" in spec.oracles:
        method = TrueStart(spec.name, method, body)
    if "true-front" in spec.oracles:
        method = TrueFront(spec.name, method, body)
    if "true-matte" in spec.oracles:
        method = TrueMatte(spec.name, method)
    return method


def _plain(spec: MethodSpec, body: Body) -> Method:
    """Build the method without the oracles that only change its input."""
    subframes = spec.config.fit.subframes
    if spec.kind in ("static", "interpolated"):
        return Static(spec.name, spec.kind == "interpolated", subframes, body)
    if spec.kind in ("sfb", "mfb"):
        return ShapeFromBlur(spec.name, spec.kind == "mfb", subframes)
    if spec.kind == "fit":
        return HumanFromBlur(spec.name, spec.config, spec.frames_alone, body)
    if spec.kind == "floor":
        return Floor(spec.name, subframes, body)
    if spec.kind == "middle":
        return SharpMiddle(spec.name, make_initializer(InitConfig()), subframes, body)
    if spec.kind == "oracle":
        assert spec.estimator is not None
        own = None if spec.estimator == "simulated" else make_initializer(InitConfig(method=spec.estimator))
        return TwoStageOracle(spec.name, own, subframes, spec.config.seed, body)
    if spec.function is not None:
        return OwnFunction(spec.name, spec.function, body)
    assert spec.chain is not None
    return Chain(spec.name, spec.chain, subframes, body)
