"""How the priors are trained, as frozen records. Light to import."""

from __future__ import annotations

from pydantic import Field

from hfb.config import Record
from hfb.priors.network_sizes import NetworkSizes


class MotionTraining(Record):
    """Training of the adversarial motion prior."""

    epochs: int = Field(40, ge=1, description="passes over the windows")
    windows_per_second: float = Field(200.0, gt=0, description="exposures drawn per second of recording")
    batch: int = Field(128, ge=2)
    learning_rate: float = Field(1e-3, gt=0, description="of AdamW at its highest; falls to zero along a half cosine")
    weight_decay: float = Field(0.01, ge=0)
    dropout: float = Field(0.25, ge=0, lt=1)
    temperature: float = Field(2.0, gt=0, description="divides the log odds of columns: strangers move otherwise")
    whole_temperature: float = Field(3.0, gt=0, description="divides the log odds of the whole body")
    sizes: NetworkSizes = NetworkSizes()


class PoseTraining(Record):
    """Training of the pose mixture."""

    components: int = Field(8, ge=1, le=64, description="Gaussians of the mixture")
    epochs: int = Field(100, ge=1, description="iterations of expectation and maximisation, at most")
    poses_per_second: float = Field(10.0, gt=0, description="poses taken per second of recording")
    floor_deg: float = Field(6.0, gt=0, description="spread added to every angle of every Gaussian [deg]")
