"""The options of the set b-aist: its videos and the frames per exposure. Light to import."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from hfb.config import Record


class RealSpec(Record):
    """Options of a set of blurred real video; they and its window determine a case."""

    videos: Path = Field(description="folder of static-camera videos, searched with its subfolders")
    average: int = Field(9, ge=2, le=256, description="K, consecutive frames averaged in linear light per exposure")
    frames: int = Field(1, ge=1, le=64, description="T, blurred frames per case, from T windows without a gap")
    seed: int = Field(0, ge=0)
    size_px: int = Field(384, ge=64, le=4096, description="longer side of the case's pictures; never enlarged [px]")
    estimator: Literal["auto", "mediapipe", "matte"] = Field(
        "auto", description="who makes the pseudo truth where no 3D joints are given"
    )
