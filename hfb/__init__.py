"""Human from Blur: recover how a person moved during one exposure.

Importing this package is free: a name loads its module when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hfb.api.fit_images import first_body, fit, matte
    from hfb.api.result import Result, load_result
    from hfb.api.seeing import compose, evaluate, load_body, render
    from hfb.body.model import Body
    from hfb.errors import InputError
    from hfb.fitting.alternatives import Alternatives
    from hfb.geometry.camera import PinholeCamera
    from hfb.initialization.initializer import Initializer
    from hfb.matting.matting_protocol import Matting
    from hfb.motion.static_pose import FirstBody
    from hfb.objective.own_term import TermInputs
    from hfb.priors.pose import PosePrior

__version__ = "0.1.0"

__all__ = [
    "Alternatives",
    "Body",
    "FirstBody",
    "Initializer",
    "InputError",
    "Matting",
    "PinholeCamera",
    "PosePrior",
    "Result",
    "TermInputs",
    "__version__",
    "compose",
    "evaluate",
    "first_body",
    "fit",
    "load_body",
    "load_result",
    "matte",
    "render",
]

_HOMES = {
    "Alternatives": "hfb.fitting.alternatives",
    "Body": "hfb.body.model",
    "FirstBody": "hfb.motion.static_pose",
    "Initializer": "hfb.initialization.initializer",
    "InputError": "hfb.errors",
    "Matting": "hfb.matting.matting_protocol",
    "PinholeCamera": "hfb.geometry.camera",
    "PosePrior": "hfb.priors.pose",
    "Result": "hfb.api.result",
    "TermInputs": "hfb.objective.own_term",
    "compose": "hfb.api.seeing",
    "evaluate": "hfb.api.seeing",
    "first_body": "hfb.api.fit_images",
    "fit": "hfb.api.fit_images",
    "load_body": "hfb.api.seeing",
    "load_result": "hfb.api.result",
    "matte": "hfb.api.fit_images",
    "render": "hfb.api.seeing",
}


def __getattr__(name: str) -> Any:
    """Load a public name (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'hfb' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted({*globals(), *__all__})
