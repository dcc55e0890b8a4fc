"""Writing of a case: the methods' input, the truth, and the record of how it was made."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hfb.datasets.blur_bins import Interval
from hfb.datasets.case import Case, load_case
from hfb.datasets.set_spec import SetSpec
from hfb.datasets.synthetic.motion_search import Candidate
from hfb.datasets.synthetic.scenery import Scenery
from hfb.datasets.synthetic.sharp import save_sharp
from hfb.datasets.synthetic.shooting import Sensor, Shot, develop
from hfb.datasets.truth import Truth, save_truth
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.images.image_io import write_matte, write_png
from hfb.motion.static_pose import FirstBody, save_first_body
from hfb.typing import Float, Tensor

FORMAT = 1
"""Format of case.json; raised when a reader of older cases would go wrong."""


@dataclass(frozen=True, eq=False)
class Story:
    """All facts about a case."""

    spec: SetSpec
    number: int
    wanted: Interval
    blur_rates: list[float]
    found: Candidate
    scenery: Scenery
    truth: Truth
    shots: Sequence[Shot]
    sensor: Sensor
    starts: Sequence[FirstBody]


def write_case(folder: Path, story: Story, plate_linear: Float[Tensor, "H W 3"], rng: np.random.Generator) -> Case:
    """Write all files, case.json last: a folder that has it is complete.

    Args:
        folder: the case's folder.
        story: shots, motion and facts of the case.
        plate_linear: background, linear light.
        rng: draws the sensor's noise.
    """
    case = Case(folder, story.number, story.spec.frames, float(np.mean(story.blur_rates)), {})
    # An earlier case must not look complete while its files are replaced.
    (folder / "case.json").unlink(missing_ok=True)
    write_png(case.background, story.sensor.expose(plate_linear, rng, story.sensor.plate_share))
    boxes = []
    for index, shot in enumerate(story.shots):
        write_png(case.frame_paths()[index], develop(shot, plate_linear, story.sensor, rng))
        write_matte(case.true_matte_paths()[index], shot.mean[..., 3].numpy())
        boxes.append(save_sharp(case.sharp_paths()[index], shot.sharp))
        save_first_body(case.start_paths()[index], story.starts[index])
    save_truth(case.truth, story.truth)
    write_bytes_atomic(case.clip, _clip_toml(story).encode())
    facts = json.dumps(_facts(story, boxes), indent=1, ensure_ascii=False, allow_nan=False)
    write_bytes_atomic(folder / "case.json", (facts + "\n").encode())
    return load_case(folder)


def _clip_toml(story: Story) -> str:
    """Return clip.toml with camera and shutter; numbers are read back to the bit."""
    rows = ", ".join(f"[{', '.join(repr(float(value)) for value in row)}]" for row in story.truth.motion.K)
    clock = story.found.clock
    return f"[camera]\nK = [{rows}]\n\n[exposure]\nfps = {float(clock.fps)!r}\nseconds = {float(clock.exposure_s)!r}\n"


def _facts(story: Story, boxes: list[list[int]]) -> dict[str, Any]:
    spec, found, clock = story.spec, story.found, story.found.clock
    lens = found.camera.lens
    return {
        "format": FORMAT,
        "number": story.number,
        "set": spec.set,
        "seed": spec.seed,
        "fill": spec.fill,
        "easy": spec.easy,
        "frames": spec.frames,
        "blur_rate": float(np.mean(story.blur_rates)),
        "blur_rates": story.blur_rates,
        "bin": list(story.wanted),
        "motion": {
            "name": found.clip.name,
            "number": int(found.number),
            "fps": float(found.clip.fps),
            "start_s": clock.start_s,
            "first_frame": clock.start_s * float(found.clip.fps),
            "exposure_frames": clock.exposure_s * float(found.clip.fps),
        },
        "exposure_s": clock.exposure_s,
        "interval_s": clock.interval_s,
        "instants": clock.instants,
        "camera": {**asdict(lens), **asdict(found.view)},
        "betas": story.truth.motion.betas.tolist(),
        "betas_space": story.truth.betas_space,
        "background": story.scenery.background,
        "texture": story.scenery.texture,
        "light": story.scenery.light,
        "noise": asdict(story.sensor),
        "skipped_pictures": story.scenery.skipped,
        "sharp": boxes,
    }
