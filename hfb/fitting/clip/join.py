"""One motion out of overlapping windows: continuous in place and velocity through the whole clip.

Inside the frame that two windows share, their motions are blended with a weight that rises from 0 to 1 and is flat at
both ends (3u^2 - 2u^3), so that at every edge between frames only one window counts. The remaining jump there is
removed by a cubic Hermite correction on both sides, which fades within half an exposure. Over an exposure gap both
frames are continued to the gap's middle and meet there; the longer the gap, the less of the correction reaches into the
frames, and beyond one exposure none does: a cubic bridges a gap that long without changing them.

Rotations are blended along geodesics and corrected in logarithms about the rotation half-way between both sides.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from hfb.body.model import Body
from hfb.fitting.clip.chain_directions import Turned, agree_on_directions
from hfb.fitting.clip.chain_motion import ChainMotion, Edge
from hfb.fitting.clip.windows import WindowFit, runs
from hfb.fitting.identity import Identity
from hfb.geometry.rotations import quaternion_to_axis_angle, quaternion_to_matrix
from hfb.io.media.timing import Timing
from hfb.motion.clock import subframe_clock
from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float


@dataclass(frozen=True)
class JoinedMotion:
    """The motion of one person through a clip.

    Attributes:
        motion: a row per sub-frame of every frame but the gaps'; ``frame_index`` counts the clip's frames, ``times_s``
            are true times since the clip's first shutter opened.
        edges: gaps between neighbouring frames, as fitted and as left.
        turned: limbs that a window had seen run the other way.
        gaps: (first, last) frame of every stretch without the person.
        filled: frames without any image of the person that were bridged between their neighbours.
    """

    motion: SampledMotion
    edges: tuple[Edge, ...]
    turned: tuple[Turned, ...]
    gaps: tuple[tuple[int, int], ...]
    filled: tuple[int, ...]


def join_windows(
    fits: Sequence[WindowFit],
    body: Body,
    identity: Identity,
    *,
    timing: Timing,
    subframes: int,
    K: Float[Array, "3 3"],
    longest_fill: int = 0,
) -> JoinedMotion:
    """Join the windows of a clip into one motion; their order does not matter.

    Args:
        fits: windows of one clip, in any order.
        body: the body model.
        identity: the one that all windows were fitted with.
        timing: timing of the whole clip.
        subframes: N, rows per frame.
        K: camera matrix of the full image [px].
        longest_fill: stretches of at most so many frames without the person are bridged, longer ones are gaps.

    Raises:
        ValueError: no window is given.
    """
    if not fits:
        raise ValueError("a motion is joined from windows, and there is none")
    shaped = body.to(torch.float64).shape(identity.betas.double())
    openings_u = timing.openings_s / timing.exposure_s
    gaps_u = np.maximum(np.diff(openings_u, append=openings_u[-1] + 1) - 1, 0.0)
    ordered, turned = agree_on_directions(fits, shaped, gaps_u)
    chain = ChainMotion.of(ordered, gaps_u)
    clock = subframe_clock(subframes, torch.float64)
    rotations, translations = chain.at(clock.expand(len(chain.frames), -1))
    bridged, turning, moving = chain.bridges(openings_u, clock, longest_fill)
    frames = np.concatenate([chain.frames, bridged]).astype(np.int64)
    order = torch.from_numpy(np.argsort(frames, kind="stable"))
    quaternions = torch.cat([rotations, turning])[order].flatten(0, 1)
    path = torch.cat([translations, moving])[order].flatten(0, 1)
    radius = chain.radius_mm(ordered, clock.numpy())
    if radius is not None:
        unknown = np.full((len(bridged), *radius.shape[1:]), np.nan)
        radius = np.concatenate([radius, unknown])[order.numpy()].reshape(-1, 24)
    frames = frames[order.numpy()]
    # Stamps that vary may lie closer than a shutter that is always open: an exposure ends when the next begins.
    until_next = np.diff(timing.openings_s, append=np.inf)
    lasted = np.minimum(timing.exposure_s, until_next)[frames]
    times_s = (timing.openings_s[frames][:, None] + clock.numpy() * lasted[:, None]).reshape(-1)
    motion = SampledMotion(
        poses=quaternion_to_axis_angle(quaternions).flatten(1).numpy(),
        trans=path.numpy(),
        betas=identity.betas.double().numpy(),
        joints=shaped.joints_of(quaternion_to_matrix(quaternions), path).numpy(),
        times_s=times_s,
        frame_index=np.repeat(frames, subframes),
        K=np.asarray(K, np.float64),
        joint_radius_mm=radius,
    )
    seen = np.zeros(len(timing.openings_s), bool)
    seen[frames] = True
    gaps = tuple((run.start, run.stop - 1) for run in runs(~seen))
    return JoinedMotion(motion, chain.edges(shaped), turned, gaps, tuple(int(frame) for frame in bridged))
