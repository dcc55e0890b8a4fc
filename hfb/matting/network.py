"""Inference of the matting network: in the whole frame, then in the crop around the person."""

from functools import lru_cache
from importlib import resources

import cv2
import numpy as np
import torch
from safetensors.torch import load_file

from hfb.kernels.determinism import one_torch_thread
from hfb.kernels.threads import run_tasks
from hfb.matting.alignment import aligned_plate
from hfb.matting.camera_noise import exposure_gain
from hfb.matting.matte_network import CHANNELS, MatteNetwork, features
from hfb.matting.matting_protocol import (
    LEAST_SHARE,
    MOST_SHARE,
    Picture,
    Plate,
    another_scene,
    check_sizes,
    clean,
    matte_region,
    nobody_found,
    scaled_box,
    shrink,
)
from hfb.matting.moving_layer import explained_matte
from hfb.matting.second_look import EVIDENCE_CHANNELS, colour_evidence
from hfb.matting.third_look import FIT_CHANNELS, SHARED_CHANNELS, fit_evidence
from hfb.photometry import linear_to_srgb
from hfb.typing import Array, Float

_WHOLE_PX = 256
_CROP_PX = 288
_LEAST_PX = 32
_MARGIN = 0.2
_COVERED, _REACH = 0.05, 0.05
"""Alpha from which a matte or a fit covers a pixel; and how far from there the third network may find the person,
relative to the crop's longer side."""
_CLEARLY_CHANGED = 0.05  # in sRGB


