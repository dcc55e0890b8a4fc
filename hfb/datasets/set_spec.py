"""The options of a synthetic set, which determine its cases, and the files it is made from. Light to import."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from hfb.config import Record


class SetSpec(Record):
    """A set of cases; it, the number and the usable motions determine a case."""

    set: Literal["bt-amass", "bc-cape"] = Field("bt-amass", description="textured AMASS motions, or clothed CAPE ones")
    frames: int = Field(1, ge=1, le=16, description="blurred frames per case")
    seed: int = Field(0, ge=0)
    fill: Literal["paper", "even", "natural"] = Field(
        "paper", description="cases per blur-rate interval: as in the paper's tables, equally many, or as motions fall"
    )
    size_px: int = Field(256, ge=32, le=4096, description="both sides of the pictures [px]")
    easy: bool = Field(
        False,
        description="for debugging only: the fit's own mesh, no clothing, no sensor noise; files still have 8 bits",
    )
    motions: Path | None = Field(None, description="a folder of recordings; made-up motions when not given")
    backgrounds: Path | None = Field(None, description="a folder of pictures; generated rooms when not given")
    textures: Path | None = Field(None, description="a folder of UV textures of the body; generated when not given")
    body: Path | None = Field(None, description="a SMPL .npz or .pkl file; the embedded body when not given")


def listing_of(*folders: Path | None) -> str:
    """List folders by name, size and time of change of their files; hashing a large library would take minutes.

    Args:
        *folders: folders, or None.
    """
    found = [(folder, path) for folder in folders if folder for path in sorted(folder.rglob("*")) if path.is_file()]
    return "\n".join(f"{one.relative_to(at)} {one.stat().st_size} {one.stat().st_mtime_ns}" for at, one in found)
