"""The joint network: joints with error scales from a blurred image of a person and a first guess.

Joints are in units of a window around the matte, in weak perspective: x and y in [-1, 1] from edge to edge, and z the
depth behind the pelvis in the same units at the pelvis' distance. Predictions then do not depend on the image size, the
focal length or the person's distance.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional

from hfb.body.skeleton import JOINT_COUNT, PARENT_OR_SELF
from hfb.geometry.camera import PinholeCamera
from hfb.matting.matting_protocol import matte_region
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float, Shaped, Tensor

PICTURE_PX = 96
CHANNELS = 7
ROUNDS = 3
_EXCHANGES = 4

_MARGIN = 0.12
_LOG_HEIGHT, _LOG_HEIGHT_UNIT = math.log(1.7), 0.1
"""About mean and standard deviation of adults' heights [m], as logarithms: scales the output to about unit size."""
_MAP, _DETAIL = 64, 32
_LOOKS = (
    (0.0, 0.0),
    (0.08, 0.0),
    (-0.08, 0.0),
    (0.0, 0.08),
    (0.0, -0.08),
    (0.25, 0.0),
    (-0.25, 0.0),
    (0.0, 0.25),
    (0.0, -0.25),
)
"""Sampling offsets around a joint, in the window's units; half of them for the finer map."""


@dataclass(frozen=True)
class Widths:
    """Channels of the five layers from fine to coarse, and size of a joint's token."""

    layers: tuple[int, int, int, int, int]
    token: int


SMALL = Widths((24, 32, 48, 80, 128), 128)
WIDE = Widths((24, 32, 96, 160, 256), 256)
SHIPPED = WIDE


@dataclass(frozen=True)
class Window:
    """A square of an image [px] and the camera of that image."""

    left: float
    top: float
    side: float
    camera: PinholeCamera

    @staticmethod
    def around(matte: Float[Array, "H W"], camera: PinholeCamera, jitter: Float[Array, "3"] | None = None) -> "Window":
        """Return the square around a matte's box, with a margin.

        Args:
            matte: the person's share of each pixel.
            camera: camera of the image.
            jitter: for training: shifts in x and y and the logarithm of a scale, as shares of the side.

        Raises:
            InputError: the matte is empty.
        """
        top, left, bottom, right = matte_region(matte, 0.0)
        side = (1 + 2 * _MARGIN) * max(bottom - top, right - left)
        x, y = (left + right) / 2, (top + bottom) / 2
        if jitter is not None:
            side *= float(np.exp(jitter[2]))
            x, y = x + side * float(jitter[0]), y + side * float(jitter[1])
        return Window(x - side / 2, y - side / 2, side, camera)

    def within(self, camera: PinholeCamera) -> "Window":
        """Return the same lines of sight in a crop or another size of the image.

        Args:
            camera: camera of a crop or a resized image.
        """
        across, down = camera.fx / self.camera.fx, camera.fy / self.camera.fy
        left = camera.cx + across * (self.left - self.camera.cx)
        top = camera.cy + down * (self.top - self.camera.cy)
        return Window(left, top, across * self.side, camera)

    def units_to_tangents(self) -> float:
        """Return the tangent of the line of sight that is one unit of the window: times a distance, metres."""
        return self.side / 2 / self.camera.fx

    def lens(self) -> tuple[float, float, float, float, float]:
        """Return factors and shifts of x and y from tangents to units, and `units_to_tangents`, for `in_units`."""
        camera, per_px = self.camera, 2 / self.side
        shifts = (camera.cx - self.left) * per_px - 1, (camera.cy - self.top) * per_px - 1
        return camera.fx * per_px, camera.fy * per_px, *shifts, self.units_to_tangents()

    def to_units(self, joints: Float[Tensor, "*n 24 3"]) -> Float[Tensor, "*n 24 3"]:
        """Convert joints to units of the window; differentiable.

        Args:
            joints: camera coordinates [m].
        """
        return in_units(joints, joints.new_tensor(self.lens()))

    def cut(self, picture: Float[Array, "H W *c"], outside: int) -> Float[Array, "h w *c"]:
        """Cut the window out of an image and resize it to `PICTURE_PX` by area average.

        Args:
            picture: the window's image.
            outside: OpenCV's border mode.
        """
        side = max(round(self.side), 2)
        left, top = round(self.left), round(self.top)
        height, width = picture.shape[:2]
        pads = (max(-top, 0), max(top + side - height, 0), max(-left, 0), max(left + side - width, 0))
        inside = picture[max(top, 0) : min(top + side, height), max(left, 0) : min(left + side, width)]
        square = cv2.copyMakeBorder(np.ascontiguousarray(inside), *pads, outside, value=0)
        how = cv2.INTER_AREA if side > PICTURE_PX else cv2.INTER_LINEAR
        return cv2.resize(square, (PICTURE_PX, PICTURE_PX), interpolation=how)


