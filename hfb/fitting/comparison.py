"""Networks look at the picture beside what the fit makes of it: where joints differ, and for a better matte.

The joint network errs alike on pictures that look alike: it draws towards what is common, hangs on its first guess,
misjudges a view. Of the fit's own picture the truth is known. What the network says of both differs by what it sees to
be different, and that is off by less than either (a control variate; render and compare: Li et al., DeepIM: Deep
Iterative Matching for 6D Pose Estimation, ECCV 2018, where a network is trained for it).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import torch

from hfb.body.height import height_m
from hfb.body.model import Body
from hfb.config import FitConfig
from hfb.evidence.joint_evidence import JointEvidence
from hfb.fitting.variables import Variables
from hfb.geometry.camera import PinholeCamera
from hfb.matting.network import BesideFit
from hfb.objective.objective import Objective
from hfb.rendering.formation import compose
from hfb.rendering.observation import Observation
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Float, Tensor

_HEIGHT_SHARE = 0.22
"""Of the claim's own scale: 20 times the word on the height once two claims of it are compared."""

_NOBODY = 0.01
"""Of a pixel: where fit and matte cover less, nobody is."""


def beside_the_fit(
    evidence: JointEvidence,
    claimed: JointEvidence,
    variables: Variables,
    objective: Objective,
    blurred: Float[Tensor, "T H W 4"],
    config: FitConfig,
) -> JointEvidence:
    """The evidence, moved by a share of what the network sees to differ between the picture and the fit's own.

    With ``config.fuse_depth`` its depth is what the fusion network makes of that difference and of all else.
    Its height becomes the fit's, changed by the whole of what the network sees to differ; of a single frame at the
    first comparison alone: one picture tells so little of proportions that further ones add but their own errors.

    Args:
        claimed: what the network said about the picture.
        objective: with the observation that the fit is drawn for, and the evidence until now.
        blurred: the fit's own pictures, see `drawn`.
    """
    body = objective.body
    told = claimed.of(shown(blurred, objective.observation))
    difference = config.compare * (claimed.middle - told.middle)
    if config.fuse_depth:
        evidence = claimed.fused(told, variables.joints_at_middle(body))
        difference = difference * difference.new_tensor([1.0, 1.0, 0.0])
    moved = replace(evidence, middle=evidence.middle + difference)
    before = objective.evidence
    if before is not None and before.height_compared and len(before.windows) == 1:
        return replace(moved, log_height=before.log_height, height_scale=before.height_scale, height_compared=True)
    with torch.no_grad():
        tall = height_m(body, variables.betas).log()
    return replace(
        moved,
        log_height=tall + claimed.log_height - told.log_height,
        height_scale=_HEIGHT_SHARE * evidence.height_scale,
        height_compared=True,
    )


def drawn(
    variables: Variables, camera: PinholeCamera, body: Body, rasterizer: Rasterizer, subframes: int
) -> Float[Tensor, "T H W 4"]:
    """The fit's re-blurred pictures by themselves, premultiplied, with their silhouettes; no gradient."""
    with torch.no_grad():
        return torch.stack(
            [
                rasterizer.render_mean(one, variables.texture, camera, body.mesh)
                for one in variables.vertices(body, subframes)
            ]
        )


def shown(blurred: Float[Tensor, "T H W 4"], seen: Observation) -> Observation:
    """The fit's pictures over the plate, its silhouettes as mattes.

    What nobody covers stays as it was seen: the camera's noise there is in both pictures then, and in no difference.
    """
    alpha = blurred[..., 3]
    bare = torch.maximum(alpha, seen.mattes) < _NOBODY
    frames = torch.where(bare[..., None], seen.frames_linear, compose(blurred, seen.plate_linear))
    return replace(seen, frames_linear=frames, mattes=alpha)


@dataclass(frozen=True)
class Before:
    """What the networks said before any stage."""

    observation: Observation
    evidence: JointEvidence | None = None

    @cached_property
    def besides(self) -> tuple[BesideFit, ...]:
        """Every frame for another look at its matte: most of what that needs is the same each time."""
        seen = self.observation
        plate = seen.to_linear(seen.plate_linear).numpy()
        frames = zip(seen.to_linear(seen.frames_linear).numpy(), seen.mattes.numpy(), strict=True)
        return tuple(BesideFit(frame, plate, matte) for frame, matte in frames)


def matted_again(blurred: Float[Tensor, "T H W 4"], before: Before) -> Observation:
    """With mattes that a network finds once it sees the fit's pictures, too (`hfb.matting.third_look`)."""
    seen = before.observation
    plate = seen.to_linear(seen.plate_linear)
    over = seen.to_linear(compose(blurred, seen.plate_linear))
    alpha = blurred[..., 3:]
    fitted = torch.cat([(over - (1 - alpha) * plate).clamp(0, 1), alpha], -1)
    mattes = [torch.from_numpy(one.matte(fit)) for one, fit in zip(before.besides, fitted.numpy(), strict=True)]
    return replace(seen, mattes=torch.stack(mattes).to(seen.mattes))
