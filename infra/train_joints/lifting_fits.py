"""Draw fits for the lifting network: `python lifting_fits.py --mocap M --backgrounds B --out f1.npz --count 2000`.

Two frames of a person each, fitted in haste up to before the stages of full size (`fits.py`), as joints alone.
"""

import time

import numpy as np
import torch
from bank import parser_of, split
from fits import Gym
from pictures import until_found

from hfb.initialize.joint_network import Window
from hfb.initialize.lifting_network import bone_lengths, lengths_in_window

_SAVED_EVERY = 100


class JointGym(Gym):
    """A gym that looks at joints alone."""

    def pair(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Of one person what `lifting_bank.py` has: joints (2, 24, 3) in mid-exposure, first guesses, units in metres
        and as tangents (2,), lengths of bones (24,) [m]; and the fit's joints, and lengths (2, 24) in units."""
        watched = until_found(lambda: self._watched(rng, pairs=1.0))
        firsts, found = self._fit(watched, rng)
        turns, places = found.trajectory.at(torch.tensor([0.5]))
        person, frames = self.body.shape(found.betas), []
        for number, ((first, last), start) in enumerate(zip(watched.exposures, firsts, strict=True)):
            window = Window.around(watched.seen.mattes[number].numpy(), watched.seen.camera)
            perspective = torch.tensor(window.units_to_tangents())
            truth, fitted = watched.shot.joints[(first + last) // 2], person.joints_of(turns[number], places[number])[0]
            frames.append({
                "joints": window.to_units(truth), "starts": window.to_units(self._guessed(start)),
                "unit_m": truth[0, 2] * perspective, "perspective": perspective, "lengths": bone_lengths(truth),
                "fitted": window.to_units(fitted), "fitted_lengths": lengths_in_window(fitted, perspective),
            })  # fmt: skip
        drawn = {name: torch.stack([frame[name] for frame in frames]).numpy() for name in frames[0]}
        return drawn | {"lengths": drawn["lengths"][0]}


def main() -> None:
    """Write what is drawn as one file, now and then."""
    options = parser_of(__doc__).parse_args()
    torch.set_num_threads(1)
    clips = split(options.mocap, options.split)
    gym = JointGym(options.mocap, options.backgrounds, clips, options.seed, options.frame_px)
    pairs: list[dict[str, np.ndarray]] = []
    began = time.monotonic()
    while len(pairs) < options.count:
        pairs.append(gym.pair(np.random.default_rng([options.seed, len(pairs)])))
        if len(pairs) % _SAVED_EVERY == 0 or len(pairs) == options.count:
            np.savez(options.out, **{name: np.stack([pair[name] for pair in pairs]) for name in pairs[0]})
            print(f"{len(pairs)} pairs in {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