def in_units(joints: Float[Tensor, "*n 24 3"], lens: Float[Tensor, "*m 5"]) -> Float[Tensor, "*n 24 3"]:
    """Convert joints to units of windows; differentiable.

    Args:
        joints: camera coordinates [m].
        lens: lens of every window, see `Window.lens`.
    """
    depth = joints[..., 2:]
    across = joints[..., :2] / depth * lens[..., :2] + lens[..., 2:4]
    pelvis = depth[..., :1, :]
    return torch.cat([across, (depth - pelvis) / (pelvis * lens[..., 4:])], -1)


def picture_channels(
    frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], matte: Float[Array, "H W"], window: Window
) -> Shaped[Array, "C h w"]:
    """Return the network's input channels: matte, frame, and difference from the plate; 8 bits.

    Args:
        frame_linear: the frame.
        plate_linear: the background.
        matte: the person's share of each pixel.
        window: square to cut out.
    """
    frame, plate = (window.cut(one, cv2.BORDER_REPLICATE) for one in (frame_linear, plate_linear))
    frame, plate = (linear_to_srgb(np.clip(one, 0, 1)) for one in (frame, plate))
    alpha = window.cut(matte, cv2.BORDER_CONSTANT)[..., None]
    seen = np.concatenate([alpha, frame, (frame - plate) / 2 + 0.5], -1)
    return (np.clip(seen, 0, 1) * 255).round().astype(np.uint8).transpose(2, 0, 1)


@dataclass(frozen=True)
class JointClaim:
    """Predictions for N images, in units of their windows.

    Attributes:
        joints: at the middle of the exposure.
        log_scale: logarithm of the Laplace scale of each coordinate.
        path: displacement during the exposure; one image does not determine its sign.
        log_odds: log odds that the sign of ``path`` is right, for the whole body.
        log_height: logarithm of the standing height [m], by proportions.
        height_scale: standard deviation of ``log_height``.
        rounds: ``joints`` after each round, the last one included.
    """

    joints: Float[Tensor, "N 24 3"]
    log_scale: Float[Tensor, "N 24 3"]
    path: Float[Tensor, "N 24 3"]
    log_odds: Float[Tensor, "N"]
    log_height: Float[Tensor, "N"]
    height_scale: Float[Tensor, "N"]
    rounds: tuple[Float[Tensor, "N 24 3"], ...]


