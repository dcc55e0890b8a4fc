"""The matting network put to work: find the person in the whole frame, then look again at the crop around them."""

from functools import lru_cache
from importlib import resources

import cv2
import numpy as np
import torch
from safetensors.torch import load_file

from hfb.determinism import one_torch_thread
from hfb.matting.camera_noise import exposure_gain
from hfb.matting.matte_network import MatteNetwork, features
from hfb.matting.matting import (
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
from hfb.photometry import linear_to_srgb
from hfb.shapes import Array, Float

_WHOLE_PX = 256
_CROP_PX = 288
_LEAST_PX = 32
_MARGIN = 0.2
_CLEARLY_CHANGED = 0.05  # in sRGB


class NetworkMatting:
    """A small network trained on blurred people (infra/train_matting): a tenth of a second, the same on every run."""

    def __init__(self, network: MatteNetwork | None = None) -> None:
        """The shipped weights, or other ones."""
        self._network = shipped_network() if network is None else network.eval()

    def __call__(self, frame_linear: Picture, plate_linear: Plate) -> Float[Array, "H W"]:
        """Look at the whole frame at 256 px, then at the person's box, put that matte into the whole frame."""
        frame, plate = (np.clip(np.asarray(picture, np.float32), 0, None) for picture in (frame_linear, plate_linear))
        check_sizes(frame, plate)
        small_frame, small_plate = shrink(frame, _WHOLE_PX), shrink(plate, _WHOLE_PX)
        gain = exposure_gain(small_frame, small_plate)
        _check_scene(small_frame, small_plate * gain)
        first = clean(self.look(small_frame, small_plate * gain))
        if first.sum() < LEAST_SHARE * first.size:
            raise nobody_found()
        height, width = frame.shape[:2]
        scale = np.array([height, width]) / first.shape
        top, left, bottom, right = scaled_box(matte_region(first, _MARGIN), scale, height, width)
        inner = (slice(top, bottom), slice(left, right))
        gain = _gain_without(first, small_frame, small_plate)
        alpha = clean(self.look(shrink(frame[inner], _CROP_PX), shrink(plate[inner], _CROP_PX) * gain))
        matte = np.zeros((height, width), np.float32)
        matte[inner] = cv2.resize(alpha, (right - left, bottom - top), interpolation=cv2.INTER_LINEAR)
        if matte.sum() < LEAST_SHARE * matte.size:
            raise nobody_found()
        return matte

    def look(self, frame_linear: Float[Array, "H W 3"], plate_linear: Float[Array, "H W 3"]) -> Float[Array, "H W"]:
        """The network's alpha at the pictures' own size, the mean of the picture and its mirror image.

        The plate already has the frame's exposure.
        """
        seen = features(np.clip(frame_linear, 0, 1), np.clip(plate_linear, 0, 1))
        height, width = seen.shape[1:]
        wanting = [(0, 0), (0, max(0, _LEAST_PX - height)), (0, max(0, _LEAST_PX - width))]
        picture = torch.from_numpy(np.pad(seen, wanting, mode="edge"))[None]
        with one_torch_thread(), torch.inference_mode():
            both = torch.cat([picture, picture.flip(-1)]).contiguous(memory_format=torch.channels_last)
            there, mirrored = torch.sigmoid(self._network(both)[:, 0])
            alpha = ((there + mirrored.flip(-1)) / 2).numpy()
        return np.ascontiguousarray(alpha[:height, :width], np.float32)


@lru_cache(maxsize=1)
def shipped_network() -> MatteNetwork:
    """The network with the weights of data/matting.safetensors; data/matting.json tells how they were made."""
    network = MatteNetwork()
    with resources.as_file(resources.files("hfb.matting") / "data" / "matting.safetensors") as path:
        network.load_state_dict({name: weights.float() for name, weights in load_file(path).items()})
    network.requires_grad_(False)
    return network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def _check_scene(frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"]) -> None:
    """Nothing to be seen at all, or another place: known before the network is asked."""
    difference = np.abs(linear_to_srgb(frame) - linear_to_srgb(np.clip(plate, 0, 1))).max(-1)
    if (cv2.GaussianBlur(difference, (0, 0), 2) > _CLEARLY_CHANGED).mean() > MOST_SHARE:
        raise another_scene()


def _gain_without(
    matte: Float[Array, "H W"], frame: Float[Array, "H W 3"], plate: Float[Array, "H W 3"]
) -> Float[Array, "3"]:
    """The exposure gain by the pixels where nobody is."""
    empty = cv2.dilate(matte, np.ones((9, 9), np.uint8)) < 0.02
    return exposure_gain(frame[empty][None], plate[empty][None])
