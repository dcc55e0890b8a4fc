"""Make one case of a synthetic set: a person in motion, photographed with an open shutter.

The truth is rendered from a denser (and, in bc-cape, clothed) surface than the fitted one, at more instants, with
sensor noise and 8-bit files, so that a fit has no advantage from sharing the generator's model.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from hfb.body.assets import load_body
from hfb.body.model import Body, ShapedBody
from hfb.body.subdivision import subdivide
from hfb.datasets.blur_bins import Interval, wanted_interval
from hfb.datasets.blur_rates import blur_rates
from hfb.datasets.case import Case
from hfb.datasets.motions.motion_clip import MotionClip, MotionSource
from hfb.datasets.motions.resampling import resample
from hfb.datasets.motions.sources import open_motions
from hfb.datasets.set_spec import SetSpec
from hfb.datasets.simulated_start import simulated_starts
from hfb.datasets.synthetic.case_files import Story, write_case
from hfb.datasets.synthetic.clothed import draw_clothing, dress, on_subdivided
from hfb.datasets.synthetic.exposures import Clock, shutter_of
from hfb.datasets.synthetic.motion_search import Candidate, candidates
from hfb.datasets.synthetic.scenery import Scenery, draw_scenery, to_file_and_back
from hfb.datasets.synthetic.shooting import NO_NOISE, Shot, draw_sensor, shoot, touches_border
from hfb.datasets.synthetic.viewpoints import in_camera
from hfb.datasets.truth import Truth
from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.kernels.determinism import one_torch_thread
from hfb.motion.clock import subframe_times_s
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float

_SET_NUMBERS = {"bt-amass": 1, "bc-cape": 2}
_LARGEST_BETA = 2.0
_BORDER_PX = 3
_KEPT_BYTES = 256 << 20


def make_case(spec: SetSpec, number: int, usable: Sequence[int], folder: Path) -> Case:
    """Make case `number` (from 1) of a set in a folder: every file that `hfb.datasets.case` names.

    The bytes depend only on the set, the number and the usable motions.

    Args:
        spec: specification of the set.
        number: number of the case, from 1.
        usable: numbers of the motions that can be read, see `hfb.datasets.motions.sources.usable`.
        folder: written to.

    Raises:
        InputError: no motion has the blur that is wanted, or a folder of images holds none.
    """
    if not usable:
        raise InputError("no motion can be read; give a folder with AMASS .npz or .bvh files, or none")
    entropy = np.random.SeedSequence((spec.seed, number, _SET_NUMBERS[spec.set]))
    for_person, for_scenery, for_search, for_sensor, for_start = (
        np.random.default_rng(child) for child in entropy.spawn(5)
    )
    with one_torch_thread():
        actor = _draw_actor(spec, for_person)
        scenery = draw_scenery(spec.backgrounds, spec.textures, actor.truth_body, spec.size_px, for_scenery)
        wanted = wanted_interval(spec.set, spec.frames, spec.fill, number)
        scene = _find_scene(spec, usable, wanted, actor, scenery, for_search)
        sensor, plate = draw_sensor(for_sensor), scenery.plate_linear
        if spec.easy:
            sensor, plate = NO_NOISE, to_file_and_back(plate)
        starts = simulated_starts(
            scene.truth, spec.frames, scene.blur_rate, actor.fit_body, scene.found.camera.lens, for_start
        )
        story = Story(
            spec, number, wanted, scene.rates.tolist(), scene.found, scenery, scene.truth, scene.shots, sensor, starts
        )
        return write_case(folder, story, plate, for_sensor)


@dataclass(frozen=True, eq=False)
class _Actor:
    """A person: the mesh that is fitted, the one that is rendered, and the clothes of both."""

    fit_body: Body
    truth_body: Body
    betas: Float[Array, "10"]
    clothing: Float[Array, "V 3"] | None

    def quick(self, clip: MotionClip) -> ShapedBody:
        """Return the person in this motion's clothes, on the mesh with fewer triangles."""
        clothing = self._worn(clip)
        body = self.fit_body if clothing is None else dress(self.fit_body, clothing)
        return body.shape(torch.from_numpy(self.betas).float())

    def photographed(self, clip: MotionClip) -> Body:
        """Return the person in this motion's clothes, as the truth shows them."""
        clothing = self._worn(clip)
        if clothing is None:
            return self.truth_body
        return dress(self.truth_body, on_subdivided(self.fit_body, clothing))

    def _worn(self, clip: MotionClip) -> Float[Array, "V 3"] | None:
        recorded = clip.clothing
        if self.clothing is None or recorded is None or len(recorded) != len(self.fit_body.template):
            return self.clothing
        return recorded.astype(np.float64)


