"""The body model that an earlier result was fitted with, found again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hfb.errors import InputError
from hfb.tasks.core.result_folder import result_content

if TYPE_CHECKING:
    from hfb.body.model import Body
    from hfb.motion.sampled import SampledMotion

_SAME_BODY_M = 1e-3


def named_body(result: Path) -> Path | None:
    """The body model that result.json names; None where it names none or cannot be read."""
    try:
        named = result_content(result.parent)["config"]["body"]["model"]
    except (InputError, KeyError, TypeError):
        return None
    return Path(named) if isinstance(named, str) else None


def fitted_body(motion: SampledMotion, space: str, path: Path | None) -> Body:
    """The body model that a motion was fitted with.

    Args:
        space: whose betas the motion has. path: of a SMPL file; None for the embedded body.

    Raises:
        InputError: it is a SMPL file that is not given, or another one is.
    """
    import numpy as np
    import torch

    from hfb.body.assets import load_body
    from hfb.interop.writers.keys import rest_joints

    if path is None and space == "smpl":
        raise InputError("this motion was fitted with a SMPL file: give it with --body for formats with a surface")
    body = load_body(path)
    betas = torch.from_numpy(motion.betas).to(body.template.dtype)
    if body.betas_space != space or body.shape_count < len(motion.betas):
        raise InputError(
            f"the betas of this motion are {space}'s, and {body.name} has others: give the body that was fitted"
        )
    fitted = body.rest_joints(betas).double().numpy()
    far = float(np.abs(fitted - rest_joints(motion)).max())
    if far > _SAME_BODY_M:
        raise InputError(f"{body.name} is not the body that was fitted (joints {1000 * far:.0f} mm off): give that one")
    return body
