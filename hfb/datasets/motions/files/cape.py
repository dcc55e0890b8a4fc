"""CAPE sequences (Ma et al., Learning to Dress 3D People in Generative Clothing, 2020): clothed people, frame by frame.

A sequence is a folder of `SEQUENCE.000001.npz` files at 60 frames per second with `pose` (72), `transl` (3) and
`v_cano` (6890, 3), the clothed person unposed; `minimal_body_shape/SUBJECT/SUBJECT_minimal.npy` beside the sequences
holds the same person without clothes. The world's y axis points up.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hfb.datasets.motions.files.npz import read_npy, read_npz
from hfb.datasets.motions.files.smpl_motions import uniform_clip
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.errors import InputError
from hfb.typing import Array, Float

FRAME_FILE = re.compile(r"^(?P<sequence>.+)\.(?P<frame>\d{6})\.npz$")
_FPS = 60.0
_MAX_FRAMES = 100_000
_LARGEST_CLOTHING_M = 1.0


def load_cape(paths: Sequence[Path], name: str) -> MotionClip:
    """Read the frames of one sequence; frames that are missing between others are interpolated.

    Args:
        paths: one .npz per frame, in order.
        name: name of the sequence.

    Raises:
        InputError: a frame is damaged or of another layout.
    """
    if len(paths) > _MAX_FRAMES:
        raise InputError(f"{paths[0].parent} has {len(paths)} frames; a sequence of at most {_MAX_FRAMES} is read")
    numbers: list[int] = []
    poses, places = [], []
    for path in paths:
        arrays, names = read_npz(path, ("pose", "transl"))
        if [arrays[key].shape if key in arrays else None for key in ("pose", "transl")] != [(72,), (3,)]:
            raise InputError(
                f"{path} is no frame of CAPE: it has {', '.join(names)[:300]}; expected are pose (72) and transl (3)"
            )
        match = FRAME_FILE.match(path.name)
        numbers.append(int(match["frame"]) if match else len(numbers))
        poses.append(arrays["pose"].astype(np.float64))
        places.append(arrays["transl"].astype(np.float64))
    folder = paths[0].parent
    times_s = np.array(numbers) / _FPS
    clip = uniform_clip(name, folder, np.stack(poses), np.stack(places), times_s)
    return replace(clip, clothing=_clothing(paths[0]))


def _clothing(frame: Path) -> Float[Array, "V 3"] | None:
    """Return the displacement by the first frame's clothes [m]; None where the person's bare body is missing."""
    minimal = _minimal_body(frame.parent)
    if minimal is None:
        return None
    arrays, _ = read_npz(frame, ("v_cano",))
    body, clothed = read_npy(minimal), arrays.get("v_cano")
    if clothed is None or clothed.ndim != 2 or clothed.shape != body.shape or body.shape[1] != 3:
        raise InputError(f"{frame} and {minimal} do not have the same vertices; download CAPE again")
    clothing = clothed.astype(np.float64) - body.astype(np.float64)
    if not np.isfinite(clothing).all() or np.abs(clothing).max() > _LARGEST_CLOTHING_M:
        raise InputError(f"{frame} and {minimal} are not of one person: they lie more than a metre apart")
    return clothing


def _minimal_body(folder: Path) -> Path | None:
    """Find the subject's bare body beside the frames or in a folder above them."""
    above = [folder, *folder.parents]
    for level in above:
        for subject in above:
            path = level / "minimal_body_shape" / subject.name / f"{subject.name}_minimal.npy"
            if subject.name and path.is_file():
                return path
            if subject == level:
                break
    return None