def _draw_actor(spec: SetSpec, rng: np.random.Generator) -> _Actor:
    fit_body, dense = _bodies(spec.body)
    betas = np.clip(rng.standard_normal(10), -_LARGEST_BETA, _LARGEST_BETA)
    clothed = spec.set == "bc-cape" and not spec.easy
    return _Actor(fit_body, fit_body if spec.easy else dense, betas, draw_clothing(fit_body, rng) if clothed else None)


@dataclass(frozen=True, eq=False)
class _Scene:
    """The scenery and the exposures."""

    found: Candidate
    truth: Truth
    shots: list[Shot]
    rates: Float[Array, "T"]

    @property
    def blur_rate(self) -> float:
        return float(self.rates.mean())


def _find_scene(
    spec: SetSpec, usable: Sequence[int], wanted: Interval, actor: _Actor, scenery: Scenery, rng: np.random.Generator
) -> _Scene:
    """Return the first candidate whose full-size truth has the wanted blur rate and a margin to the image's border."""
    found = candidates(
        _shelf(spec.motions, spec.seed),
        usable,
        actor.quick,
        shutter_of(spec.set),
        wanted,
        spec.fill == "natural",
        spec.frames,
        spec.size_px,
        rng,
    )
    for candidate in found:
        body, camera = actor.photographed(candidate.clip), candidate.camera.lens
        motion = _motion(candidate, actor)
        shots = [shoot(motion, frame, body, scenery.texture_linear, camera) for frame in range(spec.frames)]
        rates = blur_rates(np.stack([shot.silhouettes for shot in shots]))
        if wanted[0] <= rates.mean() < wanted[1] and not any(touches_border(shot, _BORDER_PX) for shot in shots):
            silhouettes = np.concatenate([shot.silhouettes for shot in shots])
            return _Scene(candidate, Truth(motion, silhouettes, body.betas_space), shots, rates)
    raise InputError(
        f"none of {len(usable)} motions gave a blur rate from {wanted[0]:g} to {wanted[1]:g}; "
        'give more or livelier motions, or fill the set as they come ("natural")'
    )


def _motion(found: Candidate, actor: _Actor) -> SampledMotion:
    """Return the true motion in camera coordinates at every instant."""
    clock: Clock = found.clock
    poses, translations = resample(found.clip, clock.times_s())
    body = actor.fit_body
    betas = torch.from_numpy(actor.betas)
    pelvis = (body.joint_template[0].double() + body.joint_shape_directions[0].double() @ betas).numpy()
    poses, translations = in_camera(found.camera, poses, translations, pelvis)
    shaped = body.shape(betas.float())
    joints = shaped.joints_of(
        axis_angle_to_matrix(torch.from_numpy(poses).float()), torch.from_numpy(translations).float()
    )
    times_s, frame_index = subframe_times_s(clock.frames, clock.instants, clock.exposure_s, clock.interval_s)
    return SampledMotion(
        poses=poses.reshape(len(poses), 72),
        trans=translations,
        betas=actor.betas,
        joints=joints.double().numpy(),
        times_s=times_s,
        frame_index=frame_index,
        K=found.camera.lens.matrix().numpy(),
    )


@lru_cache(maxsize=2)
def _bodies(path: Path | None) -> tuple[Body, Body]:
    """Return the mesh that is fitted and the denser one that is rendered."""
    body = load_body(path)
    return body, subdivide(body)


@lru_cache(maxsize=2)
def _source(folder: Path | None, seed: int) -> MotionSource:
    return open_motions(folder, seed)


class _Shelf:
    """A cache of motions that were read recently."""

    def __init__(self, source: MotionSource) -> None:
        self._source = source
        self._clips: OrderedDict[int, MotionClip] = OrderedDict()

    def __call__(self, index: int) -> MotionClip:
        clip = self._clips.pop(index, None)
        if clip is None:
            clip = self._source.load(index)
        self._clips[index] = clip
        while sum(kept.poses.nbytes for kept in self._clips.values()) > _KEPT_BYTES and len(self._clips) > 1:
            self._clips.popitem(last=False)
        return clip


@lru_cache(maxsize=2)
def _shelf(folder: Path | None, seed: int) -> _Shelf:
    return _Shelf(_source(folder, seed))
