"""Human from Blur: recover how a person moved during one exposure.

Importing this package is free: a name loads its module when it is first used.
"""

from importlib import import_module

TYPE_CHECKING = False  # type checkers take it for true; importing typing would cost more than all the rest
if TYPE_CHECKING:
    from hfb.api.fit_clips import fit_clip as fit_clip
    from hfb.api.fit_images import first_body as first_body
    from hfb.api.fit_images import fit as fit
    from hfb.api.fit_images import matte as matte
    from hfb.api.result import Result as Result
    from hfb.api.result import load_result as load_result
    from hfb.api.seeing import compose as compose
    from hfb.api.seeing import evaluate as evaluate
    from hfb.api.seeing import load_body as load_body
    from hfb.api.seeing import render as render
    from hfb.body.model import Body as Body
    from hfb.errors import InputError as InputError
    from hfb.fitting.alternatives import Alternatives as Alternatives
    from hfb.geometry.camera import PinholeCamera as PinholeCamera
    from hfb.initialization.initializer import Initializer as Initializer
    from hfb.matting.matting_protocol import Matting as Matting
    from hfb.motion.static_pose import FirstBody as FirstBody
    from hfb.objective.own_term import TermInputs as TermInputs
    from hfb.priors.pose import PosePrior as PosePrior

__version__ = "0.1.0"

_HOMES = {
    "api.fit_clips": ("fit_clip",),
    "api.fit_images": ("first_body", "fit", "matte"),
    "api.result": ("Result", "load_result"),
    "api.seeing": ("compose", "evaluate", "load_body", "render"),
    "body.model": ("Body",),
    "errors": ("InputError",),
    "fitting.alternatives": ("Alternatives",),
    "geometry.camera": ("PinholeCamera",),
    "initialization.initializer": ("Initializer",),
    "matting.matting_protocol": ("Matting",),
    "motion.static_pose": ("FirstBody",),
    "objective.own_term": ("TermInputs",),
    "priors.pose": ("PosePrior",),
}
__all__ = ["__version__", *(name for names in _HOMES.values() for name in names)]  # noqa: PLE0604


if not TYPE_CHECKING:  # for which a name that does not exist would be of any type

    def __getattr__(name):
        """Load a public name (PEP 562)."""
        home = next((module for module, names in _HOMES.items() if name in names), None)
        if home is None:
            raise AttributeError(f"module 'hfb' has no attribute {name!r}")
        globals()[name] = value = getattr(import_module(f"hfb.{home}"), name)
        return value


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted({*globals(), *__all__})
