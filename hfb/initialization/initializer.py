"""Initialisers of a fit's static body: by pose networks where available, else by the matte alone."""

from dataclasses import replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from hfb.body.height import as_tall, height_line
from hfb.body.model import Body
from hfb.config import OWN_NETWORKS, InitConfig
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.initialization.joint_layouts import keypoints_as_24
from hfb.initialization.keypoint_network import KeypointNetwork
from hfb.initialization.keypoint_registration import register_keypoints
from hfb.initialization.landmark_lift import lift_landmarks
from hfb.initialization.landmarks import Landmarks, PoseNetworks, networks_ready
from hfb.initialization.lean import less_lean
from hfb.initialization.matte_search import search_by_matte
from hfb.initialization.network_body import MetroBody
from hfb.initialization.person_landmarks import find_landmarks
from hfb.initialization.registration import register
from hfb.initialization.silhouette_fit import SilhouetteStage, Stay, matte_level, overlap, refine
from hfb.initialization.swept_search import carried_along, search_swept
from hfb.motion.static_pose import FirstBody, rescale_first_body
from hfb.networks.mediapipe_files import LandmarkChoice
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Array, Float, Tensor

Picture = Float[Tensor, "H W 3"] | Float[Array, "H W 3"]
Matte = Float[Tensor, "H W"] | Float[Array, "H W"]

_LEAST_MATTE_PX = 64.0
_COMPARE_PX = 128
_CONFIDENT_AGREEMENT = 0.35  # stick figure against matte; invented people stay below
_WORTH_ANOTHER_LOOK = 0.5  # soft IoU below which the matte's own search is tried as well
_CLEARLY_BETTER = 0.08  # what a body of unknown front and back must gain over one seen by the networks
_CLEARLY_MOVING = 0.1  # what a straight path must gain over standing still
_REFINEMENT = (SilhouetteStage(64, 40, 0.02, shape=False), SilhouetteStage(_COMPARE_PX, 30, 0.015))
_ABOUT_AS_GOOD = 0.03  # a smear hardly determines a pose: the one found at rest is nearer to the truth
_SAME_DISTANCE = 0.05  # but a smear determines the distance, and a body found at rest is mostly too near
_STAY_ON_THE_WAY = Stay(pose=0.02, root=0.1, prior=0.004, betas=0.05)
_STAY_BY_LANDMARKS = Stay(pose=1.5, root=10.0, place=0.5)  # no outline shows how far a body leans in depth


@runtime_checkable
class Initializer(Protocol):
    """Estimates one static body for one frame."""

    def __call__(
        self, frame_linear: Picture, plate_linear: Picture, matte: Matte, camera: PinholeCamera, body: Body
    ) -> FirstBody:
        """Return the body in camera coordinates.

        Args:
            frame_linear: blurred frame, linear light.
            plate_linear: background plate, linear light.
            matte: the person's alpha in [0, 1].
            camera: pinhole camera of the frame.
            body: model of the result.

        Raises:
            InputError: the matte is empty, or no person is found.
        """
        ...


def make_initializer(config: InitConfig, rasterizer: Rasterizer | None = None) -> Initializer:
    """Return the initialiser that the configuration names.

    Args:
        config: options of the first body.
        rasterizer: the coverage silhouette by default; DIB-R's halo would place the body too far away.
    """
    drawing = rasterizer or make_rasterizer("coverage")
    if config.method == "matte":
        return MatteInitializer(drawing)
    if config.method in OWN_NETWORKS:
        if config.weights is None:
            raise InputError(f"--init {config.method} needs the network's file: give it with --init-weights FILE")
        if config.method == "keypoints":
            return KeypointInitializer(drawing, config.weights)
        return MetroBody(config.weights, drawing, config.mesh_sampling)
    if config.method == "mediapipe":
        return LandmarkInitializer(drawing, config.landmarks)
    return AutoInitializer(drawing, config.landmarks)


class MatteInitializer:
    """Render and compare with generic poses: no network, no colour (see matte_search.py, swept_search.py).

    Args:
        rasterizer: draws silhouettes.
    """

    def __init__(self, rasterizer: Rasterizer) -> None:
        self._rasterizer = rasterizer

    def __call__(
        self, frame_linear: Picture, plate_linear: Picture, matte: Matte, camera: PinholeCamera, body: Body
    ) -> FirstBody:
        """See `Initializer`."""
        return _searched(_checked(matte), camera, body, self._rasterizer)[0]


class LandmarkInitializer:
    """MediaPipe's landmarks, registered to the body, then refined to the matte while staying near the landmarks.

    Args:
        rasterizer: draws silhouettes.
        choice: choice among the landmark networks.
    """

    def __init__(self, rasterizer: Rasterizer, choice: LandmarkChoice = "auto") -> None:
        self._rasterizer = rasterizer
        self._networks = PoseNetworks(choice)

    def __call__(
        self, frame_linear: Picture, plate_linear: Picture, matte: Matte, camera: PinholeCamera, body: Body
    ) -> FirstBody:
        """See `Initializer`."""
        alpha = _checked(matte)
        found = self.landmarks(frame_linear, plate_linear, alpha)
        if found is None:
            raise InputError(
                "the pose networks found no person in the frame; use `--init.method matte`, or a frame with less blur."
            )
        return self.body(found[0], alpha, camera, body)

    def landmarks(
        self, frame_linear: Picture, plate_linear: Picture, matte: Float[Array, "H W"]
    ) -> tuple[Landmarks, float] | None:
        """Return the person's landmarks and their agreement with the matte.

        Args:
            frame_linear: the frame.
            plate_linear: background plate, linear light.
            matte: the person's share of each pixel.
        """
        return find_landmarks(self._networks, _array(frame_linear), _array(plate_linear), matte)

    def body(self, landmarks: Landmarks, matte: Float[Array, "H W"], camera: PinholeCamera, body: Body) -> FirstBody:
        """Register, then refine, which is kept only where it shares more with the matte; then lessen the lean.

        Args:
            landmarks: landmarks of the person.
            matte: the person's share of each pixel.
            camera: camera of the image.
            body: the body model.
        """
        first = register(landmarks, lift_landmarks(landmarks, camera), camera, body)
        return _nearer_to_matte(first, matte, camera, body, self._rasterizer)


