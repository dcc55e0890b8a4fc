"""The truth of a real case: measured joints, or an estimator's joints in every sharp frame."""

from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_COUNT, JOINT_NAMES
from hfb.datasets.real.markers import Markers, body_columns
from hfb.datasets.real.truth_source import TruthKind
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.initialization.initializer import Initializer
from hfb.io.media.lens.camera_files import CalibratedCamera
from hfb.typing import Array, Bool, Float

_LEAP_M = 0.5
_NEIGHBOURS = 2


@dataclass(frozen=True)
class SeenJoints:
    """Joints at the instants of R sharp frames, in camera coordinates.

    Attributes:
        joints: [m], NaN where unknown.
        smpl_joints: which joint of SMPL each one is.
        source: how they were measured (`truth_source.TruthKind`), or the estimator.
    """

    joints: Float[Array, "R P 3"]
    smpl_joints: tuple[int, ...]
    source: str

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(JOINT_NAMES[joint] for joint in self.smpl_joints)


def pixels_of(points_m: Float[Array, "R P 3"], camera: PinholeCamera) -> Float[Array, "R P 2"]:
    """Project points in camera coordinates; NaN where unknown or not in front of the lens.

    Args:
        points_m: camera coordinates.
        camera: pinhole camera of the image.
    """
    ahead = np.where(points_m[..., 2:] > 0.05, points_m, np.nan)
    return camera.project(torch.from_numpy(ahead)).numpy()


def measured_joints(
    markers: Markers, camera: CalibratedCamera, first: int, count: int, kind: TruthKind = "measured"
) -> SeenJoints:
    """Return the measured points that show SMPL's joints, in consecutive rows, camera coordinates.

    They are where their source puts them, some centimetres from SMPL's own joints (see truth_source.py).

    Args:
        markers: measured points.
        camera: camera of the video.
        first: number of the first frame in the video.
        count: number of frames.
        kind: how the points were measured.
    """
    columns, joints = body_columns(markers.names)
    rows = markers.rows(first, count)[:, columns]
    return SeenJoints(camera.to_camera(rows), tuple(joints), kind)


def all_points(markers: Markers, camera: CalibratedCamera, first: int, count: int) -> Float[Array, "R M 3"]:
    """Return every measured point but the nose, also those that SMPL lacks, in camera coordinates: the person's extent.

    Args:
        markers: measured points.
        camera: camera of the video.
        first: number of the first frame in the video.
        count: number of frames.
    """
    kept = [column for column, name in enumerate(markers.names) if name.lower() != "nose"]  # often far off
    return camera.to_camera(markers.rows(first, count))[:, kept]


def share_inside(pixels: Float[Array, "R P 2"], masks: Bool[Array, "R H W"]) -> float:
    """Return the share of the known joints that project onto the mask of their own frame.

    Args:
        pixels: pixels of the joints [px], NaN where unknown.
        masks: masks of the frames.
    """
    rows, _ = np.nonzero(np.isfinite(pixels).all(-1))
    x, y = np.floor(pixels[np.isfinite(pixels).all(-1)]).astype(int).T
    height, width = masks.shape[1:]
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    return float(masks[rows[inside], y[inside], x[inside]].sum() / max(len(rows), 1))


class SharpEstimates:
    """An estimator's results in sharp frames, one after another.

    Args:
        initializer: the estimator.
        body: model of the estimates.
        plate_linear: background through the case's view, linear light.
        camera: pinhole camera of the view.
    """

    def __init__(
        self, initializer: Initializer, body: Body, plate_linear: Float[Array, "H W 3"], camera: PinholeCamera
    ) -> None:
        self._initializer, self._body, self._plate, self._camera = initializer, body, plate_linear, camera
        self._rows: list[Float[Array, "24 3"]] = []
        self._sources: list[str] = []

    def add(self, frame_linear: Float[Array, "H W 3"], matte: Float[Array, "H W"]) -> None:
        """Estimate one frame; where the estimator finds nobody the row is unknown.

        Args:
            frame_linear: sharp frame, linear light.
            matte: matte of the frame.
        """
        try:
            first = self._initializer(frame_linear, self._plate, matte, self._camera, self._body)
        except InputError:
            self._rows.append(np.full((JOINT_COUNT, 3), np.nan))
            return
        dtype = self._body.template.dtype
        rotations = axis_angle_to_matrix(first.pose.to(dtype))[None]
        shaped = self._body.shape(first.betas.to(dtype))
        joints = shaped.joints_of(rotations, first.translation.to(dtype)[None])[0]
        self._rows.append(joints.detach().double().numpy())
        self._sources.append(first.source)

    def joints(self) -> SeenJoints:
        """Return the joints of all frames, leaps removed (see `without_leaps`).

        Raises:
            InputError: more than half of the frames have no estimate.
        """
        joints = without_leaps(np.stack(self._rows))
        if np.isfinite(joints[:, 0]).all(-1).mean() < 0.5:
            raise InputError("the estimator sees the person in fewer than half of the sharp frames; choose others.")
        source = max(sorted(set(self._sources)), key=self._sources.count)
        return SeenJoints(joints, tuple(range(JOINT_COUNT)), source)


def without_leaps(joints: Float[Array, "R 24 3"]) -> Float[Array, "R 24 3"]:
    """Set joints to NaN that are over half a metre from the median of their neighbours in time.

    Distances are taken about the pelvis, since a single view's depth of the whole person may flicker. A frame in which
    more than half of the joints leap is unknown as a whole.

    Args:
        joints: camera coordinates [m].
    """
    centred = joints - joints[:, :1]
    leaps: Bool[Array, "R 24"] = np.zeros(joints.shape[:2], bool)
    for row in range(len(joints)):
        near = centred[max(0, row - _NEIGHBOURS) : row + _NEIGHBOURS + 1]
        near = near[np.isfinite(near).all((1, 2))]
        if len(near) >= 3:
            leaps[row] = np.linalg.norm(centred[row] - np.median(near, axis=0), axis=-1) > _LEAP_M
    leaps |= leaps.mean(1, keepdims=True) > 0.5
    return np.where(leaps[..., None], np.nan, joints)
