"""GVHMR: hmr4d_results.pt, tensors (smpl_params_incam: body_pose, betas, global_orient, transl; K_fullimg).

The body is SMPL-X: its pelvis and first 21 joints are SMPL's, its betas and its rest pelvis are not.
"""

from typing import Any

import numpy as np

from hfb.interop.readers.parts import numbers_at
from hfb.interop.readers.pose_track import PoseTrack, size_seen
from hfb.interop.readers.smplx import smpl_poses, smplx_pelvis
from hfb.io.safe.contents import named

SYSTEM = "GVHMR"


def read(content: Any, size: tuple[int, int], beside: dict[str, Any]) -> list[PoseTrack] | None:
    """Read the one person of a result file; None where it is something else.

    Args:
        content: content of the file, unpickled or parsed.
        size: height and width of the clip's frames [px].
        beside: contents of companion files by name.
    """
    one = named(content)
    body = named(one.get("smpl_params_incam"))
    if "K_fullimg" not in one or not {"body_pose", "global_orient", "transl"} <= body.keys():
        return None
    place = numbers_at(body, "transl", None, 3, finite=False)
    count = len(place)
    K = numbers_at(one, "K_fullimg", count, 3, 3, finite=False)
    root = numbers_at(body, "global_orient", count, 3, finite=False)
    return [
        PoseTrack(
            SYSTEM,
            "0",
            np.arange(count),
            size_seen(K, size),
            poses=smpl_poses(root, numbers_at(body, "body_pose", count, 63, finite=False)),
            betas=numbers_at(body, "betas", count, 10, finite=False) if "betas" in body else None,
            betas_space="smplx",
            pelvis=smplx_pelvis(place),
            K=K,
        )
    ]
