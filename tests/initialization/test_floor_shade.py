"""Shade on the floor is no part of the person: told by a figure's feet, with and without the pose networks."""

import json
from pathlib import Path

import numpy as np
import pytest

from hfb.config import MattingConfig
from hfb.errors import InputError
from hfb.initialization.floor_shade import FloorShadeMatting, shade_likelihood, without_floor_shade
from hfb.initialization.landmarks import LANDMARK, PoseNetworks, networks_ready
from hfb.initialization.person_landmarks import draw_stick_figure
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.io.media.plate_colours import in_colours_of
from hfb.io.media.video.video_reading import read_frames
from hfb.matting.methods import make_matting
from hfb.photometry import srgb_to_linear
from tests.matting.silhouettes import generated_plate, seen

SIZE = (320, 240)
UPRIGHT = {
    "nose": (120, 40),
    "ear": (6, 40),
    "shoulder": (20, 70),
    "elbow": (32, 105),
    "wrist": (38, 135),
    "index": (40, 145),
    "hip": (13, 140),
    "knee": (15, 185),
    "ankle": (16, 230),
    "heel": (16, 236),
    "foot_index": (24, 242),
}


def scene(video: Path, plate: Path, number: int) -> tuple[np.ndarray, np.ndarray]:
    """A video's frame and its plate, in linear light."""
    frame = next(iter(read_frames(video, number, number + 1)))
    empty, _ = in_colours_of(read_picture_srgb(plate), [frame])
    return srgb_to_linear(frame).astype(np.float32), srgb_to_linear(empty).astype(np.float32)


def lowest_row(folder: Path, number: int) -> float:
    """Row of the lowest of the true joints of the feet in a frame [px]."""
    camera = json.loads((folder / "cameras.json").read_text())["cameras"]["cam0"]
    joints = np.load(folder / "joints3d.npz")
    places = joints["xyz"][number] @ np.array(camera["R_world_to_cam"]).T + camera["t_world_to_cam"]
    rows = (places @ np.array(camera["K"]).T)[:, 1] / places[:, 2]
    return float(max(rows[[list(joints["names"]).index(name) for name in ("RBigToe", "LBigToe", "RHeel", "LHeel")]]))


def standing() -> np.ndarray:
    """Landmarks of somebody who stands upright, 200 px high; a trunk of 70 px, feet down to row 242."""
    places = np.full((33, 2), (120.0, 40.0))
    for name, (x, y) in UPRIGHT.items():
        for side, sign in (("left", 1), ("right", -1)):
            if f"{side}_{name}" in LANDMARK:
                places[LANDMARK[f"{side}_{name}"]] = 120 + sign * x, y
    return places


FIGURE = draw_stick_figure(standing(), SIZE).astype(np.float32)
FLOOR = np.zeros(SIZE, np.float32)
FLOOR[238:310, 90:170] = 0.5  # from the shoes down


def test_a_darker_plate_is_shade_and_a_body_is_none() -> None:
    rng = np.random.default_rng(3)
    plate = generated_plate("clouds", *SIZE) * 0.5 + 0.2
    frame = plate.copy()
    frame[200:260] *= 0.6
    frame[270:310] *= 0.25
    frame[40:120, 60:120] = (0.5, 0.15, 0.08)
    likely = shade_likelihood(seen(frame, 0.004, rng), seen(plate, 0.004, rng))
    assert likely[205:255].mean() > 0.85
    assert likely[45:115, 65:115].mean() < 0.05
    assert likely[275:305].mean() < 0.3  # as dark as trousers
    assert shade_likelihood(frame, plate, darkest=0.15)[275:305].mean() > 0.85


def test_shade_at_the_feet_goes_and_the_person_stays() -> None:
    matte = np.maximum(FIGURE, FLOOR)
    left = without_floor_shade(matte, (matte == 0.5).astype(np.float32), standing())
    assert left[265:].max() == 0
    assert left[FIGURE > 0].min() == 1
    assert np.array_equal(left[:200], matte[:200])


def test_what_lies_between_shade_goes_with_it() -> None:
    """The darkest part and a mirror image are no darker plate; the shoe's own smear hangs together with the foot."""
    shade = (FLOOR > 0).astype(np.float32)
    shade[280:300, 110:150] = 0
    smear = np.zeros(SIZE, np.float32)
    smear[232:242, 140:185] = 0.4
    left = without_floor_shade(np.maximum.reduce([FIGURE, FLOOR, smear]), shade * (smear == 0), standing())
    assert left[265:].max() == 0
    assert left[234:240, 145:180].min() == pytest.approx(0.4)


def test_shade_like_limbs_above_the_feet_stay() -> None:
    """A fast arm in a dark sleeve before a wall is explained by a darker wall."""
    sleeve = np.zeros(SIZE, np.float32)
    sleeve[60:140, 170:225] = 0.3
    matte = np.maximum(FIGURE, sleeve)
    assert np.array_equal(without_floor_shade(matte, (sleeve > 0).astype(np.float32), standing()), matte)


def refuse() -> PoseNetworks:
    raise InputError("not needed")


def test_somebody_in_the_colours_of_the_plate_is_no_shade() -> None:
    """Nothing would be left of them to find landmarks in."""
    plate = generated_plate("clouds", *SIZE)
    frame = plate * (1 - 0.4 * FIGURE[..., None])
    assert np.array_equal(FloorShadeMatting(lambda *_: FIGURE.copy(), refuse)(frame, plate), FIGURE)


def test_without_shade_no_network_is_loaded(shared_data: Path) -> None:
    folder = shared_data / "pose2sim_balancing"
    frame, plate = scene(folder / "cam04_f000-059.mp4", folder / "cam04_plate.png", 20)
    matting = make_matting(MattingConfig())
    assert np.array_equal(FloorShadeMatting(matting, refuse)(frame, plate), matting(frame, plate))


@pytest.mark.skipif(not networks_ready(), reason="the pose networks are not there (hfb models fetch)")
def test_a_walker_on_a_glossy_floor_ends_at_her_shoes(shared_data: Path) -> None:
    """Below the lowest true joint of her feet lay four tenths of her matte."""
    folder, number = shared_data / "opencap_walk_a", 30
    frame, plate = scene(folder / "cam0_f001-074.mp4", folder / "cam0_plate.png", number)
    feet = lowest_row(folder, number)
    before = make_matting(MattingConfig())(frame, plate)
    after = FloorShadeMatting(make_matting(MattingConfig()), PoseNetworks)(frame, plate)
    below = slice(round(feet) + 60, None)
    assert before[below].sum() > 0.25 * before.sum()
    assert after[below].sum() < 0.01 * after.sum()
    assert np.array_equal(after[: round(feet) - 80], before[: round(feet) - 80])
