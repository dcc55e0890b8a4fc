"""METRO, the paper's start: a user's exported network, to whose mesh or joints the body is registered.

Input: the person's square at 224 px, normalised as ImageNet. Outputs, distinguished by their sizes: a weak-perspective
camera (3), 14 joints, vertices (431, 1723, 6890); y points down, metres, about the pelvis. SMPL is registered to its
own mesh, another body to the joints.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from hfb.body.model import Body
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rays import seen_along
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.initialization.joint_layouts import joints_as_24
from hfb.initialization.person_crop import cut_square, person_square, weak_perspective_place
from hfb.initialization.point_registration import Registered, only_vertices, register_joints, register_vertices
from hfb.initialization.silhouette_fit import SilhouetteStage, Stay, matte_level, overlap, refine
from hfb.io.safe.contents import named, read_contents
from hfb.io.safe.pickled_arrays import to_array
from hfb.motion.static_pose import FirstBody
from hfb.networks.runtimes import Outputs, load_network, normalised
from hfb.photometry import linear_to_srgb
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Array, Float, Int, Tensor

_SIZE_PX, _MARGIN = 224, 1.2
_COMPARE_PX = 96
_STAGES = (SilhouetteStage(64, 30, 0.02), SilhouetteStage(_COMPARE_PX, 20, 0.015))
_STAY = Stay(pose=0.05, root=0.1, place=0.1)


class MetroBody:
    """An `Initializer` by a network with METRO's interface.

    Args:
        weights: file of the network.
        rasterizer: draws silhouettes.
        mesh_sampling: file that relates METRO's coarse meshes to the full one, or None.
    """

    def __init__(self, weights: Path, rasterizer: Rasterizer, mesh_sampling: Path | None = None) -> None:
        """Load the files, see `hfb.config.InitConfig`. Raises InputError where a file is not as expected."""
        self._network = load_network(weights)
        self._rasterizer = rasterizer
        self._samplings = () if mesh_sampling is None else read_samplings(mesh_sampling)

    def __call__(
        self,
        frame_linear: Float[Tensor, "H W 3"] | Float[Array, "H W 3"],
        plate_linear: Float[Tensor, "H W 3"] | Float[Array, "H W 3"],
        matte: Float[Tensor, "H W"] | Float[Array, "H W"],
        camera: PinholeCamera,
        body: Body,
    ) -> FirstBody:
        """See `Initializer`."""
        alpha = np.clip(np.asarray(matte, np.float32), 0, 1)
        picture = linear_to_srgb(np.clip(np.asarray(frame_linear, np.float32), 0, 1)).astype(np.float32)
        left, top, side = person_square(alpha, _MARGIN)
        outputs = self._network([normalised(cut_square(picture, left, top, side, _SIZE_PX), "imagenet", "rgb")])
        scale, x, y = _output(outputs, (3,), "a camera").tolist()
        place = weak_perspective_place(scale, x, y, (left + side / 2, top + side / 2), side, camera)
        first = registered(outputs, body, self._samplings)
        first = _placed(first, place, body)
        closer = refine(first, alpha, camera, body, self._rasterizer, _STAGES, _STAY)
        level = matte_level(alpha, camera, _COMPARE_PX)
        return max((closer, first), key=lambda one: overlap(one, level, body, self._rasterizer))


def read_samplings(path: Path) -> tuple[Int[Array, "..."], ...]:
    """Read which vertices of the full mesh METRO's coarse ones keep, the finest first.

    mesh_downsampling.npz has under ``D`` a sparse matrix per step with a single one in every row (Ranjan et al. 2018,
    "Generating 3D faces using convolutional mesh autoencoders", section 3).

    Args:
        path: the file.

    Raises:
        InputError: another file, or a pickle in it that names code.
    """
    try:
        steps = named(read_contents(path)).get("D")
        kept: list[Int[Array, ...]] = []
        for step in steps if isinstance(steps, list) else ():
            matrix = to_array(step)
            if matrix.ndim != 2 or not ((matrix != 0).sum(1) == 1).all():
                raise InputError("its steps do not each keep some of the vertices")
            if kept and matrix.shape[1] != len(kept[-1]):
                raise InputError("its steps do not follow one another")
            chosen = matrix.argmax(1)
            kept.append(kept[-1][chosen] if kept else chosen)
    except InputError as error:
        raise InputError(f"{path} is not METRO's mesh_downsampling.npz ({error})") from error
    if not kept:
        raise InputError(f"{path} is not METRO's mesh_downsampling.npz: it has no matrices D")
    return tuple(kept)


def registered(outputs: Outputs, body: Body, samplings: Sequence[Int[Array, "..."]] = ()) -> FirstBody:
    """Fit the body to a network's mesh, where it is this body's, else to its joints; about the network's origin.

    Args:
        outputs: outputs of the network.
        body: the body model.
        samplings: see `read_samplings`; a coarse mesh is taken where there is no full one.

    Raises:
        InputError: nothing fits: the sentence says what the network gave.
    """
    found = _on_mesh(outputs, body, samplings)
    if found is None:
        joints = _find(outputs, [(24, 3), (17, 3), (14, 3)])
        if joints is None:
            shapes = ", ".join(str(array.shape) for array in outputs.arrays)
            raise InputError(
                f"{outputs.source} gave {shapes}: a mesh needs the SMPL file it belongs to (--body.model), a coarse "
                "one METRO's mesh_downsampling.npz too (--init.mesh-sampling), another body 14, 17 or 24 joints"
            )
        found = register_joints(joints_as_24(joints.astype(np.float64))[None], body)
    return FirstBody(found.poses[0], found.translations[0], found.betas, "metro")


def _on_mesh(outputs: Outputs, body: Body, samplings: Sequence[Int[Array, "..."]]) -> Registered | None:
    """Fit the body to the finest mesh that the network gives."""
    if body.betas_space != "smpl":
        return None
    count = len(body.template)
    for kept in (np.arange(count), *(one for one in samplings if one.max() < count)):
        mesh = _find(outputs, [(len(kept), 3)])
        if mesh is not None:
            return register_vertices(mesh[None].astype(np.float64), only_vertices(body, torch.from_numpy(kept)))
    return None


def _placed(first: FirstBody, place: Float[Tensor, "3"], body: Body) -> FirstBody:
    """Place the body before the camera, turned with the ray of the crop's middle, about the network's origin."""
    turn = seen_along(place).to(first.pose)
    root = matrix_to_axis_angle(turn @ axis_angle_to_matrix(first.pose[0]))
    rest = body.rest_joints(first.betas)[0]
    pelvis = turn @ (rest + first.translation) + place.to(first.pose)
    return replace(first, pose=torch.cat([root[None], first.pose[1:]]), translation=pelvis - rest)


def _find(outputs: Outputs, shapes: Sequence[tuple[int, int]]) -> Float[Array, "n 3"] | None:
    """Return the first output with one of these shapes, apart from sides of one."""
    for shape in shapes:
        for array in outputs.arrays:
            if tuple(side for side in array.shape if side != 1) == shape:
                return array.reshape(shape)
    return None


def _output(outputs: Outputs, shape: tuple[int, ...], what: str) -> Float[Array, "n"]:
    for array in outputs.arrays:
        if tuple(side for side in array.shape if side != 1) == shape:
            return array.reshape(shape)
    shapes = ", ".join(str(array.shape) for array in outputs.arrays)
    raise InputError(f"{outputs.source} gave {shapes}, and none of these is {what}: is it METRO?")
