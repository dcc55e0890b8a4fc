"""Generated clothes: a texture for any body whose joints follow the SMPL layout."""

import numpy as np
import torch

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_NAMES
from hfb.photometry import srgb_to_linear
from hfb.rendering.texels import fill_texture_gutter, texel_faces
from hfb.typing import Array, Float, Int, Tensor

_SKINS = ((0.93, 0.76, 0.66), (0.82, 0.62, 0.48), (0.55, 0.38, 0.28), (0.36, 0.24, 0.18))
_HAIRS = ((0.12, 0.09, 0.07), (0.35, 0.22, 0.12), (0.75, 0.6, 0.35))
_GARMENT_OF_JOINT = {
    "shirt": ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar", "left_shoulder", "right_shoulder"),
    "trousers": ("left_hip", "right_hip", "left_knee", "right_knee"),
    "shoes": ("left_ankle", "right_ankle", "left_foot", "right_foot"),
}


def clothes_texture(body: Body, size: int, rng: np.random.Generator) -> Float[Tensor, "A A 3"]:
    """Draw a person's texture: patterned shirt, trousers and shoes, skin and hair; linear light.

    Garments follow the skinning weights, so they fit every body of the layout; the pattern is drawn in the
    rest body's own coordinates and so runs across the atlas' seams.

    Args:
        body: model whose texture coordinates are used.
        size: A, the texture's side [texels].
        rng: draws colours and pattern.
    """
    faces = texel_faces(body.mesh, size).numpy()
    face_vertices = body.mesh.faces.numpy()
    joint_of_face = body.skinning_weights.numpy()[face_vertices].sum(1).argmax(1)
    centre_of_face = body.template.numpy()[face_vertices].mean(1)
    colour_of_face = _paint(centre_of_face, joint_of_face, rng)
    srgb = np.where(faces[..., None] >= 0, colour_of_face[faces], 0.5)
    noise = rng.normal(0, 0.02, (size, size, 1))
    linear = srgb_to_linear(torch.from_numpy(np.clip(srgb + noise, 0, 1)).float())
    return fill_texture_gutter(linear, torch.from_numpy(faces))


def _paint(centre_m: Float[Array, "F 3"], joint: Int[Array, "F"], rng: np.random.Generator) -> Float[Array, "F 3"]:
    names = np.array(JOINT_NAMES)[joint]
    colour = np.tile(np.asarray(_SKINS[rng.integers(len(_SKINS))]), (len(joint), 1))
    head = names == "head"
    hair = (
        head
        & (centre_m[:, 1] > np.quantile(centre_m[head, 1], 0.6))
        & (centre_m[:, 2] < centre_m[head, 2].max() - 0.06)
    )
    colour[hair] = _HAIRS[rng.integers(len(_HAIRS))]
    for joints in _GARMENT_OF_JOINT.values():
        worn = np.isin(names, joints)
        base, stripe = rng.uniform(0.05, 0.95, (2, 3))
        axis, period_m = rng.integers(0, 2), rng.uniform(0.05, 0.2)
        striped = worn & (np.sin(2 * np.pi * centre_m[:, axis] / period_m) > rng.uniform(0, 1.2))
        colour[worn] = base
        colour[striped] = stripe
    return colour
