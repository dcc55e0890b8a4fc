"""Parts of the method that a caller in Python replaces.

They are functions, which no record of a task can hold: tasks ask for them here, in the process and thread of the call.
A run with Prefect has none.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hfb.tasks.core.scoped import scoped

if TYPE_CHECKING:
    from hfb.initialization.initializer import Initializer
    from hfb.matting.matting_protocol import Matting
    from hfb.objective.own_term import OwnTerm
    from hfb.priors.pose import PosePrior


@dataclass(frozen=True)
class OwnParts:
    """The parts; what is not given is as the options say."""

    matting: Matting | None = None
    initializer: Initializer | None = None
    pose_prior: PosePrior | None = None
    terms: tuple[OwnTerm, ...] = ()

    def names(self) -> list[str]:
        """Return which parts are the caller's, for the result's record: options do not say so."""
        parts = {"matting": self.matting, "init": self.initializer, "prior": self.pose_prior}
        return [name for name, part in parts.items() if part] + [f"{one.name} x {one.weight:g}" for one in self.terms]

    def lacks(self) -> list[str]:
        """Return why no command repeats the run, see `hfb.tasks.tracking.recipe.Recipe`."""
        return [f"{name} is a function of the caller's" for name in self.names()]


NO_PARTS = OwnParts()
_in_use: ContextVar[OwnParts] = ContextVar("parts of the caller's own", default=NO_PARTS)


def caller_parts() -> OwnParts:
    """Return the parts in use."""
    return _in_use.get()


def using(own: OwnParts) -> AbstractContextManager[None]:
    """Use parts within the block.

    Args:
        own: the parts.
    """
    return scoped(_in_use, own)
