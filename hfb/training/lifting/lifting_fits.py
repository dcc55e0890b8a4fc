"""Draw fits to learn depth from: `hfb train lifting-fits --mocap DIR --backgrounds DIR --out f1.npz`.

One or two frames of a person each, as joints alone, fitted with few iterations and without the full-resolution stages
(`joint_fits`).
"""

import argparse
from typing import Any

import numpy as np
import torch

from hfb.evidence.joint_evidence import predict_joint_evidence
from hfb.evidence.lifting_network import bone_lengths, lengths_in_window
from hfb.fitting.refine import compose_blurred
from hfb.motion.motion_file import write_arrays
from hfb.training.flags import add_drawing_flags
from hfb.training.joints.blurred_people import until_found
from hfb.training.joints.joint_bank import split
from hfb.training.joints.joint_fits import Gym, hasty_whole
from hfb.training.schedule import Counter

_SAVED_EVERY = 100


class JointGym(Gym):
    """A gym that keeps joints alone."""

    def __init__(self, *studio: Any, frames: int, whole: bool) -> None:
        """Read clips and make scenes, as `Studio` does.

        Args:
            *studio: arguments of `Studio`.
            frames: per person, one or two.
            whole: whether fits include the full-resolution stages.
        """
        super().__init__(*studio)
        self.frames = frames
        if whole:
            self.hasty = hasty_whole

    def person(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Return joints, estimates and the fit of one person in T frames.

        As in `lifting_bank`: joints (T, 24, 3) at mid-exposure, first estimates, units in metres and as tangents (T,),
        lengths of bones (24,) [m]. Besides the fit's joints and its lengths (T, 24) in units; the joint network's
        estimate from the image, the scale of its error, and its estimate from the fit's rendering.

        Args:
            rng: of the person.
        """
        watched = until_found(lambda: self._watched(rng, pairs=float(self.frames == 2)))
        firsts, found = self._fit(watched, rng)
        claim = predict_joint_evidence(watched.seen, firsts, self.body)
        again = claim.predict_for(compose_blurred(self._drawn(found, watched.seen), watched.seen))
        turns, places = found.trajectory.at(torch.tensor([0.5]))
        person, frames = self.body.shape(found.betas), []
        for number, ((first, last), start) in enumerate(zip(watched.exposures, firsts, strict=True)):
            window = claim.windows[number]
            perspective = torch.tensor(window.units_to_tangents())
            truth, fitted = watched.shot.joints[(first + last) // 2], person.joints_of(turns[number], places[number])[0]
            frames.append(
                {
                    "joints": window.to_units(truth),
                    "starts": window.to_units(self._guessed(start)),
                    "unit_m": truth[0, 2] * perspective,
                    "perspective": perspective,
                    "lengths": bone_lengths(truth),
                    "fitted": window.to_units(fitted),
                    "fitted_lengths": lengths_in_window(fitted, perspective),
                    "claimed": claim.middle[number],
                    "claimed_scale": claim.scale[number],
                    "shown": again.middle[number],
                }
            )
        drawn = {name: torch.stack([frame[name] for frame in frames]).detach().numpy() for name in frames[0]}
        return drawn | {"lengths": drawn["lengths"][0]}


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    add_drawing_flags(parser)
    parser.add_argument("--frames", type=int, choices=(1, 2), default=2, help="of every person [2]")
    parser.add_argument("--whole", action="store_true", help="go on through the stages of full size")


def run(options: argparse.Namespace) -> None:
    """Write everything drawn as one file, periodically.

    Args:
        options: the parsed options.
    """
    torch.set_num_threads(1)
    clips = split(options.mocap, options.split)
    studio = (options.mocap, options.backgrounds, clips, options.seed, options.frame_px)
    gym = JointGym(*studio, frames=options.frames, whole=options.whole)
    people: list[dict[str, np.ndarray]] = []
    counter = Counter("people", _SAVED_EVERY)
    while len(people) < options.count:
        people.append(gym.person(np.random.default_rng([options.seed, len(people)])))
        if counter.reached(len(people)) or len(people) == options.count:
            write_arrays(options.out, {name: np.stack([one[name] for one in people]) for name in people[0]})
