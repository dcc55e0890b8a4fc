"""GVHMR: hmr4d_results.pt, tensors (smpl_params_incam: body_pose, betas, global_orient, transl; K_fullimg).

The body is SMPL-X: its pelvis and first 21 joints are SMPL's, its betas and its rest pelvis are not.
"""

from typing import Any

import numpy as np

from hfb.initialize.readers.contents import named, numbers
from hfb.initialize.readers.pose_track import PoseTrack
from hfb.initialize.readers.smplx import smpl_poses, smplx_pelvis

SYSTEM = "GVHMR"


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """The one person of a result file; None where it is something else."""
    one = named(content)
    body = named(one.get("smpl_params_incam"))
    if "K_fullimg" not in one or not {"body_pose", "global_orient", "transl"} <= body.keys():
        return None
    place = numbers(body["transl"], None, 3)
    count = len(place)
    return [
        PoseTrack(
            SYSTEM,
            "0",
            np.arange(count),
            size,
            poses=smpl_poses(numbers(body["global_orient"], count, 3), numbers(body["body_pose"], count, 63)),
            betas=numbers(body["betas"], count, 10) if "betas" in body else None,
            betas_space="smplx",
            pelvis=smplx_pelvis(place),
            K=numbers(one["K_fullimg"], count, 3, 3),
        )
    ]