class KeypointInitializer:
    """A user's network of 2D keypoints, to which the body is registered, then refined as after MediaPipe's landmarks.

    Args:
        rasterizer: draws silhouettes.
        weights: file of the network.

    Raises:
        InputError: the file is none that `KeypointNetwork` takes.
    """

    def __init__(self, rasterizer: Rasterizer, weights: Path) -> None:
        self._rasterizer = rasterizer
        self._network = KeypointNetwork(weights)

    def __call__(
        self, frame_linear: Picture, plate_linear: Picture, matte: Matte, camera: PinholeCamera, body: Body
    ) -> FirstBody:
        """See `Initializer`."""
        alpha = _checked(matte)
        joints = keypoints_as_24(self._network.find(_array(frame_linear), _array(plate_linear), alpha))
        found = register_keypoints(joints[None], camera, body)
        first = FirstBody(found.poses[0], found.translations[0], found.betas, "keypoints")
        return _nearer_to_matte(first, alpha, camera, body, self._rasterizer)


class AutoInitializer:
    """The networks where available and certain, else the matte's search; where both are uncertain the better one.

    Args:
        rasterizer: draws silhouettes.
        choice: choice among the landmark networks.
    """

    def __init__(self, rasterizer: Rasterizer, choice: LandmarkChoice = "auto") -> None:
        self._rasterizer = rasterizer
        self._by_landmarks = LandmarkInitializer(rasterizer, choice) if networks_ready(choice) else None

    def __call__(
        self, frame_linear: Picture, plate_linear: Picture, matte: Matte, camera: PinholeCamera, body: Body
    ) -> FirstBody:
        """See `Initializer`."""
        alpha = _checked(matte)
        found = self._by_landmarks.landmarks(frame_linear, plate_linear, alpha) if self._by_landmarks else None
        if self._by_landmarks is None or found is None or found[1] < _CONFIDENT_AGREEMENT:
            return _searched(alpha, camera, body, self._rasterizer)[0]
        first = self._by_landmarks.body(found[0], alpha, camera, body)
        shared = overlap(first, matte_level(alpha, camera, _COMPARE_PX), body, self._rasterizer)
        if shared < _WORTH_ANOTHER_LOOK:
            scene = (alpha, camera, body, self._rasterizer)
            other, other_shared, path = _searched(*scene)
            if path is not None:  # they may share more along that path, too
                moving = carried_along(first, path, *scene, _STAY_BY_LANDMARKS)
                if moving.shared > shared + _CLEARLY_MOVING:
                    first, shared = moving.first, moving.shared
            if other_shared > shared + _CLEARLY_BETTER:
                return other
        return first


def _searched(
    matte: Float[Array, "H W"], camera: PinholeCamera, body: Body, rasterizer: Rasterizer
) -> tuple[FirstBody, float, Float[Tensor, "3"] | None]:
    """Return the body by the matte alone, its overlap and its path; a path is tried where the overlap is below half."""
    first, shared = search_by_matte(matte, camera, body, rasterizer)
    if shared < _WORTH_ANOTHER_LOOK:
        moving = search_swept(matte, camera, body, rasterizer)
        if moving.shared > shared + _CLEARLY_MOVING:
            # A body at rest fits only the densest part, often at another distance: start there, and at the path's.
            starts = first, replace(first, translation=moving.first.translation)
            tries = [
                carried_along(start, moving.travel_m, matte, camera, body, rasterizer, _STAY_ON_THE_WAY)
                for start in starts
            ]
            distance_m = float(moving.first.translation[2])
            tries = [one for one in tries if abs(float(one.first.translation[2]) / distance_m - 1) < _SAME_DISTANCE]
            other = max(tries, key=lambda one: one.shared, default=moving)
            best = other if other.shared > moving.shared - _ABOUT_AS_GOOD else moving
            return best.first, best.shared, best.travel_m
    return first, shared, None


def _nearer_to_matte(
    first: FirstBody, matte: Float[Array, "H W"], camera: PinholeCamera, body: Body, rasterizer: Rasterizer
) -> FirstBody:
    """Refine a body that a network saw, which is kept only where it shares more with the matte; lessen its lean.

    No image shows how tall somebody is: the mean height stays, the distance follows.
    """
    closer = refine(first, matte, camera, body, rasterizer, _REFINEMENT, _STAY_BY_LANDMARKS)
    level = matte_level(matte, camera, _COMPARE_PX)
    nearer = max((closer, first), key=lambda one: overlap(one, level, body, rasterizer))
    mean_m, _ = height_line(body)
    return less_lean(rescale_first_body(nearer, as_tall(nearer.betas, body, mean_m), body), body)


def _array(picture: Picture) -> Float[Array, "H W 3"]:
    return np.asarray(picture, np.float32)


def _checked(matte: Matte) -> Float[Array, "H W"]:
    """Return the matte as an array; raise an error where it is empty."""
    alpha = np.clip(np.asarray(matte, np.float32), 0, 1)
    if float(alpha.sum()) < _LEAST_MATTE_PX or float(alpha.max()) < 0.2:
        raise InputError("no person was found: the matte is empty; check the frame and the background plate.")
    return alpha
