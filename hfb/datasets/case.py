"""A case on disk: a user's files, and the truth beside them.

    case_0001/frame_0.png background.png clip.toml        what the methods see
              start_0.npz                                 the static estimate that every method starts from
              matte_0.png sharp_0.png truth.npz           the truth, for evaluation and for oracles that say so
              middle_0.png                                real video: the sharp frame in the middle, for an oracle
              case.json                                   how it was made

More frames: frame_1.png, ... of the same camera.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hfb.errors import InputError


@dataclass(frozen=True)
class Case:
    """The files of one case, and the few facts by which cases are sorted.

    Attributes:
        number: number in the set, from 1.
        blur_rate: mean over the frames of |union of R_S(i)| / |R_S(1)| - 1.
        facts: the whole content of case.json.
    """

    folder: Path
    number: int
    frames: int
    blur_rate: float
    facts: dict[str, Any]

    def frame_paths(self) -> list[Path]:
        """Return the files of the blurred frames, in time."""
        return [self.folder / f"frame_{index}.png" for index in range(self.frames)]

    @property
    def background(self) -> Path:
        """The same view without the person."""
        return self.folder / "background.png"

    @property
    def clip(self) -> Path:
        """Camera and shutter, as a user would know them."""
        return self.folder / "clip.toml"

    @property
    def truth(self) -> Path:
        """What really happened."""
        return self.folder / "truth.npz"

    def start_paths(self) -> list[Path]:
        """Return the files of the static estimates, one per frame; they need not exist."""
        return [self.folder / f"start_{index}.npz" for index in range(self.frames)]

    def true_matte_paths(self) -> list[Path]:
        """Return the files of the exact mattes."""
        return [self.folder / f"matte_{index}.png" for index in range(self.frames)]

    def middle_paths(self) -> list[Path]:
        """Return per frame the sharp frame in the middle of its exposure; synthetic cases have none."""
        return [self.folder / f"middle_{index}.png" for index in range(self.frames)]

    def sharp_paths(self) -> list[Path]:
        """Return per frame the file of its true sub-frames, side by side (straight alpha)."""
        return [self.folder / f"sharp_{index}.png" for index in range(self.frames)]


def case_name(number: int) -> str:
    """Return the folder's name of a case.

    Args:
        number: number of the case, from 1.
    """
    return f"case_{number:04d}"


def load_case(folder: Path) -> Case:
    """Open a case folder.

    Args:
        folder: the case's folder.

    Raises:
        InputError: no case lies there.
    """
    try:
        facts = json.loads((folder / "case.json").read_text(encoding="utf-8"))
        return Case(folder, int(facts["number"]), int(facts["frames"]), float(facts["blur_rate"]), facts)
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(f"{folder} is no case folder ({error}); make a set with `hfb synth`") from None
