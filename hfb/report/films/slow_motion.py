"""Slow-motion films of the motion during the exposures, and the body overlaid on the blurred frames.

The slow-motion film shows three panels: the blurred frame, the body over the plate at one instant, and the blur that
the fitted motion produces. Between exposures the interpolated motion is shown and captioned as such.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
import torch

from hfb.body.model import Body, PosedBody
from hfb.config import Film
from hfb.errors import InputError
from hfb.evaluation.protocol import pose_rows
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import quaternion_to_matrix
from hfb.interop.writers.keys import MotionKeys, exact_keys, keys_at, present_at, subframe_rate_hz
from hfb.motion.sampled import SampledMotion
from hfb.photometry import linear_to_srgb
from hfb.rendering.formation import compose, see_by_rows
from hfb.rendering.rasterizer import Rasterizer
from hfb.report.films.time_line import draw_time_line
from hfb.report.images.shading import shade_bodies, time_colours
from hfb.report.images.strip import captioned
from hfb.typing import Array, Float, Tensor

FILM_FPS = 30
_PANEL_HEIGHT_PX, _PANEL_WIDTH_PX = (360, 480), 636  # three panels and their margins: 1920
_SHORT_S = 2.0  # a motion that takes less is shown so long at least
_HOLD_S = 0.5
_BODY_OPACITY = 0.75
_MOST_INSTANTS = 20_000_000


@dataclass(frozen=True)
class Shot:
    """Everything a film is rendered from.

    Attributes:
        motion: fitted motion in the camera's coordinates.
        texture: in the light of the fit.
        camera: of frames and plate.
        plate_linear: the background in the light of the fit.
        frame_linear: returns a blurred frame by its number in ``motion.frame_index``, in the light of the fit.
        light: ``linear`` or ``srgb``: what frames, plate and texture are.
    """

    motion: SampledMotion
    body: Body
    texture: Float[Tensor, "A A 3"]
    rasterizer: Rasterizer
    camera: PinholeCamera
    plate_linear: Float[Tensor, "H W 3"]
    frame_linear: Callable[[int], Float[Tensor, "H W 3"]] = field(repr=False)
    light: str = "linear"


def film_slow_factor(motion: SampledMotion) -> float:
    """Return the slow-motion factor: at most one sub-frame per image, and a film of at least two seconds.

    Args:
        motion: fitted motion; only its times count.
    """
    lasts = float(motion.times_s[-1] - motion.times_s[0])
    return max(1.0, subframe_rate_hz(motion) / FILM_FPS, _SHORT_S / max(lasts, 1e-9))


def film_instants(motion: SampledMotion, slow: float | None = None) -> Float[Array, "F"]:
    """Return the instants [s] of a slow-motion film, evenly spaced; stretches without the person are cut out.

    Args:
        motion: fitted motion.
        slow: how many times slower than real time; None for `film_slow_factor`.

    Raises:
        InputError: there are too many for a film, which means a damaged clock.
    """
    slow = film_slow_factor(motion) if slow is None else slow
    first, last = float(motion.times_s[0]), float(motion.times_s[-1])
    steps = np.ceil((last - first) * slow * FILM_FPS - 1e-6)
    if not steps < _MOST_INSTANTS:
        raise InputError(f"the film would go through {steps:.4g} instants: the motion's clock is damaged, or too long")
    instants = np.minimum(first + np.arange(int(steps) + 1) / (slow * FILM_FPS), last)
    return instants[present_at(motion, instants)]


def slow_motion(shot: Shot) -> Iterator[Float[Array, "Y X 3"]]:
    """Yield the images of the slow-motion film, sRGB in [0, 1], `FILM_FPS` per second; the last is held for 0.5 s.

    Args:
        shot: motion, body, plate and frames.
    """
    instants = film_instants(shot.motion)
    for number, picture in enumerate(_side_by_side(shot, keys_at(shot.motion, instants)), 1):
        yield picture
        for _ in range(round(_HOLD_S * FILM_FPS) if number == len(instants) else 0):
            yield picture


def exact_sub_frames(shot: Shot) -> Iterator[tuple[float, Float[Array, "Y X 3"]]]:
    """Yield (time [s], image) of every sub-frame at its exact time.

    Args:
        shot: motion, body, plate and frames.
    """
    keys = exact_keys(shot.motion)
    yield from zip(keys.times_s.tolist(), _side_by_side(shot, keys), strict=True)


def picture_count(motion: SampledMotion, film: Film) -> int:
    """Return the number of images of a film.

    Args:
        motion: fitted motion.
        film: which film.
    """
    if film == "exact":
        return len(exact_keys(motion).times_s)
    if film == "overlay":
        return len(_overlay_instants(motion))
    return len(film_instants(motion)) + round(_HOLD_S * FILM_FPS)


def overlay_rate(motion: SampledMotion) -> float:
    """Return the overlay's images per second: the recording's rate, or `FILM_FPS` for a short motion.

    Args:
        motion: fitted motion.
    """
    return float(FILM_FPS) if _is_short(motion) else 1 / float(np.median(np.diff(_opened(motion))))


def overlay(shot: Shot) -> Iterator[Float[Array, "Y X 3"]]:
    """Yield images of the body over the blurred frames: one per exposure, or every instant of a short motion.

    Args:
        shot: motion, body, plate and frames.
    """
    motion, view, instants = shot.motion, _View(shot), _overlay_instants(shot.motion)
    keys = keys_at(motion, instants)
    for row, time_s in enumerate(instants.tolist()):
        frame = view.frame_at(time_s)
        caption = f"frame {frame}, body at t = {time_s:.4f} s{_closed(keys, row)}"
        yield _over_time_line(motion, [captioned(view.with_clay(frame, keys, row), caption)], time_s)


def _is_short(motion: SampledMotion) -> bool:
    """Return whether a film of one image per exposure would be too short; a single exposure has no frame rate."""
    return float(motion.times_s[-1] - motion.times_s[0]) < _SHORT_S or len(_opened(motion)) < 2


def _overlay_instants(motion: SampledMotion) -> Float[Array, "F"]:
    """Return the instants of the overlay's images [s]."""
    if _is_short(motion):
        return film_instants(motion)
    exposure = motion.times_s[motion.rows_of(int(motion.frame_index[0]))]
    return _opened(motion) + float(exposure[-1] - exposure[0]) / 2


