"""Draw fits to learn depth from: `python lifting_fits.py --mocap M --backgrounds B --out f1.npz --count 2000`.

Two frames of a person each, or one, fitted in haste up to before the stages of full size (`fits.py`), as joints alone.
"""

import time
from typing import Any

import numpy as np
import torch
from bank import parser_of, split
from fits import Gym, hasty_whole
from pictures import until_found

from hfb.evidence.joint_evidence import predict_joint_evidence
from hfb.evidence.lifting_network import bone_lengths, lengths_in_window
from hfb.fitting.refine import compose_blurred

_SAVED_EVERY = 100


class JointGym(Gym):
    """A gym that looks at joints alone."""

    def __init__(self, *studio: Any, frames: int, whole: bool) -> None:
        """See `Studio`.

        Args:
            frames: one or two of every person. whole: fits go on through their stages of full size.
        """
        super().__init__(*studio)
        self.frames = frames
        if whole:
            self.hasty = hasty_whole

    def person(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Of one person in T frames what `lifting_bank.py` has: joints (T, 24, 3) in mid-exposure, first guesses, units
        in metres and as tangents (T,), lengths of bones (24,) [m]; the fit's joints, and lengths (T, 24) in units; and
        what the joint network says about the picture, the scale of its error, and what it says about the fit's own."""
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
            frames.append({
                "joints": window.to_units(truth), "starts": window.to_units(self._guessed(start)),
                "unit_m": truth[0, 2] * perspective, "perspective": perspective, "lengths": bone_lengths(truth),
                "fitted": window.to_units(fitted), "fitted_lengths": lengths_in_window(fitted, perspective),
                "claimed": claim.middle[number], "claimed_scale": claim.scale[number], "shown": again.middle[number],
            })  # fmt: skip
        drawn = {name: torch.stack([frame[name] for frame in frames]).detach().numpy() for name in frames[0]}
        return drawn | {"lengths": drawn["lengths"][0]}


def main() -> None:
    """Write what is drawn as one file, now and then."""
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, choices=(1, 2), default=2, help="of every person")
    parser.add_argument("--whole", action="store_true", help="go on through the stages of full size")
    options = parser.parse_args()
    torch.set_num_threads(1)
    clips = split(options.mocap, options.split)
    gym = JointGym(
        options.mocap, options.backgrounds, clips, options.seed, options.frame_px,
        frames=options.frames, whole=options.whole,
    )  # fmt: skip
    people: list[dict[str, np.ndarray]] = []
    began = time.monotonic()
    while len(people) < options.count:
        people.append(gym.person(np.random.default_rng([options.seed, len(people)])))
        if len(people) % _SAVED_EVERY == 0 or len(people) == options.count:
            np.savez(options.out, **{name: np.stack([one[name] for one in people]) for name in people[0]})
            print(f"{len(people)} people in {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