class JointNetwork(nn.Module):
    """One feature map per image; three rounds that sample it around every joint and move the joint.

    Args:
        widths: sizes of the layers.
    """

    def __init__(self, widths: Widths = SHIPPED) -> None:
        super().__init__()
        a, b, c, d, e = widths.layers
        token = widths.token
        self.fine = nn.Sequential(_layer(CHANNELS, a, 2), _layer(a, b), _layer(b, c, 2), _layer(c, c), _layer(c, c))
        self.middle = nn.Sequential(_layer(c, d, 2), _layer(d, d), _layer(d, d))
        self.coarse = nn.Sequential(_layer(d, e, 2), _layer(e, e), _layer(e, e))
        self.down = nn.Conv2d(e, _MAP, 1)
        self.across = nn.Conv2d(d, _MAP, 1)
        self.side = nn.Conv2d(c, _MAP, 1)
        self.mixed_middle, self.mixed_fine = _layer(_MAP, _MAP), _layer(_MAP, _MAP)
        self.closer, self.edges = nn.Conv2d(_MAP, _DETAIL, 1), nn.Conv2d(b, _DETAIL, 1)
        self.mixed_edges = _layer(_DETAIL, _DETAIL)
        self.whole = nn.Linear(e, token)
        self.name = nn.Parameter(torch.randn(JOINT_COUNT + 1, token) * 0.02)
        self.read = nn.Linear(len(_LOOKS) * _MAP + 12, token)
        self.read_closer = nn.Linear(len(_LOOKS) * _DETAIL, token, bias=False)
        self.exchange = nn.ModuleList(_Exchange(token) for _ in range(_EXCHANGES))
        self.move = nn.Linear(token, 3)
        self.say = nn.Linear(token, 6)
        self.turn = nn.Linear(token, 1)
        self.stature = nn.Linear(token, 2)
        for layer in (self.move, self.say, self.turn, self.stature):
            nn.init.zeros_(layer.bias)
            nn.init.normal_(layer.weight, std=1e-3)
        nn.init.zeros_(self.read_closer.weight)

    def forward(self, picture: Float[Tensor, "N C h w"], start: Float[Tensor, "N 24 3"]) -> JointClaim:
        """Predict joints from an image and a first guess.

        Args:
            picture: 8 bits as [-1, 1], see `picture_channels`.
            start: first guess in the window's units.
        """
        halved = self.fine[:2](picture)
        fine = self.fine[2:](halved)
        middle = self.middle(fine)
        coarse = self.coarse(middle)
        mixed = functional.interpolate(self.down(coarse), scale_factor=2.0, mode="nearest") + self.across(middle)
        mixed = functional.interpolate(self.mixed_middle(mixed), scale_factor=2.0, mode="nearest") + self.side(fine)
        mixed = self.mixed_fine(mixed)
        closer = functional.interpolate(self.closer(mixed), scale_factor=2.0, mode="nearest") + self.edges(halved)
        seen, detail = mixed.float(), self.mixed_edges(closer).float()
        tokens = torch.cat([self.name[:-1].expand(len(start), -1, -1), self.name[-1:].expand(len(start), -1, -1)], 1)
        tokens = tokens + functional.pad(self.whole(coarse.mean((2, 3)).float())[:, None], (0, 0, JOINT_COUNT, 0))
        joints, rounds, looks = start, [], start.new_tensor(_LOOKS)
        for _ in range(ROUNDS):
            places = joints.detach()
            around = places[:, :, None, :2]
            read, near = (_looked(one, around + looks * reach) for one, reach in ((seen, 1.0), (detail, 0.5)))
            bones = places - places[:, list(PARENT_OR_SELF)]
            facts = torch.cat([read, places, bones, start, start - start[:, list(PARENT_OR_SELF)]], -1)
            tokens = tokens + functional.pad(self.read(facts) + self.read_closer(near), (0, 0, 0, 1))
            for exchange in self.exchange:
                tokens = exchange(tokens)
            joints = places + self.move(tokens[:, :-1]).float()
            rounds.append(joints)
        path, log_scale = self.say(tokens[:, :-1]).float().split(3, -1)
        odds = self.turn(tokens[:, -1]).float()[:, 0]
        height, log_height_scale = self.stature(tokens[:, -1]).float().unbind(1)
        log_height = _LOG_HEIGHT + _LOG_HEIGHT_UNIT * height
        height_scale = _LOG_HEIGHT_UNIT * log_height_scale.clamp(-3, 1).exp()
        return JointClaim(joints, (log_scale - 3).clamp(-7, 1), path, odds, log_height, height_scale, tuple(rounds))


class _Exchange(nn.Module):
    """A layer of an MLP-Mixer (2021) over the joints, whose neighbours are always the same."""

    def __init__(self, width: int) -> None:
        super().__init__()
        count = JOINT_COUNT + 1
        self.before, self.after = nn.LayerNorm(width), nn.LayerNorm(width)
        heard, thought = nn.Linear(4 * count, count), nn.Linear(2 * width, width)
        for last in (heard, thought):  # a layer that is new adds nothing at first
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)
        self.listen = nn.Sequential(nn.Linear(count, 4 * count), nn.GELU(), heard)
        self.think = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), thought)

    def forward(self, tokens: Float[Tensor, "N K C"]) -> Float[Tensor, "N K C"]:
        tokens = tokens + self.listen(self.before(tokens).transpose(1, 2)).transpose(1, 2)
        return tokens + self.think(self.after(tokens))


def _looked(seen: Float[Tensor, "N C h w"], spots: Float[Tensor, "N K L 2"]) -> Float[Tensor, "N K LC"]:
    """Return features of a map at some positions, concatenated."""
    return functional.grid_sample(seen, spots, align_corners=False).permute(0, 2, 3, 1).flatten(2)


def _layer(before: int, after: int, stride: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(before, after, 3, stride, 1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(after), nn.ReLU(inplace=True))
