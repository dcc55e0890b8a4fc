"""Training data of the priors: windows of recorded motion as long as an exposure, and single poses."""

import fnmatch
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from hfb.datasets.motions.motion_clip import MotionClip, MotionSource
from hfb.datasets.motions.resampling import has_jump, resample
from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.priors.motion_columns import CLOCK, columns_of
from hfb.typing import Array, Float

SHORTEST_S, LONGEST_S = 0.03, 0.5
"""Exposure times that are drawn from: a thirtieth of a second to half of one."""

_HELD_OUT_EVERY = 4
OnProgress = Callable[[int, int], None]


@dataclass(frozen=True)
class Split:
    """Motions to train on, for choices and for tests, by their numbers in a source.

    Attributes:
        trained: motions to learn from.
        held_out: motions for choices.
        tested: motions for the final measurement, never for choices.
    """

    trained: tuple[int, ...]
    held_out: tuple[int, ...]
    tested: tuple[int, ...]


def split_motions(names: Sequence[str], test_patterns: Sequence[str], held_out_patterns: Sequence[str] = ()) -> Split:
    """Split motions into those to learn from, to test and to hold out, by patterns of their names.

    Args:
        names: names of all motions.
        test_patterns: shell patterns of names, such as ``cmu_09_*``.
        held_out_patterns: patterns of the remaining names; every fourth remaining motion, in order, when none are
            given.

    Raises:
        InputError: a pattern fits no motion, or none is left to learn from.
    """
    for pattern in (*test_patterns, *held_out_patterns):
        if not fnmatch.filter(names, pattern):
            raise InputError(f"no motion has a name like {pattern!r}; one is called {names[0]!r}")

    def fitting(patterns: Sequence[str]) -> list[int]:
        return [n for n, name in enumerate(names) if any(fnmatch.fnmatchcase(name, one) for one in patterns)]

    tested = fitting(test_patterns)
    others = [n for n in range(len(names)) if n not in set(tested)]
    if held_out_patterns:
        held_out = [n for n in fitting(held_out_patterns) if n not in set(tested)]
    else:
        held_out = others[_HELD_OUT_EVERY - 1 :: _HELD_OUT_EVERY]
    trained = [n for n in others if n not in set(held_out)]
    if not trained:
        raise InputError("all motions are set apart; leave some to learn from")
    return Split(tuple(trained), tuple(held_out), tuple(tested))


def draw_columns(
    source: MotionSource,
    numbers: Sequence[int],
    per_second: float,
    seed: int,
    refused: dict[str, str],
    on_progress: OnProgress | None = None,
) -> tuple[Float[Array, "n 3 25 4"], Float[Array, "n"]]:
    """Return C of exposures at random times of some motions, and their lengths [s].

    The exposures of a motion depend on its name and the seed, not on the other motions.

    Args:
        source: source of the motions.
        numbers: numbers of the motions to use.
        per_second: number of exposures per second of recording.
        seed: seed of the random times.
        refused: gets the reason by name for each motion that cannot be read.
        on_progress: called with (motions done, motions in all).
    """
    columns, exposures = [np.zeros((0, 3, 25, 4), np.float32)], [np.zeros(0)]
    for done, clip in _clips(source, numbers, refused):
        generator = np.random.default_rng([seed, zlib.crc32(clip.name.encode())])
        poses, translations, exposure_s = draw_exposures(clip, np.array(CLOCK), per_second, generator)
        rotations = axis_angle_to_matrix(torch.from_numpy(poses))
        columns.append(columns_of(rotations, torch.from_numpy(translations)).float().numpy())
        exposures.append(exposure_s)
        if on_progress:
            on_progress(done, len(numbers))
    return np.concatenate(columns), np.concatenate(exposures)


def draw_exposures(
    clip: MotionClip, u: Float[Array, "S"], per_second: float, generator: np.random.Generator
) -> tuple[Float[Array, "n S 24 3"], Float[Array, "n S 3"], Float[Array, "n"]]:
    """Draw random exposures: poses (axis-angle [rad]) and translations [m] at u, in the clip's world, and lengths [s].

    Starts are uniform, lengths log-uniform. Exposures in which the recording jumps are left out.

    Args:
        clip: the recorded motion.
        u: times in exposures, from 0 to 1.
        per_second: exposures per second of recording.
        generator: draws the times.
    """
    lasts_s = (len(clip.poses) - 1) / clip.fps
    longest = min(LONGEST_S, lasts_s)
    count = max(round(lasts_s * per_second), 1) if longest > SHORTEST_S else 0
    exposure_s = np.exp(generator.uniform(np.log(SHORTEST_S), np.log(longest), count)) if count else np.zeros(0)
    starts_s = generator.uniform(0, 1, count) * (lasts_s - exposure_s)
    calm = [not has_jump(clip, a, a + b) for a, b in zip(starts_s.tolist(), exposure_s.tolist(), strict=True)]
    starts_s, exposure_s = starts_s[np.array(calm, bool)], exposure_s[np.array(calm, bool)]
    times_s = np.minimum(starts_s[:, None] + exposure_s[:, None] * u, lasts_s)
    if not times_s.size:
        return np.zeros((0, len(u), 24, 3)), np.zeros((0, len(u), 3)), exposure_s
    poses, translations = resample(clip, times_s.reshape(-1))
    return poses.reshape(*times_s.shape, 24, 3), translations.reshape(*times_s.shape, 3), exposure_s


def take_poses(
    source: MotionSource,
    numbers: Sequence[int],
    per_second: float,
    refused: dict[str, str],
    on_progress: OnProgress | None = None,
) -> Float[Array, "n 69"]:
    """Return axis-angles of joints 1 to 23 [rad] at regular times of some motions.

    Args:
        source: source of the motions.
        numbers: numbers of the motions to use.
        per_second: poses per second of recording.
        refused: gets the reason by name for each motion that cannot be read.
        on_progress: called with (motions done, motions in all).
    """
    poses = [np.zeros((0, 69))]
    for done, clip in _clips(source, numbers, refused):
        times_s = np.arange(0, (len(clip.poses) - 1) / clip.fps, 1 / per_second)
        poses.append(resample(clip, times_s)[0][:, 1:].reshape(-1, 69))
        if on_progress:
            on_progress(done, len(numbers))
    return np.concatenate(poses)


def _clips(source: MotionSource, numbers: Sequence[int], refused: dict[str, str]) -> Iterator[tuple[int, MotionClip]]:
    """Yield (number of motions done, motion) for each that can be read."""
    for done, number in enumerate(numbers, 1):
        try:
            yield done, source.load(number)
        except InputError as error:
            refused[source.names()[number]] = str(error)