class NetworkMatting:
    """Two small networks trained on blurred people (`hfb train matting`): one or two seconds, deterministic.

    The first network finds the person and a matte, from which the body's colours follow (second_look.py); the second
    network uses them, too. Its uncertain pixels are explained by a moving layer (moving_layer.py).

    Args:
        network: the first network; None for the shipped one.
        second: the second network; None for the shipped one.
        blurred: whether a moving layer explains uncertain pixels, which takes half of the time.
        looks: sizes of the crop, relative to at most 288 px, at which it is looked at; a small one is enlarged.
    """

    def __init__(
        self,
        network: MatteNetwork | None = None,
        second: MatteNetwork | None = None,
        blurred: bool = True,
        looks: tuple[float, ...] = (1.0, 1.4),
    ) -> None:
        """Load the shipped weights, or take other networks."""
        self._blurred, self._looks = blurred, looks
        self._network = shipped_network() if network is None else network.eval()
        self._second = shipped_second() if second is None else second.eval()

    def __call__(self, frame_linear: Picture, plate_linear: Plate) -> Float[Array, "H W"]:
        """Look at the whole frame at 256 px, then at the person's box at two sizes, put that matte into the frame."""
        frame, plate = (np.clip(np.asarray(picture, np.float32), 0, None) for picture in (frame_linear, plate_linear))
        check_sizes(frame, plate)
        plate = aligned_plate(frame, plate)
        small_frame, small_plate = shrink(frame, _WHOLE_PX), shrink(plate, _WHOLE_PX)
        gain = exposure_gain(small_frame, small_plate)
        apart = np.abs(linear_to_srgb(small_frame) - linear_to_srgb(np.clip(small_plate * gain, 0, 1))).max(-1)
        if (cv2.GaussianBlur(apart, (0, 0), 2) > _CLEARLY_CHANGED).mean() > MOST_SHARE:
            raise another_scene()
        first = clean(self.look(small_frame, small_plate * gain))
        if first.sum() < LEAST_SHARE * first.size:
            raise nobody_found()
        height, width = frame.shape[:2]
        scale = np.array([height, width]) / first.shape
        top, left, bottom, right = scaled_box(matte_region(first, _MARGIN), scale, height, width)
        inner = (slice(top, bottom), slice(left, right))
        gain = _gain_without(first, small_frame, small_plate)
        lit = frame[inner], plate[inner] * gain
        longer = min(_CROP_PX, max(bottom - top, right - left))
        crops = [[np.clip(_sized(one, round(longer * look)), 0, 1) for one in lit] for look in self._looks]
        looks = (np.dstack(self.look_twice(crop[0], crop[1])) for crop in crops)
        size = crops[0][0].shape[1::-1]
        seen = [cv2.resize(look, size, interpolation=cv2.INTER_AREA) for look in looks]
        alpha, doubt = np.mean(seen, axis=0).transpose(2, 0, 1)
        alpha = clean(alpha)
        if self._blurred:
            alpha = explained_matte(crops[0][0], crops[0][1], alpha, doubt)
        matte = np.zeros((height, width), np.float32)
        matte[inner] = cv2.resize(alpha, (right - left, bottom - top), interpolation=cv2.INTER_LINEAR)
        if matte.sum() < LEAST_SHARE * matte.size:
            raise nobody_found()
        return matte

    def look(self, frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"]) -> Float[Array, "H W"]:
        """Return the first network's alpha at the images' own size, the mean over the image and its mirror image.

        Args:
            frame_linear: linear light.
            plate_linear: linear light, in the frame's exposure.
        """
        frame, plate = np.clip(frame_linear, 0, 1), np.clip(plate_linear, 0, 1)
        return _answer(self._network, features(frame, plate))[0]

    def look_twice(
        self, frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"]
    ) -> tuple[Float[Array, "H W"], Float[Array, "H W"]]:
        """Return the second network's alpha and its error scale; its input includes colours from the first alpha.

        Args:
            frame_linear: linear light.
            plate_linear: linear light, in the frame's exposure.
        """
        frame, plate = np.clip(frame_linear, 0, 1), np.clip(plate_linear, 0, 1)
        seen = features(frame, plate)
        alpha, doubt = _answer(self._network, seen)
        told = colour_evidence(frame, plate, alpha, doubt)
        return _answer(self._second, np.concatenate([seen, told]))


class RenderConditionedMatting:
    """The third network's input around a person without the fit; a fit's render gives the matte.

    Its alpha combines a matte and a fit by the pixels. What is far from both is another person, who was
    removed from the matte before. Where nothing would be left it stays.

    Args:
        frame_linear: in linear light.
        plate_linear: in linear light.
        matte: alpha as it was found before the fit.
        longer_px: longer side at which the network looks, 288 px at most.
    """

    def __init__(
        self,
        frame_linear: Float[Array, "H W 3"],
        plate_linear: Float[Array, "H W 3"],
        matte: Float[Array, "H W"],
        longer_px: int = _CROP_PX,
    ) -> None:
        self._matte, self._longer = matte, min(_CROP_PX, longer_px, max(matte.shape))
        frame, plate, self._before = (shrink(one, self._longer) for one in (frame_linear, plate_linear, matte))
        self._pictures, self._seen = _seen_before_fit(frame, plate, self._before)

    def matte(self, fitted: Float[Array, "H W 4"], network: MatteNetwork | None = None) -> Float[Array, "H W"]:
        """Return alpha once a fit is known.

        Args:
            fitted: the fit's blurred image, premultiplied linear light and alpha.
            network: the shipped third one when not given.
        """
        (height, width), beside = self._matte.shape, shrink(fitted, self._longer)
        seen = np.concatenate([self._seen, fit_evidence(*self._pictures, beside)])
        alpha, _ = _answer(shipped_third() if network is None else network.eval(), seen)
        reach = 2 * max(2, round(_REACH * self._longer)) + 1
        covered = (np.maximum(self._before, beside[..., 3]) > _COVERED).astype(np.uint8)
        alpha = clean(alpha * cv2.dilate(covered, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))))
        if alpha.sum() < LEAST_SHARE * alpha.size:
            return np.asarray(self._matte, np.float32)
        return cv2.resize(alpha, (width, height), interpolation=cv2.INTER_LINEAR)


