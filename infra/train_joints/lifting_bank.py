"""Draw joints without pictures: `python lifting_bank.py --mocap FOLDER --out lifting --count 60000 --seed 1`."""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from bank import split
from people import FRAME_PX, INSTANTS, STARTS, People

from hfb.datasets.viewpoints import front_of, in_camera, place
from hfb.initialize.joint_network import Window
from hfb.rotations import axis_angle_to_matrix

_MATTE_MARGIN = 1.12
"""How much larger than its joints' box a person's matte is."""


class Skeletons(People):
    """The same people, motions and cameras as of the pictures, seen as joints alone."""

    def draw(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
        """Joints (24, 3) at mid-exposure and first guesses (STARTS, 24, 3) in a window's units; a unit in metres."""
        motion = None
        while motion is None:
            motion = self._motion(rng)
        poses, places = motion
        shaped = self.body.shape(torch.from_numpy(np.clip(rng.standard_normal(10), -2, 2)).float())
        world = shaped.joints_of(
            axis_angle_to_matrix(torch.from_numpy(poses).float()), torch.from_numpy(places).float()
        )
        middle = INSTANTS // 2
        points = world.reshape(-1, 3).double().numpy()
        camera = place(self._view(rng), front_of(poses[middle, 0]), points, FRAME_PX)
        seen, translations = in_camera(camera, poses, places, shaped.joints[0].double().numpy())
        rotations = axis_angle_to_matrix(torch.from_numpy(seen).float())
        joints = shaped.joints_of(rotations, torch.from_numpy(translations).float())
        pixels = camera.lens.project(joints).reshape(-1, 2).numpy()
        low, high = pixels.min(0), pixels.max(0)
        side = 1.24 * _MATTE_MARGIN * float((high - low).max())  # the window's own margin is .12 on either side
        window = Window(*((low + high) / 2 - side / 2), side, camera.lens)
        truth = window.to_units(joints[[0, middle, -1]]).numpy()
        unit_m = float(joints[middle, 0, 2]) * window.units_to_tangents()
        return truth[1], self._starts(seen, truth, window, joints, rng), unit_m


def main() -> None:
    """Write joints, first guesses and units as one file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mocap", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="a file, .npz")
    parser.add_argument("--count", type=int, default=60000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--split", default="train", choices=("train", "dev", "all", "report"))
    options = parser.parse_args()
    torch.set_num_threads(1)
    people = Skeletons(options.mocap, split(options.mocap, options.split), options.seed)
    joints = np.zeros((options.count, 24, 3), np.float32)
    starts = np.zeros((options.count, STARTS, 24, 3), np.float32)
    unit_m = np.zeros(options.count, np.float32)
    began = time.monotonic()
    for number in range(options.count):
        rng = np.random.default_rng([options.seed, number])
        joints[number], starts[number], unit_m[number] = people.draw(rng)
        if number % 5000 == 4999:
            print(f"{number + 1} people in {time.monotonic() - began:.0f} s", flush=True)
    np.savez(options.out, joints=joints, starts=starts, unit_m=unit_m)


if __name__ == "__main__":
    main()
