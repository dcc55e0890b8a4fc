"""Shape from Blur and Motion from Blur, re-implemented on our renderer from the papers.

SfB: Rozumnyi et al., Shape from Blur: Recovering Textured 3D Shape and Motion of Fast Moving Objects, NeurIPS 2021;
MfB: Rozumnyi et al., Motion-from-Blur: 3D Shape and Motion Estimation of Motion-Blurred Objects in Videos, CVPR 2022.
One object of unknown shape, a deforming textured sphere, moves rigidly along a polynomial; its sub-frames' average
is compared with the frame. Unlike theirs, translation and rotation run on one clock, and no network gives sub-frame
silhouettes: only the matte is used.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from hfb.datasets.case import Case
from hfb.evaluation.baselines.frames import one_by_one
from hfb.evaluation.baselines.sphere import Sphere, make_sphere
from hfb.evaluation.baselines.sphere_start import SphereStart, shutter_tau, sphere_starts
from hfb.evaluation.prediction import Prediction
from hfb.fitting.variables import mean_foreground
from hfb.geometry.rotations import normalize_quaternion, quaternion_to_matrix
from hfb.kernels.determinism import one_torch_thread
from hfb.motion.static_pose import FirstBody
from hfb.objective.image import robust_image_loss
from hfb.objective.matting import matting_loss
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Float, Tensor

_TEXTURE_PX = 64
_REACH = 0.7  # how far a vertex may move, in units of the ellipsoid's half axes
_IMAGE, _MATTE, _SMOOTH, _VARIATION = 2.0, 1.0, 20.0, 0.05
_RATES = {"path": 0.015, "turn": 0.03, "offsets": 0.03, "texture": 0.03}
_STAGES = ((64, 50), (128, 60), (256, 60))  # longer side of the region [px], iterations


@dataclass(frozen=True)
class _Free:
    """The variables that SfB optimises.

    Attributes:
        path: polynomial of the centre [m].
        turn: polynomial of the quaternion without its constant: the shape has no front.
        offsets: per vertex, before they are bounded.
        axes_m: axes of the initial ellipsoid; fixed.
    """

    path: Float[Tensor, "D1 3"]
    turn: Float[Tensor, "D 4"]
    offsets: Float[Tensor, "V 3"]
    texture: Float[Tensor, "A A 3"]
    axes_m: Float[Tensor, "3"]

    def vertices(self, sphere: Sphere, tau: Float[Tensor, "S"]) -> Float[Tensor, "S V 3"]:
        """Return the object [m] in camera coordinates at some times."""
        powers = tau[:, None] ** torch.arange(len(self.path))
        quaternion = powers[:, 1:] @ self.turn + tau.new_tensor([1.0, 0, 0, 0])
        R_camera_object = quaternion_to_matrix(normalize_quaternion(quaternion))
        shape = self.axes_m * (sphere.vertices + _REACH * torch.tanh(self.offsets))
        return shape @ R_camera_object.transpose(1, 2) + (powers @ self.path)[:, None]

    def detached(self) -> "_Free":
        """Return a detached copy."""
        return _Free(*(getattr(self, name).detach().clone() for name in self.__dataclass_fields__))


class ShapeFromBlur:
    """SfB: every frame alone. MfB: one object and one motion through all frames, the gaps between them included.

    Args:
        name: name of the method.
        together: fit one motion to all frames (MfB).
        subframes: rows per frame.
        stages: longer side of the region [px] and number of iterations of each stage.
    """

    def __init__(self, name: str, together: bool, subframes: int, stages: Sequence[tuple[int, int]] = _STAGES) -> None:
        self.name = name
        self._together = together
        self._subframes = subframes
        self._stages = tuple(stages)
        self._sphere = make_sphere()
        self._rasterizer = make_rasterizer("coverage", "cpu", threads=1)

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """Predict silhouettes and images of the object, without a pose; neither case nor starts are used."""
        started = time.perf_counter()
        with one_torch_thread():
            if self._together:
                pictures = self._explain(observation)
            else:
                pictures = torch.cat([self._explain(frame) for frame in one_by_one(observation)])
        drawn = pictures.numpy()
        return Prediction(None, drawn[..., 3] >= 0.5, drawn, time.perf_counter() - started)

    def _explain(self, observation: Observation) -> Float[Tensor, "R H W 4"]:
        frames = len(observation.mattes)
        window = observation.cropped(*observation.region())
        colour = mean_foreground(observation).expand(_TEXTURE_PX, _TEXTURE_PX, 3)
        # A parabola per frame; a path through several frames gets one more degree for each of them.
        guesses = [_begin(start, self._sphere, colour) for start in sphere_starts(observation, 1 + frames)]
        first, *finer = [stage for stage in self._stages if stage[1] > 0]
        tried = [self._optimise(guess, window, *first) for guess in guesses]
        best = min(tried, key=lambda one: one[0])[1]
        for stage in finer:
            best = self._optimise(best, window, *stage)[1]
        with torch.no_grad():
            vertices = best.vertices(self._sphere, shutter_tau(observation, self._subframes).flatten())
            return self._rasterizer.render(vertices, best.texture, observation.camera, self._sphere.mesh)

    def _optimise(self, start: _Free, window: Observation, size_px: int, iterations: int) -> tuple[float, _Free]:
        """Run Adam at one image size; return the best loss and iterate."""
        seen = window.resized(size_px)
        tau = shutter_tau(seen, self._subframes)
        free = start.detached()
        groups = [{"params": [getattr(free, name).requires_grad_()], "lr": rate} for name, rate in _RATES.items()]
        optimizer = torch.optim.Adam(groups)
        best, best_loss = start, math.inf
        for iteration in range(iterations):
            loss = _loss(free, self._sphere, seen, tau, self._rasterizer)
            if not math.isfinite(loss.item()):
                raise FloatingPointError(f"the loss is not a number any more at iteration {iteration} of {self.name}")
            if loss.item() < best_loss:
                best, best_loss = free.detached(), loss.item()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            with torch.no_grad():
                free.texture.clamp_(0, 1)
        return best_loss, best


def _begin(start: SphereStart, sphere: Sphere, colour: Float[Tensor, "A A 3"]) -> _Free:
    still = torch.zeros(len(start.path_m) - 1, 4)
    return _Free(start.path_m, still, torch.zeros_like(sphere.vertices), colour, start.axes_m).detached()


def _loss(
    free: _Free, sphere: Sphere, seen: Observation, tau: Float[Tensor, "T S"], rasterizer: Rasterizer
) -> Float[Tensor, ""]:
    """Return SfB's terms: image formation and silhouette as means over the frames, Laplacian, total variation."""
    losses = []
    for frame, matte, times in zip(seen.frames_linear, seen.mattes, tau, strict=True):
        mean = rasterizer.render_mean(free.vertices(sphere, times), free.texture, seen.camera, sphere.mesh)
        image = robust_image_loss(compose(mean, seen.plate_linear), frame, matte.sum())
        losses.append(_IMAGE * image + _MATTE * matting_loss(mean[..., 3], matte))
    bumps = sphere.laplacian(torch.tanh(free.offsets)).square().sum(1).mean()
    variation = free.texture.diff(dim=0).abs().mean() + free.texture.diff(dim=1).abs().mean()
    return torch.stack(losses).mean() + _SMOOTH * bumps + _VARIATION * variation
