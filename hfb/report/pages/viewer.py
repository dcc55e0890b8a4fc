"""Interactive 3D viewer of a motion in a page: skinned body in WebGL2, or a skeleton without a body model.

A page holds the rest pose once and per sub-frame the rotations (16 bits), translation and joint radii, about 200 bytes:
a clip of minutes stays small. Rotations are off by 3e-5 at most, joints by less than 0.5 mm.
"""

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_NAMES, PARENTS
from hfb.geometry.rotations import axis_angle_to_quaternion
from hfb.interop.writers.keys import rest_joints
from hfb.interop.writers.skin import Skin, skin_of
from hfb.motion.sampled import SampledMotion
from hfb.report.pages.page import data_uri, page, page_file, render
from hfb.typing import Array, Shaped

_SCRIPTS = ("viewer_motion.js", "viewer_surface.js", "viewer_skeleton.js", "viewer.js")
_SETS = 2  # of four weights per vertex: what the embedded body needs
_STEPS = 32767
_UNKNOWN = 65535
_RADIUS_STEP_MM = 0.1


@dataclass(frozen=True)
class ViewedMotion:
    """A motion and its name in the viewer's menu."""

    name: str
    motion: SampledMotion


def viewer(
    motions: Sequence[ViewedMotion],
    body: Body | None,
    texture_png: bytes | None = None,
    label: str = "",
    group: str | None = None,
) -> Markup:
    """Return the viewer's markup; the page needs `viewer_scripts` too.

    Args:
        motions: of one person; the first is shown, a menu offers the others.
        body: the model they were fitted with; None for a skeleton.
        texture_png: the body's texture, a PNG file.
        label: text drawn into the view.
        group: viewers of one group share time and viewpoint.
    """
    first = motions[0].motion
    content: dict[str, Any] = {
        "names": list(JOINT_NAMES),
        "parents": list(PARENTS),
        "label": label,
        "group": group,
        "motions": [_packed(one) for one in motions],
    }
    if body is not None:
        betas = torch.from_numpy(first.betas).to(body.template.dtype)
        content["skin"] = _packed_skin(skin_of(body, betas))
        content["texture"] = data_uri(texture_png, "image/png") if texture_png else None
    scene = htmlsafe_json_dumps(content, separators=(",", ":"), allow_nan=False)
    name = hashlib.sha256(scene.encode()).hexdigest()[:8]
    return render("viewer.html", name=name, label=label, scene=scene)


def viewer_page(motions: Sequence[ViewedMotion], body: Body | None, texture_png: bytes | None, title: str) -> str:
    """Return a page that is nothing but a viewer. Arguments as of `viewer`.

    Args:
        motions: of one person.
        body: their model.
        texture_png: its texture.
        title: of the page.
    """
    return page("base.html", title, content=viewer(motions, body, texture_png), scripts=viewer_scripts())


def viewer_scripts() -> tuple[str, ...]:
    """Return the scripts that all viewers of a page need; see `hfb.report.pages.page.page`."""
    return tuple(page_file(name) for name in _SCRIPTS)


def _packed(viewed: ViewedMotion) -> dict[str, Any]:
    motion = viewed.motion
    turns = axis_angle_to_quaternion(torch.from_numpy(motion.poses).unflatten(1, (24, 3))).numpy()
    radius = motion.joint_radius_mm
    known = None
    if radius is not None and np.isfinite(radius).any():
        steps = np.nan_to_num(radius / _RADIUS_STEP_MM, nan=_UNKNOWN, posinf=_UNKNOWN)
        known = _base64(np.clip(np.round(steps), 0, _UNKNOWN).astype(np.uint16))
    return {
        "name": viewed.name,
        "times": _base64(motion.times_s.astype(np.float64)),
        "frames": _base64(motion.frame_index.astype(np.int32)),
        "turns": _base64(np.round(turns * _STEPS).astype(np.int16)),
        "places": _base64(motion.trans.astype(np.float32)),
        "rest": _base64(rest_joints(motion).astype(np.float32)),
        "radius": known,
    }


def _packed_skin(skin: Skin) -> dict[str, Any]:
    """Pack normals in 8 bits, texture coordinates in 16, weights in 8: the errors are below a pixel."""
    count = len(skin.vertices)
    joints, weights = np.zeros((2, count, 4 * _SETS))
    for number, (some, shares) in enumerate(zip(skin.joints[:_SETS], skin.weights[:_SETS], strict=True)):
        joints[:, 4 * number : 4 * number + 4], weights[:, 4 * number : 4 * number + 4] = some, shares
    packed = {
        "vertices": skin.vertices.astype(np.float32),
        "normals": np.pad(np.round(skin.normals * 127), ((0, 0), (0, 1))).astype(np.int8),
        "uv": np.round(np.clip(skin.uv, 0, 1) * 65535).astype(np.uint16),
        "joints": joints.astype(np.uint8),
        "weights": np.round(weights * 255).astype(np.uint8),
        "corners": skin.corners.astype(np.uint32),
    }
    return {name: _base64(values) for name, values in packed.items()}


def _base64(values: Shaped[Array, "..."]) -> str:
    """Encode numbers in Base64: little-endian, row by row."""
    little = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<"), copy=False)
    return base64.b64encode(little.tobytes()).decode()
