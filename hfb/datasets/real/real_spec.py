"""The options of the sets of real video: their videos and the frames per exposure. Light to import."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from hfb.config import Record


def _several(value: Any) -> Any:
    """Return a single folder or number as a tuple of one."""
    return (value,) if isinstance(value, str | Path | int) else value


class RealSpec(Record):
    """Options of a set of blurred real video; they and its window determine a case."""

    set: Literal["b-aist", "real"] = "b-aist"
    videos: Annotated[tuple[Path, ...], BeforeValidator(_several)] = Field(
        min_length=1, description="folders of static-camera videos, searched with their subfolders"
    )
    average: Annotated[tuple[Annotated[int, Field(ge=1, le=256)], ...], BeforeValidator(_several)] = Field(
        (9,), min_length=1, description="K, consecutive frames averaged in linear light per exposure; 1: sharp frames"
    )
    frames: int = Field(1, ge=1, le=64, description="T, blurred frames per case, from T windows without a gap")
    seed: int = Field(0, ge=0)
    size_px: int = Field(384, ge=64, le=4096, description="longer side of the case's pictures; never enlarged [px]")
    estimator: Literal["auto", "mediapipe", "matte"] = Field(
        "auto", description="who makes the pseudo truth where no 3D joints are given"
    )
