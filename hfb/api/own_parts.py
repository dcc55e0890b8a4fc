"""Parts of the method that a caller gives as functions: they are checked where they return, not deep inside a fit."""

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
import torch

from hfb.body.model import Body
from hfb.config import Weights
from hfb.errors import InputError
from hfb.fitting.direction_odds import EVIDENCE
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.initializer import Initializer, Matte
from hfb.matting.matting_protocol import Matting, Picture, Plate
from hfb.motion.static_pose import FirstBody
from hfb.objective.own_term import OwnTerm, TermInputs
from hfb.priors.pose import PosePrior
from hfb.tasks.core.caller_parts import OwnParts
from hfb.typing import Array, Float, Tensor

TermFunction: TypeAlias = Callable[[TermInputs], Tensor]
"""Returns an unweighted term of the loss: a differentiable scalar tensor."""


def own_parts(
    matting: object, init: object, prior: object, terms: Mapping[str, TermFunction | tuple[TermFunction, float]] | None
) -> OwnParts:
    """Return those parts that are functions; others are options.

    Args:
        matting: a `Matting`, or an option.
        init: an `Initializer`, or an option.
        prior: a `PosePrior`, or an option.
        terms: further terms by name, each a function, or a function and its weight.

    Raises:
        InputError: a term has no usable name, function or weight.
    """
    return OwnParts(
        _CheckedMatting(matting) if callable(matting) else None,
        _CheckedInitializer(init) if callable(init) else None,
        _CheckedPrior(prior) if callable(prior) else None,
        tuple(_own_term(name, given) for name, given in (terms or {}).items()),
    )


def _own_term(name: str, given: TermFunction | tuple[TermFunction, float]) -> OwnTerm:
    function, weight = given if isinstance(given, tuple) else (given, 1.0)
    if name in {*Weights.model_fields, *EVIDENCE, "total", "loss"} or not name.isidentifier():
        raise InputError(f"the extra term {name!r} has the name of a term of hfb, or none that Python takes: change it")
    if not callable(function) or not np.isfinite(weight) or weight < 0:
        raise InputError(f"the extra term {name!r} is {given!r}: give a function, or a function and a weight >= 0")
    return OwnTerm(name, function, float(weight))


class _CheckedMatting:
    """A matting of the caller's, whose result is checked."""

    def __init__(self, matting: Matting) -> None:
        self._matting = matting

    def __call__(self, frame_linear: Picture, plate_linear: Plate) -> Float[Array, "H W"]:
        """See `Matting`."""
        alpha = np.asarray(self._matting(frame_linear, plate_linear), np.float32)
        if alpha.shape != frame_linear.shape[:2]:
            raise InputError(f"the matting returned the shape {alpha.shape} for a frame of {frame_linear.shape[:2]}")
        if not (np.isfinite(alpha).all() and alpha.min() >= 0 and alpha.max() <= 1):
            raise InputError("the matting returned values outside of [0, 1], or not finite: return each pixel's share")
        return alpha


class _CheckedInitializer:
    """A start of the caller's, whose result is checked."""

    def __init__(self, initializer: Initializer) -> None:
        self._initializer = initializer

    def __call__(
        self, frame_linear: Picture, plate_linear: Picture, matte: Matte, camera: PinholeCamera, body: Body
    ) -> FirstBody:
        """See `Initializer`."""
        found = self._initializer(frame_linear, plate_linear, matte, camera, body)
        if not isinstance(found, FirstBody):
            raise InputError(f"the start returned a {type(found).__name__}: return a hfb.FirstBody")
        parts = ((found.pose, (24, 3)), (found.translation, (3,)), (found.betas, (10,)))
        if any(tuple(one.shape) != shape or not torch.isfinite(one).all() for one, shape in parts):
            raise InputError("the start returned a body with other shapes than (24, 3), (3,), (10,), or not finite")
        return found


class _CheckedPrior:
    """A pose prior of the caller's, whose result is checked."""

    def __init__(self, prior: PosePrior) -> None:
        self._prior = prior

    def __call__(self, axis_angle: Float[Tensor, "S 23 3"]) -> Float[Tensor, "S"]:
        """See `PosePrior`."""
        value = self._prior(axis_angle)
        if not isinstance(value, Tensor) or value.shape != axis_angle.shape[:1]:
            found = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
            raise InputError(f"the pose prior returned {found} for {len(axis_angle)} poses: return one number per pose")
        return value
