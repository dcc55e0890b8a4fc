"""A method's prediction: the motion during each exposure, as far as the method provides it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from hfb.fitting.alternatives import Alternatives
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Bool, Float


@dataclass(frozen=True)
class Prediction:
    """One method's prediction of one case; R = frames x sub-frames rows, frame after frame.

    Attributes:
        motion: poses on the observation's clock; None for a method that knows no human body (SfB, MfB).
        silhouettes: per row, where the body of ``motion`` is not what the method would draw; None otherwise.
        pictures: premultiplied linear colour and silhouette per row; None for a method without appearance.
        seconds: wall time of the method alone.
        joints: joints of a method that estimates joints but no body (then ``motion`` is None): camera axes [m], only
            their places relative to each other count; NaN where the method does not know a joint of the 24.
        alternatives: other motions that the method thinks possible, with their probabilities.
        joint_features: features behind the motion's ``joint_radius_mm``, for later calibrations.
    """

    motion: SampledMotion | None
    silhouettes: Bool[Array, "R H W"] | None
    pictures: Float[Array, "R H W 4"] | None
    seconds: float
    joints: Float[Array, "R 24 3"] | None = None
    alternatives: Alternatives | None = None
    joint_features: Mapping[str, Float[Array, "R 24"]] = field(default_factory=dict)
