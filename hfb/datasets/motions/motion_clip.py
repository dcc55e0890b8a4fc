"""A recorded motion in the common form of all generators."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from hfb.typing import Array, Float


@dataclass(frozen=True)
class MotionClip:
    """A recorded or made motion in the SMPL layout; the world's y axis points up [m].

    Attributes:
        name: name in reports; unique within its source.
        poses: axis-angle [rad]; the root's turns the rest body (y up, facing +z, its left +x) into the world.
        translations: SMPL's translation [m].
        fps: frames per second of the recording.
        clothing: displacement of every vertex of the rest body [m], for the body model whose file it came with.
    """

    name: str
    poses: Float[Array, "F 24 3"]
    translations: Float[Array, "F 3"]
    fps: float
    clothing: Float[Array, "V 3"] | None = None


@runtime_checkable
class MotionSource(Protocol):
    """Motions by number, in an order that does not change between runs and machines."""

    def names(self) -> Sequence[str]:
        """Return the names of the motions; nothing is read beyond the folder's listing."""
        ...

    def load(self, index: int) -> MotionClip:
        """Read one motion.

        Args:
            index: number of the motion in `names`.

        Raises:
            InputError: the file is damaged, of an unknown layout, shorter than two frames or not finite.
        """
        ...
