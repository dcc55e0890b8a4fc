"""A folder of recordings as a source of motions."""

import logging
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from hfb.datasets.motions.files.bvh import read_bvh
from hfb.datasets.motions.files.cape import FRAME_FILE, load_cape
from hfb.datasets.motions.files.deepmimic import is_deepmimic, read_deepmimic
from hfb.datasets.motions.files.smpl_motions import check_clip, load_smpl_motion, uniform_clip
from hfb.datasets.motions.motion_clip import MotionClip
from hfb.datasets.motions.skeletons.retargeting import retarget
from hfb.errors import InputError

_log = logging.getLogger(__name__)
_TEXTS = (".txt", ".json")
_NO_MOTION = re.compile(r"shape|.+_stagei")
"""Files of AMASS that describe its people."""
_KEPT = 4
"""Clips held in memory by each process: neighbouring cases often share one."""


class FolderMotions:
    """A `MotionSource` of all recordings below a folder, sorted by their relative paths.

    Hidden files are ignored, and so are AMASS's of its people (`shape.npz`, `neutral_stagei.npz`). A folder with the
    frames of a CAPE sequence is one motion.

    Args:
        folder: folder of the recordings.
    """

    def __init__(self, folder: Path) -> None:
        """List the recordings.

        Raises:
            InputError: no such folder, or no recording in it.
        """
        if not folder.is_dir():
            raise InputError(f"{folder} is no folder; give one with motion files, or leave it out for built-in motions")
        found: dict[str, list[Path]] = {}
        for path in folder.rglob("*"):
            relative = path.relative_to(folder)
            hidden = any(part.startswith(".") for part in relative.parts) or _NO_MOTION.fullmatch(path.stem)
            if hidden or not path.is_file():
                continue
            frame = FRAME_FILE.match(path.name)
            if frame:
                within = relative.parent / frame["sequence"]
                name = relative.parent if relative.parent.name == frame["sequence"] else within
                found.setdefault(name.as_posix(), []).append(path)
            elif path.suffix.lower() in (".npz", ".bvh") or (path.suffix.lower() in _TEXTS and is_deepmimic(path)):
                found[relative.as_posix()] = [path]
        if not found:
            raise InputError(
                f"{folder} has no motion in it; expected are AMASS files (.npz), BVH files (.bvh), DeepMimic's "
                "motions (.txt), CAPE sequences (folders of SEQUENCE.000001.npz) or hfb's motion files (.npz)"
            )
        self._found = [(name, tuple(sorted(found[name]))) for name in sorted(found)]

    def names(self) -> Sequence[str]:
        """Return paths relative to the folder, with forward slashes; of a CAPE sequence that of its frames' folder."""
        return [name for name, _ in self._found]

    def load(self, index: int) -> MotionClip:
        """Read one motion; see `MotionSource`.

        Args:
            index: number of the motion in `names`.
        """
        name, paths = self._found[index]
        return _load(name, paths)


@lru_cache(maxsize=1024)
def _tell(remark: str) -> None:
    """Log a remark once per process, since cases that share a clip read it again."""
    _log.warning("%s", remark)


@lru_cache(maxsize=_KEPT)
def _load(name: str, paths: tuple[Path, ...]) -> MotionClip:
    if FRAME_FILE.match(paths[0].name):
        return load_cape(paths, name)
    if paths[0].suffix.lower() == ".npz":
        return load_smpl_motion(paths[0], name)
    times_s = None
    if paths[0].suffix.lower() in _TEXTS:
        motion, times_s = read_deepmimic(paths[0])
    else:
        motion = read_bvh(paths[0])
    try:
        poses, translations, remarks = retarget(motion)
    except InputError as error:
        raise InputError(f"{paths[0]} cannot be brought to SMPL's skeleton: {error}") from error
    for remark in remarks:
        _tell(f"{name}: {remark}")
    flat = poses.reshape(len(poses), 72)
    if times_s is not None:
        return uniform_clip(name, paths[0], flat, translations, times_s)
    return check_clip(name, paths[0], flat, translations, motion.fps)
