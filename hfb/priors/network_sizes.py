"""Sizes of the motion prior's networks. Light to import."""

from pydantic import Field

from hfb.config import Record


class NetworkSizes(Record):
    """Sizes of the motion prior's two networks; widths and depths are of their hidden layers."""

    discriminator_width: int = Field(512, ge=1, le=4096)
    discriminator_depth: int = Field(3, ge=1, le=16)
    corrector_width: int = Field(256, ge=1, le=4096)
    corrector_depth: int = Field(2, ge=1, le=16)
