"""Draw fits to learn from: `python fits.py --mocap FOLDER --backgrounds FOLDER --out f1 --count 2000 --seed 1`.

Every row is a picture and what a fit makes of it before its last stage, as that is when the two are compared.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from bank import SPLITS, split
from people import draw_amplitude
from pictures import CLOTHED, Studio, as_file

from hfb.body.height import height_m
from hfb.config import FitConfig, Stage, preset
from hfb.datasets.clothed import draw_clothing, dress
from hfb.datasets.network_errors import draw_turns
from hfb.datasets.viewpoints import front_of, in_camera, place
from hfb.fit.comparison import drawn
from hfb.fit.loop import fit
from hfb.fit.variables import Variables
from hfb.formation import compose
from hfb.initialize.first_body import FirstBody
from hfb.initialize.joint_network import CHANNELS, PICTURE_PX, Window, picture_channels
from hfb.matting.matting import clean
from hfb.observation import Observation
from hfb.priors.load import load_pose_prior
from hfb.rotations import axis_angle_to_matrix

_INSTANTS = 23
_ONE, _TWO = ((0, 22),), ((0, 10), (12, 22))
"""First and last instant of every exposure."""
_PAIRS = 0.5
_SECONDS = (0.02, 0.7)
_HASTE, _SUBFRAMES = (0.25, 0.7), 4
"""Share of the iterations that ship, and how many sub-frames: other fits of a picture are as good to learn from."""


@dataclass(frozen=True)
class Row:
    """One frame of a fit, in its window's units.

    Attributes:
        pictures: (2, C, H, W) uint8, as seen and as the fit has it.
        truth: (2, 3, 24, 3) joints at u = 0, 1/2 and 1, the person's and the fit's. start: (24, 3) of the first body.
        unit_m: how many metres one unit of the window is at the person's distance.
        height_m: how tall the person and the fit stand.
    """

    pictures: np.ndarray
    truth: np.ndarray
    start: np.ndarray
    unit_m: float
    height_m: tuple[float, float]


class Gym(Studio):
    """A studio whose pictures are fitted."""

    def __init__(self, mocap: Path, backgrounds: Path, clips: list[str], seed: int, frame_px: int) -> None:
        """Read the named clips and make the scenes."""
        super().__init__(mocap, backgrounds, clips, seed, frame_px)
        self.prior = load_pose_prior(None)

    def rows(self, rng: np.random.Generator) -> list[Row]:
        """One or two frames of one person; draws in which nobody is found are drawn again."""
        for _ in range(50):
            found = self._fitted(rng)
            if found is not None:
                return found
        raise RuntimeError("fifty draws without a person")

    def _fitted(self, rng: np.random.Generator) -> list[Row] | None:
        exposures = _TWO if rng.random() < _PAIRS else _ONE
        motion = self._motion(rng, _SECONDS, _INSTANTS)
        if motion is None:
            return None
        poses, places = motion
        betas = torch.from_numpy(np.clip(rng.standard_normal(10), -2, 2)).float()
        body = dress(self.body, draw_clothing(self.body, rng)) if rng.random() < CLOTHED else self.body
        shaped, bare = body.shape(betas), self.body.shape(betas)
        world = shaped.pose(axis_angle_to_matrix(torch.from_numpy(poses).float()), torch.from_numpy(places).float())
        points = world.vertices[:, ::13].reshape(-1, 3).double().numpy()
        camera = place(self._view(rng), front_of(poses[_INSTANTS // 2, 0]), points, self.frame_px)
        vertices = world.vertices @ torch.from_numpy(camera.R_camera_world).float().T
        vertices = vertices + torch.from_numpy(camera.offset).float()
        plate, texture = self._scene(rng)
        noise, gain = rng.uniform(0.002, 0.012), float(np.exp(rng.normal(0, 0.03)))
        shown = as_file(plate, noise / 2, rng)
        frames, mattes = [], []
        for first, last in exposures:
            mean = self.rasterizer.render_mean(vertices[first : last + 1], texture, camera.lens, body.mesh)
            frames.append(as_file(compose(mean, plate), noise, rng))
            mattes.append(clean(self.matting.look(frames[-1], shown * gain)))
            if mattes[-1].sum() < 60:
                return None
        (first, last), opens = exposures[0], exposures[-1][0]
        step_s = 1 / 30 / (opens or last)
        seen = Observation(
            *(torch.from_numpy(one).float() for one in (np.stack(frames), shown, np.stack(mattes))),
            camera.lens, (last - first) * step_s, (opens or last) * step_s,
        )  # fmt: skip
        camera_poses, translations = in_camera(camera, poses, places, bare.joints[0].double().numpy())
        rotations = axis_angle_to_matrix(torch.from_numpy(camera_poses).float())
        joints = bare.joints_of(rotations, torch.from_numpy(translations).float())
        return self._rows(seen, exposures, camera_poses, joints, betas, rng)

    def _rows(
        self,
        seen: Observation,
        exposures: tuple[tuple[int, int], ...],
        poses: np.ndarray,
        joints: torch.Tensor,
        betas: torch.Tensor,
        rng: np.random.Generator,
    ) -> list[Row]:
        windows = [Window.around(matte.numpy(), seen.camera, rng.normal(0, 0.02, 3)) for matte in seen.mattes]
        firsts = self._first_bodies(exposures, poses, joints, rng)
        result = fit(seen, firsts, self.body, _hasty(rng), int(rng.integers(1 << 30)), self.prior)
        found = Variables(result.trajectory, torch.from_numpy(result.motion.betas).float(), result.texture)
        again = drawn(found, seen, self.body, self.rasterizer, preset("best").fit.subframes)
        turns, places = result.trajectory.at(torch.tensor([0.0, 0.5, 1.0]))
        person = self.body.shape(found.betas)
        rows = []
        for number, ((first, last), window, start) in enumerate(zip(exposures, windows, firsts, strict=True)):
            pictures = [
                picture_channels(one.frames_linear[number].numpy(), seen.plate_linear.numpy(),
                                 one.mattes[number].numpy(), window)
                for one in (seen, again)
            ]  # fmt: skip
            middle = (first + last) // 2
            at_start = self.mean.joints_of(axis_angle_to_matrix(start.pose)[None], start.translation[None])[0]
            fitted = person.joints_of(turns[number], places[number])
            truth = torch.stack([window.to_units(one) for one in (joints[[first, middle, last]], fitted)])
            rows.append(
                Row(
                    np.stack(pictures), truth.numpy(), window.to_units(at_start).numpy(),
                    float(joints[middle, 0, 2]) * window.units_to_tangents(),
                    (float(height_m(self.body, betas)), float(height_m(self.body, found.betas))),
                )
            )  # fmt: skip
        return rows

    def _first_bodies(
        self, exposures: tuple[tuple[int, int], ...], poses: np.ndarray, joints: torch.Tensor, rng: np.random.Generator
    ) -> list[FirstBody]:
        """What one static estimator would say: the mean body, erring alike in all frames, a little aside."""
        count = len(exposures)
        at = [int(np.clip(round(rng.normal((a + b) / 2, 0.2 * (b - a))), a, b)) for a, b in exposures]
        erring = self.erring(poses[at], draw_turns(count, rng), np.full(count, draw_amplitude(rng)))
        stills = self.mean.joints_of(axis_angle_to_matrix(erring), torch.zeros(count, 3))
        nearer, aside = np.exp(rng.normal(0, 0.05)), rng.normal(0, 0.08 * rng.uniform(0, 1) ** 2, 2)
        bodies = []
        for pose, still, row in zip(erring, stills, at, strict=True):
            still = still - still[:1]
            distance = float(joints[row, 0, 2]) * float(nearer * np.exp(rng.normal(0, 0.02)))
            depth = still[:, 2:] + distance
            seen = (joints[row, :, :2] / joints[row, :, 2:]).mean(0) + torch.from_numpy(aside).float() * 0.3
            across = (seen - (still[:, :2] / depth).mean(0)) / (1 / depth).mean(0)
            pelvis = torch.cat([across, torch.tensor([distance])])
            bodies.append(FirstBody(pose, pelvis - self.mean.joints[0].float(), torch.zeros(10), "simulated"))
        return bodies


def _hasty(rng: np.random.Generator) -> FitConfig:
    """What ships, up to before the last stage and in some haste."""
    config = preset("best").fit
    haste = rng.uniform(*_HASTE)
    stages = tuple(
        Stage(**(stage.model_dump() | {"iterations": round(haste * stage.iterations)})) for stage in config.stages[:-1]
    )
    changed = {
        "stages": stages,
        "directions": config.directions.model_copy(update={"search": False}),
        "compare": 0.0,
        "subframes": _SUBFRAMES,
        "settle": round(max(haste, 0.5) * config.settle),
    }
    return config.model_copy(update=changed)


def main() -> None:
    """Write pictures and joints as two files; one frame per row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mocap", type=Path, required=True)
    parser.add_argument("--backgrounds", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frame-px", type=int, default=256)
    parser.add_argument("--split", default="train", choices=SPLITS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    gym = Gym(options.mocap, options.backgrounds, split(options.mocap, options.split), options.seed, options.frame_px)
    options.out.mkdir(parents=True, exist_ok=True)
    shape = (options.count, 2, CHANNELS, PICTURE_PX, PICTURE_PX)
    pictures = np.lib.format.open_memmap(options.out / "pictures.npy", mode="w+", dtype=np.uint8, shape=shape)
    truth = np.zeros((options.count, 2, 3, 24, 3), np.float32)
    starts = np.zeros((options.count, 1, 24, 3), np.float32)
    unit_m, height_m = np.zeros(options.count, np.float32), np.zeros((options.count, 2), np.float32)
    began = time.monotonic()

    def save(done: int) -> None:
        pictures.flush()
        part = options.out / "joints.part.npz"
        np.savez(part, truth=truth, starts=starts, unit_m=unit_m, height_m=height_m, done=done)
        part.rename(options.out / "joints.npz")

    done = number = 0
    while done < options.count:
        for row in gym.rows(np.random.default_rng([options.seed, number])):
            if done == options.count:
                break
            pictures[done], truth[done], starts[done] = row.pictures, row.truth, row.start
            unit_m[done], height_m[done] = row.unit_m, row.height_m
            done += 1
            if done % 250 == 0 or done == 20:
                print(f"{done} frames in {time.monotonic() - began:.0f} s", flush=True)
                save(done)
        number += 1
    save(options.count)


if __name__ == "__main__":
    main()