def _side_by_side(shot: Shot, keys: MotionKeys) -> Iterator[Float[Array, "Y X 3"]]:
    """Yield blurred | one instant | re-blurred, under captions, over a time line."""
    view, slow = _View(shot), film_slow_factor(shot.motion)
    for row, time_s in enumerate(keys.times_s.tolist()):
        frame = view.frame_at(time_s)
        cells = [
            captioned(view.seen(frame), f"frame {frame}, blurred"),
            captioned(view.instant(keys, row), f"de-blurred, t = {time_s:.4f} s{_closed(keys, row)}"),
            captioned(view.reblurred(frame), "re-blurred from the motion"),
        ]
        yield _over_time_line(shot.motion, cells, time_s, slow)


def paired_pictures(
    shot: Shot, instants: Float[Array, "F"], slow: float, panel_px: tuple[int, int]
) -> Iterator[Float[Array, "Y X 3"]]:
    """Yield images of two panels, the blurred frame and the body at one instant, over a time line.

    Args:
        shot: motion, body, plate and frames.
        instants: when [s].
        slow: the slow-motion factor that the time line states.
        panel_px: largest height and width of a panel.
    """
    keys = keys_at(shot.motion, instants)
    view = _View(shot, (panel_px[0], panel_px[0]), panel_px[1])
    for row, time_s in enumerate(keys.times_s.tolist()):
        frame = view.frame_at(time_s)
        cells = [
            captioned(view.seen(frame), f"frame {frame}, blurred"),
            captioned(view.instant(keys, row), f"t = {1000 * time_s:.0f} ms{_closed(keys, row)}"),
        ]
        yield _over_time_line(shot.motion, cells, time_s, slow)


def _closed(keys: MotionKeys, row: int) -> str:
    return "" if keys.observed[row] else ", shutter closed"


def _over_time_line(
    motion: SampledMotion, cells: list[Float[Array, "Y x 3"]], time_s: float, slow: float | None = None
) -> Float[Array, "Y2 X2 3"]:
    """Lay panels side by side over the time line, on white with even sides, which H.264 needs."""
    high, width = cells[0].shape[0], sum(cell.shape[1] for cell in cells)
    line = draw_time_line(motion, time_s, width, slow)
    height = high + len(line)
    picture = np.ones((height + height % 2, width + width % 2, 3), np.float32)
    np.concatenate(cells, 1, out=picture[:high, :width])
    picture[high:height, :width] = line
    return picture


def _opened(motion: SampledMotion) -> Float[Array, "T"]:
    """Return when the shutter opened for every frame of the motion [s]."""
    return motion.times_s[np.flatnonzero(np.diff(motion.frame_index, prepend=-1))]


def _covered(body: Float[Array, "H W 4"]) -> tuple[slice, slice]:
    """Return the rows and columns of the box that a rendered body covers."""
    covered = body[..., 3] > 0
    rows, columns = np.flatnonzero(covered.any(1)), np.flatnonzero(covered.any(0))
    return np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] if rows.size else np.s_[:0, :0]


