"""Draw joints without pictures: `python lifting_bank.py --mocap FOLDER --out l1.npz --count 60000 --seed 1`."""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from bank import SPLITS, split
from people import INSTANTS, People, draw_amplitude

from hfb.datasets.network_errors import draw_turns
from hfb.datasets.synthetic.viewpoints import PlacedCamera, front_of, in_camera, place
from hfb.evidence.joint_network import Window
from hfb.evidence.lifting_network import bone_lengths
from hfb.geometry.rotations import axis_angle_to_matrix

_MATTE_MARGIN = 1.12
"""How much larger than its joints' box a person's matte is."""
_EXPOSURES = ((0, 2, 4), (6, 8, 10))
"""Instants of two exposures: beginning, middle and end."""
_SECONDS = (0.04, 1.2)
_AT_ONCE = 100
_FRAME_PX = 144


@dataclass(frozen=True)
class _Person:
    """Somebody in two exposures, before anybody has guessed his pose.

    Attributes:
        joints: (INSTANTS, 24, 3), camera coordinates [m]. poses: (2, 24, 3) true ones, one within each exposure.
        lengths: (24,) of the bones to the joints' parents [m].
        turns: (2, 24, 3), by which the guesses are off, times the ``amplitude``.
    """

    joints: torch.Tensor
    camera: PlacedCamera
    lengths: torch.Tensor
    poses: np.ndarray
    turns: np.ndarray
    amplitude: float
    rng: np.random.Generator


class Skeletons(People):
    """The same people, motions and cameras as of the pictures, seen as joints alone in two exposures."""

    def draw(self, rngs: list[np.random.Generator]) -> dict[str, np.ndarray]:
        """Of N people: joints (N, 2, 24, 3) in mid-exposure, first guesses, in windows' units; units in metres (N, 2)
        and as tangents (N, 2); lengths of bones (N, 24) [m]."""
        people = [self._person(rng) for rng in rngs]
        poses, turns = (np.concatenate([getattr(person, name) for person in people]) for name in ("poses", "turns"))
        amplitudes = np.repeat([person.amplitude for person in people], 2)
        erring = self.erring(poses, turns, amplitudes)  # at once: far faster than one by one
        stills = self.stills(erring).unflatten(0, (-1, 2))
        drawn = [
            self._exposed(person.joints[list(exposure)], still, person.camera, person.rng)
            for person, guesses in zip(people, stills, strict=True)
            for exposure, still in zip(_EXPOSURES, guesses, strict=True)
        ]
        named = zip(("joints", "starts", "unit_m", "perspective"), zip(*drawn, strict=True), strict=True)
        of_frames = {name: np.stack(values) for name, values in named}
        lengths = torch.stack([person.lengths for person in people]).numpy()
        return {name: values.reshape(-1, 2, *values.shape[1:]) for name, values in of_frames.items()} | {
            "lengths": lengths
        }

    def _person(self, rng: np.random.Generator) -> _Person:
        motion = None
        while motion is None:
            motion = self._motion(rng, _SECONDS)
        poses, places = motion
        shaped = self.body.shape(torch.from_numpy(np.clip(rng.standard_normal(10), -2, 2)).float())
        world = shaped.joints_of(
            axis_angle_to_matrix(torch.from_numpy(poses).float()), torch.from_numpy(places).float()
        )
        points = world.reshape(-1, 3).double().numpy()
        camera = place(self._view(rng), front_of(poses[INSTANTS // 2, 0]), points, self.frame_px)
        seen, translations = in_camera(camera, poses, places, shaped.joints[0].double().numpy())
        rotations = axis_angle_to_matrix(torch.from_numpy(seen).float())
        joints = shaped.joints_of(rotations, torch.from_numpy(translations).float())
        lengths = bone_lengths(joints[0])
        chosen = seen[[rng.choice(exposure) for exposure in _EXPOSURES]]
        return _Person(joints, camera, lengths, chosen, draw_turns(2, rng), draw_amplitude(rng), rng)

    def _exposed(
        self, joints: torch.Tensor, still: torch.Tensor, camera: PlacedCamera, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.float32, np.float32]:
        """Joints (24, 3) in the middle of one exposure (3, 24, 3), a first guess; a unit in metres, as a tangent."""
        pixels = camera.lens.project(joints).reshape(-1, 2).numpy()
        low, high = pixels.min(0), pixels.max(0)
        side = 1.24 * _MATTE_MARGIN * float((high - low).max())  # the window's own margin is .12 on either side
        window = Window(*((low + high) / 2 - side / 2), side, camera.lens)
        truth, distance = window.to_units(joints[1]).numpy(), float(joints[1, 0, 2])
        perspective = window.units_to_tangents()
        start = self._placed(still, distance, truth, window, rng)
        return truth, start, np.float32(distance * perspective), np.float32(perspective)


def main() -> None:
    """Write what is drawn as one file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mocap", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="a file, .npz")
    parser.add_argument("--count", type=int, default=60000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--split", default="train", choices=SPLITS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    people = Skeletons(options.mocap, split(options.mocap, options.split), options.seed, _FRAME_PX)
    parts: list[dict[str, np.ndarray]] = []
    began = time.monotonic()
    for first in range(0, options.count, _AT_ONCE):
        rows = range(first, min(first + _AT_ONCE, options.count))
        parts.append(people.draw([np.random.default_rng([options.seed, number]) for number in rows]))
        if rows.stop % 5000 == 0:
            print(f"{rows.stop} people in {time.monotonic() - began:.0f} s", flush=True)
    np.savez(options.out, **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


if __name__ == "__main__":
    main()
