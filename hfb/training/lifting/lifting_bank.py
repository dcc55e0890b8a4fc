"""Draw joints without images: `hfb train lifting-bank --mocap DIR --out l1.npz --count 60000`."""

import argparse
from dataclasses import dataclass

import numpy as np
import torch

from hfb.datasets.network_errors import draw_turns
from hfb.datasets.synthetic.viewpoints import PlacedCamera, front_of, in_camera, place
from hfb.evidence.joint_network import Window
from hfb.evidence.lifting_network import bone_lengths
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.motion.motion_file import write_arrays
from hfb.training.flags import add_drawing_flags
from hfb.training.joints.joint_bank import split
from hfb.training.joints.people import INSTANTS, People, draw_amplitude
from hfb.training.schedule import Counter

_MATTE_MARGIN = 1.12
"""Size of a person's matte relative to the joints' box."""
_EXPOSURES = ((0, 2, 4), (6, 8, 10))
"""Instants of two exposures: beginning, middle and end."""
_SECONDS = (0.04, 1.2)
_AT_ONCE = 100
_FRAME_PX = 144


@dataclass(frozen=True)
class _Person:
    """A person in two exposures, before any estimate of the pose.

    Attributes:
        joints: (INSTANTS, 24, 3), camera coordinates [m].
        lengths: (24,) of the bones to the joints' parents [m].
        poses: (2, 24, 3) true ones, one within each exposure.
        turns: (2, 24, 3), errors of the estimates in units of ``amplitude``.
    """

    joints: torch.Tensor
    camera: PlacedCamera
    lengths: torch.Tensor
    poses: np.ndarray
    turns: np.ndarray
    amplitude: float
    rng: np.random.Generator


class Skeletons(People):
    """The people, motions and cameras of `Studio`, as joints alone in two exposures."""

    def draw(self, rngs: list[np.random.Generator]) -> dict[str, np.ndarray]:
        """Return joints, first estimates, units and bone lengths of N people.

        ``joints`` and ``starts`` (N, 2, 24, 3) in the windows' units, joints at mid-exposure; ``unit_m`` (N, 2);
        ``perspective`` (N, 2), the unit as a tangent; ``lengths`` (N, 24) of bones [m].

        Args:
            rngs: one generator per person.
        """
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
        """Return joints (24, 3) at mid-exposure, a first estimate, and the unit in metres and as a tangent."""
        pixels = camera.lens.project(joints).reshape(-1, 2).numpy()
        low, high = pixels.min(0), pixels.max(0)
        side = 1.24 * _MATTE_MARGIN * float((high - low).max())  # the window's own margin is .12 on either side
        left, top = ((low + high) / 2 - side / 2).tolist()
        window = Window(left, top, side, camera.lens)
        truth, distance = window.to_units(joints[1]).numpy(), float(joints[1, 0, 2])
        perspective = window.units_to_tangents()
        start = self._placed(still, distance, truth, window, rng)
        return truth, start, np.float32(distance * perspective), np.float32(perspective)


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_drawing_flags(parser, 60000, backgrounds=False)


def run(options: argparse.Namespace) -> None:
    """Write everything drawn as one file.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    people = Skeletons(options.mocap, split(options.mocap, options.split), options.seed, _FRAME_PX)
    parts: list[dict[str, np.ndarray]] = []
    counter = Counter("people", 5000)
    for first in range(0, options.count, _AT_ONCE):
        rows = range(first, min(first + _AT_ONCE, options.count))
        parts.append(people.draw([np.random.default_rng([options.seed, number]) for number in rows]))
        counter.reached(rows.stop)
    write_arrays(options.out, {name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