class _View:
    """A shot at the film's resolution; caches the images of the last frame."""

    def __init__(
        self, shot: Shot, heights_px: tuple[int, int] = _PANEL_HEIGHT_PX, width_px: int = _PANEL_WIDTH_PX
    ) -> None:
        """Resize plate and camera to the panel's size.

        Args:
            shot: motion, body, plate and frames.
            heights_px: least and largest height of a panel, as far as ``width_px`` allows.
            width_px: largest width of a panel.
        """
        self._shot = shot
        height, width = shot.plate_linear.shape[:2]
        low, high = heights_px
        scale = min(max(min(height, high), low) / height, width_px / width)
        self._size = max(8, round(width * scale)), max(8, round(height * scale))
        self._camera = shot.camera.resize(self._size[1], self._size[0])
        self._plate = self._resized(shot.plate_linear)
        self._plate_srgb = self._srgb(self._plate)
        self._shaped = shot.body.shape(torch.from_numpy(shot.motion.betas).to(shot.body.template.dtype))
        self._numbers = shot.motion.frame_index[np.flatnonzero(np.diff(shot.motion.frame_index, prepend=-1))]
        self._opened = _opened(shot.motion)
        self._held: dict[str, tuple[int, Float[Array, "H W 3"]]] = {}

    def frame_at(self, time_s: float) -> int:
        """Return the number of the frame whose shutter opened last.

        Args:
            time_s: instant since the first shutter opened.
        """
        return int(self._numbers[max(0, int(np.searchsorted(self._opened, time_s + 1e-9, side="right")) - 1)])

    def seen(self, frame: int) -> Float[Array, "H W 3"]:
        """Return the blurred frame, sRGB in [0, 1].

        Args:
            frame: its number in the motion.
        """
        return self._kept("seen", frame, lambda: self._srgb(self._resized(self._shot.frame_linear(frame))))

    def reblurred(self, frame: int) -> Float[Array, "H W 3"]:
        """Return the mean over the frame's sub-frames, composed over the plate; sRGB in [0, 1].

        Args:
            frame: its number in the motion.
        """
        return self._kept("reblurred", frame, lambda: self._reblur(frame))

    def instant(self, keys: MotionKeys, row: int) -> Float[Array, "H W 3"]:
        """Return the textured body over the plate; sRGB in [0, 1].

        Args:
            keys: interpolated motion.
            row: which of its instants.
        """
        shot = self._shot
        with torch.no_grad():
            body = shot.rasterizer.render(self._posed(keys, row).vertices, shot.texture, self._camera, shot.body.mesh)
        return self._over_plate(body[0])

    def with_clay(self, frame: int, keys: MotionKeys, row: int) -> Float[Array, "H W 3"]:
        """Return the shaded body over the blurred frame; its colour encodes the time within the exposure.

        Args:
            frame: number of the blurred frame.
            keys: interpolated motion.
            row: which of its instants.
        """
        shot, seen = self._shot, self.seen(frame)
        rows = shot.motion.rows_of(frame)
        nearest = int(np.abs(shot.motion.times_s[rows] - keys.times_s[row]).argmin())
        colour = time_colours(len(rows))[nearest : nearest + 1]
        vertices = self._posed(keys, row).vertices
        clay = shade_bodies(vertices, colour, self._camera, shot.body.mesh, shot.rasterizer)[0].numpy()
        image, box = seen.copy(), _covered(clay)
        over = _BODY_OPACITY * clay[box][..., :3] + (1 - _BODY_OPACITY * clay[box][..., 3:]) * seen[box]
        image[box] = np.clip(over, 0, 1)
        return image

    def _posed(self, keys: MotionKeys, row: int) -> PosedBody:
        dtype = self._shaped.vertices.dtype
        rotations = quaternion_to_matrix(torch.from_numpy(keys.quaternions[row : row + 1])).to(dtype)
        with torch.no_grad():
            return self._shaped.pose(rotations, torch.from_numpy(keys.translations[row : row + 1]).to(dtype))

    def _reblur(self, frame: int) -> Float[Array, "H W 3"]:
        shot = self._shot
        vertices = pose_rows(shot.motion, shot.motion.rows_of(frame), shot.body).vertices
        with torch.no_grad():
            seen = see_by_rows(vertices, self._camera)
            mean = shot.rasterizer.render_mean(seen, shot.texture, self._camera, shot.body.mesh)
        return self._over_plate(mean)

    def _over_plate(self, body: Float[Tensor, "H W 4"]) -> Float[Array, "H W 3"]:
        """Compose a body over the plate; sRGB in [0, 1]. Most of the image is the plate's."""
        image, box = self._plate_srgb.copy(), _covered(body.numpy())
        image[box] = self._srgb(compose(body[box], self._plate[box]))
        return image

    def _kept(self, kind: str, frame: int, make: Callable[[], Float[Array, "H W 3"]]) -> Float[Array, "H W 3"]:
        if kind not in self._held or self._held[kind][0] != frame:
            self._held[kind] = frame, make()
        return self._held[kind][1]

    def _resized(self, picture: Float[Tensor, "H W 3"]) -> Float[Tensor, "h w 3"]:
        smaller = picture.shape[1] > self._size[0]
        resized = cv2.resize(
            picture.float().numpy(), self._size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        )
        return torch.from_numpy(resized)

    def _srgb(self, picture: Float[Tensor, "H W 3"]) -> Float[Array, "H W 3"]:
        inside = picture.clamp(0, 1)
        return (linear_to_srgb(inside) if self._shot.light == "linear" else inside).numpy()
