"""Loading of body models: a user's SMPL file, or the embedded body."""

import json
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
import torch

from hfb.body.mesh import make_mesh
from hfb.body.model import Body
from hfb.body.skeleton import JOINT_COUNT
from hfb.body.smpl_file import read_smpl
from hfb.io.array_files import read_arrays


@lru_cache(maxsize=1)
def _embedded() -> Body:
    with resources.as_file(resources.files("hfb.body") / "data" / "default_body.npz") as path:
        arrays = read_arrays(path)
    about = json.loads(str(arrays["about"]))
    template = torch.from_numpy(arrays["template"].astype(np.float64))
    directions = torch.from_numpy(arrays["shape_directions"].astype(np.float64))
    regressor = torch.zeros(JOINT_COUNT, len(template), dtype=torch.float64)
    regressor[arrays["regressor_joint"].astype(int), arrays["regressor_vertex"].astype(int)] = torch.from_numpy(
        arrays["regressor_value"].astype(np.float64)
    )
    weights = torch.zeros(len(template), JOINT_COUNT, dtype=torch.float64)
    weights.scatter_(
        1,
        torch.from_numpy(arrays["weight_joint"].astype(np.int64)),
        torch.from_numpy(arrays["weight_value"].astype(np.float64)),
    )
    return Body(
        name=about["name"],
        betas_space="hfb",
        licence=about["licence"],
        source=about["source"],
        template=template,
        shape_directions=directions,
        pose_directions=None,
        joint_regressor=regressor,
        joint_template=regressor @ template,
        joint_shape_directions=torch.einsum("jv,vck->jck", regressor, directions),
        skinning_weights=weights / weights.sum(1, keepdim=True),
        mesh=make_mesh(
            arrays["faces"].astype(np.int64), arrays["uv"] / 65535.0, arrays["uv_faces"].astype(np.int64), torch.float64
        ),
    )


def load_default_body(dtype: torch.dtype = torch.float32) -> Body:
    """Load the embedded human body: SMPL's skeleton and poses, its own betas; see data/NOTICE.txt.

    Args:
        dtype: precision of the tensors.
    """
    return _embedded().to(dtype)


def load_body(path: Path | None, dtype: torch.dtype = torch.float32) -> Body:
    """Load the user's SMPL file (.npz, or .pkl whose code is not run), or the embedded body for None.

    Args:
        path: the SMPL file, or None.
        dtype: precision of the tensors.

    Raises:
        InputError: the file is missing, damaged, or not SMPL; the text names the fix.
    """
    return load_default_body(dtype) if path is None else read_smpl(path).to(dtype)