def seen_beside_fit(
    frame_linear: Float[Array, "H W 3"],
    plate_linear: Float[Array, "H W 3"],
    matte: Float[Array, "H W"],
    fitted: Float[Array, "H W 4"],
) -> Float[Array, "C H W"]:
    """Return the third network's input channels; see `RenderConditionedMatting`.

    Args:
        frame_linear: linear light.
        plate_linear: linear light, in the frame's exposure.
        matte: alpha that the fit started with.
        fitted: the fit's render: mean colour (premultiplied, linear) and silhouette.
    """
    pictures, seen = _seen_before_fit(frame_linear, plate_linear, matte)
    return np.concatenate([seen, fit_evidence(*pictures, fitted)])


def _seen_before_fit(
    frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"], matte: Float[Array, "H W"]
) -> tuple[tuple[Float[Array, "H W 3"], Float[Array, "H W 3"]], Float[Array, "C H W"]]:
    """Return frame and plate in the same exposure, and the third network's inputs without a fit."""
    gain = _gain_without(matte, frame_linear, plate_linear)
    frame, plate = np.clip(frame_linear, 0, 1), np.clip(plate_linear * gain, 0, 1)
    return (frame, plate), np.concatenate([features(frame, plate), colour_evidence(frame, plate, matte)])


def _sized(picture: Float[Array, "H W 3"], longer_px: int) -> Float[Array, "h w 3"]:
    """Resize to so many pixels on the longer side: area average where that is smaller, cubic where it is larger."""
    height, width = picture.shape[:2]
    scale = longer_px / max(height, width)
    if scale <= 1:
        return shrink(picture, longer_px)
    size = (round(width * scale), round(height * scale))
    return cv2.resize(np.asarray(picture, np.float32), size, interpolation=cv2.INTER_CUBIC)


def _answer(network: MatteNetwork, seen: Float[Array, "C H W"]) -> tuple[Float[Array, "H W"], Float[Array, "H W"]]:
    """Return alpha and the logarithm of its expected error, means of the image and its mirror image."""
    height, width = seen.shape[1:]
    wanting = [(0, 0), (0, max(0, _LEAST_PX - height)), (0, max(0, _LEAST_PX - width))]
    picture = torch.from_numpy(np.pad(seen, wanting, mode="edge"))[None]

    def ask(mirrored: int) -> torch.Tensor:
        with one_torch_thread(), torch.inference_mode():
            one = picture.flip(-1) if mirrored else picture
            alpha, doubt = network(one.contiguous(memory_format=torch.channels_last))[0]
            return torch.stack([torch.sigmoid(alpha), doubt])

    output, mirrored = run_tasks(ask, 2, torch.get_num_threads())
    alpha, doubt = ((output + mirrored.flip(-1)) / 2).numpy()
    return alpha[:height, :width].copy(), doubt[:height, :width].copy()


@lru_cache(maxsize=1)
def shipped_network() -> MatteNetwork:
    """Load the first network; data/matting.json tells how it was trained."""
    return _shipped("matting", CHANNELS)


@lru_cache(maxsize=1)
def shipped_second() -> MatteNetwork:
    """Load the second network; data/second_look.json tells how it was trained."""
    return _shipped("second_look", CHANNELS + EVIDENCE_CHANNELS)


@lru_cache(maxsize=1)
def shipped_third() -> MatteNetwork:
    """Load the third network; data/third_look.json tells how it was trained."""
    return _shipped("third_look", SHARED_CHANNELS + FIT_CHANNELS)


def _shipped(name: str, channels: int) -> MatteNetwork:
    network = MatteNetwork(channels=channels)
    with resources.as_file(resources.files("hfb.matting") / "data" / f"{name}.safetensors") as path:
        network.load_state_dict({name: weights.float() for name, weights in load_file(path).items()})
    network.requires_grad_(False)
    return network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def _gain_without(
    matte: Float[Array, "H W"], frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"]
) -> Float[Array, "3"]:
    """Return the exposure gain by background pixels."""
    empty = cv2.dilate(matte, np.ones((9, 9), np.uint8)) < 0.02
    return exposure_gain(frame[empty][None], plate[empty][None])
