"""hfb's own motion.npz, as the start of another fit: the middle row of every frame; and the canonical result."""

from typing import Any

import numpy as np

from hfb.interop.readers.parts import numbers_at
from hfb.interop.readers.pose_track import PoseTrack, track_of
from hfb.io.safe.contents import frame_numbers, named, text_of

SYSTEM = "hfb"
_MOST_FRAMES = 1e6  # as many as a video has (`hfb.io.media.video.video_file`)


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the person of a motion.npz or of a canonical result; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    one = named(content)
    if {"frame_index", "system"} <= one.keys():
        return [track_of(one)]
    if not {"poses", "trans", "betas", "frame_index", "K", "betas_space"} <= one.keys():
        return None
    poses = numbers_at(one, "poses", None, 72, finite=False)
    frame_of_row = frame_numbers(numbers_at(one, "frame_index", len(poses)), _MOST_FRAMES)
    frames, begins, counts = np.unique(np.sort(frame_of_row), return_index=True, return_counts=True)
    middle = np.argsort(frame_of_row, kind="stable")[begins + counts // 2]
    return [
        PoseTrack(
            SYSTEM,
            "0",
            frames,
            None,
            poses=poses.reshape(-1, 24, 3)[middle],
            trans=numbers_at(one, "trans", len(poses), 3, finite=False)[middle],
            betas=np.tile(numbers_at(one, "betas", 10), (len(frames), 1)),
            betas_space="hfb" if text_of(one["betas_space"]) == "hfb" else "smpl",
            K=np.tile(numbers_at(one, "K", 3, 3), (len(frames), 1, 1)),
        )
    ]
