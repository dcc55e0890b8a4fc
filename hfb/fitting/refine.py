"""The stage that refines evidence: networks compare each frame with the fit's own re-blurred image.

The joint network makes similar errors on similar images: it is biased towards common poses and towards its first guess.
For the fit's own image the true joints are known. So only the difference between both predictions is used: a control
variate, with less error than either (render and compare: Li et al., DeepIM: Deep Iterative Matching for 6D Pose
Estimation, ECCV 2018, which trains a network for it). Mattes are predicted again with the fit's image as a further
input.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch

from hfb.body.height import height_m
from hfb.body.model import Body
from hfb.config import FitConfig
from hfb.evidence.joint_evidence import JointEvidence, predict_joint_evidence
from hfb.fitting.confidence import start_kind
from hfb.fitting.variables import Variables
from hfb.geometry.camera import PinholeCamera
from hfb.matting.network import RenderConditionedMatting
from hfb.motion.static_pose import FirstBody
from hfb.objective.objective import Objective
from hfb.objective.weights import REFINED_HEIGHT_SCALE, base_weights
from hfb.rendering.formation import compose, see_by_rows
from hfb.rendering.observation import Observation
from hfb.rendering.rasterizer import Rasterizer
from hfb.typing import Float, Tensor

_NOBODY = 0.01
"""Share of a pixel: where both fit and matte cover less, the frame is kept."""

_MATTING_SIZE = 1.25
"""Size at which a matte is predicted again, relative to that at which it is compared."""


@dataclass(frozen=True)
class InitialEvidence:
    """Network predictions from before the first stage, which all refinements start from.

    Attributes:
        observation: the window around the mattes, at full size, with the initial mattes.
        matting_px: longer side [px] at which mattes are predicted again, at most.
        joints: the joint network's prediction; None where no term uses it.
        corrected: whether the prediction is corrected between stages. What corrects it learned from starts with
            simulated errors: from a pose network's start, fits of real images are better without.
    """

    observation: Observation
    matting_px: int
    joints: JointEvidence | None = None
    corrected: bool = True

    @cached_property
    def mattings(self) -> tuple[RenderConditionedMatting, ...]:
        """One matting network input per frame: most of it is the same in every refinement."""
        seen = self.observation
        plate = seen.to_linear(seen.plate_linear).numpy()
        frames = zip(seen.to_linear(seen.frames_linear).numpy(), seen.mattes.numpy(), strict=True)
        return tuple(RenderConditionedMatting(frame, plate, matte, self.matting_px) for frame, matte in frames)


def predict_initial_evidence(
    observation: Observation, first_bodies: Sequence[FirstBody], body: Body, config: FitConfig, *, square: bool
) -> InitialEvidence:
    """Run the joint network on every frame, if a term of the objective or the warm-up needs it.

    Args:
        observation: whole frames with their mattes.
        first_bodies: one static body per frame.
        body: the body model.
        config: options of the fit.
        square: make the window around the mattes a square.

    Raises:
        InputError: all mattes are empty.
    """
    window = observation.cropped(*observation.region(square=square))
    weights = base_weights(config, len(first_bodies))
    needed = config.settle > 0 or weights.joints + weights.path + weights.height > 0
    return InitialEvidence(
        window,
        round(_MATTING_SIZE * max((stage.size_px for stage in config.stages), default=0)),
        predict_joint_evidence(observation, first_bodies, body) if needed else None,
        corrected=not seen_by_network(first_bodies),
    )


def seen_by_network(first_bodies: Sequence[FirstBody]) -> bool:
    """Whether a pose network, or another system, saw any of the bodies.

    Args:
        first_bodies: one static body per frame.
    """
    return "network" in {start_kind(one.source) for one in first_bodies}


def refine_stage_inputs(
    initial: InitialEvidence, objective: Objective, variables: Variables, config: FitConfig, *, full_size: bool
) -> Objective:
    """Update the evidence of the objective between two stages.

    Joint depth is predicted again from the fit's joints by the lifting network. Before a stage of full size the fit's
    own image is rendered, and joints and mattes are refined with it. Joints stay as predicted where they are not to be
    corrected.

    Args:
        initial: predictions from before the first stage.
        objective: at full size, with the evidence of the last stage.
        variables: the best iterate of the last stage.
        config: options of the fit.
        full_size: the next stage has the last stage's image size.
    """
    joints, seen = initial.joints, objective.observation
    lifting, compare = (config.lifting, config.compare) if initial.corrected else (0.0, 0.0)
    if joints is not None and lifting > 0:
        joints = joints.lift(variables.joints_at_middle(objective.body), lifting)
    if not full_size or (compare == 0 and not config.matte_again):
        return replace(objective, evidence=joints)
    blurred = render_blurred(
        variables, seen.camera, body=objective.body, rasterizer=objective.rasterizer, subframes=objective.subframes
    )
    if initial.joints is not None and joints is not None and compare > 0:
        joints = refine_evidence(joints, initial.joints, objective, variables=variables, blurred=blurred, config=config)
    if config.matte_again:
        seen = refine_mattes(blurred, initial)
    return replace(objective, evidence=joints, observation=seen)


def refine_evidence(
    joints: JointEvidence,
    initial: JointEvidence,
    objective: Objective,
    *,
    variables: Variables,
    blurred: Float[Tensor, "T H W 4"],
    config: FitConfig,
) -> JointEvidence:
    """Move the evidence by a share of the difference between the predictions for the frame and for the fit's image.

    With ``config.fuse_depth`` its depth comes from the fusion network, which weighs both predictions and the fit. The
    height becomes the fit's, corrected by the whole difference; for a single frame only at the first refinement, since
    one image determines proportions so poorly that further corrections add noise.

    Args:
        joints: evidence to move, with lifted depth.
        initial: the prediction for the frames.
        objective: its observation has the frames that `blurred` shows, its evidence the last stage's height.
        variables: the fit.
        blurred: the fit's own images, see `render_blurred`.
        config: options of the fit.
    """
    body = objective.body
    rendered = initial.predict_for(compose_blurred(blurred, objective.observation))
    difference = config.compare * (initial.middle - rendered.middle)
    if config.fuse_depth:
        joints = initial.fuse(rendered, variables.joints_at_middle(body))
        difference = difference * difference.new_tensor([1.0, 1.0, 0.0])
    moved = replace(joints, middle=joints.middle + difference)
    last = objective.evidence
    if last is not None and last.height_refined and len(last.windows) == 1:
        return replace(moved, log_height=last.log_height, height_scale=last.height_scale, height_refined=True)
    with torch.no_grad():
        tall = height_m(body, variables.betas).log()
    return replace(
        moved,
        log_height=tall + initial.log_height - rendered.log_height,
        height_scale=REFINED_HEIGHT_SCALE * joints.height_scale,
        height_refined=True,
    )


def refine_mattes(blurred: Float[Tensor, "T H W 4"], initial: InitialEvidence) -> Observation:
    """Predict the mattes again, with the fit's images as a further input of the network (`hfb.matting.third_look`).

    Args:
        blurred: see `render_blurred`.
        initial: predictions from before the first stage.
    """
    seen = initial.observation
    plate = seen.to_linear(seen.plate_linear)
    over = seen.to_linear(compose(blurred, seen.plate_linear))
    alpha = blurred[..., 3:]
    fitted = torch.cat([(over - (1 - alpha) * plate).clamp(0, 1), alpha], -1)
    mattes = [torch.from_numpy(one.matte(fit)) for one, fit in zip(initial.mattings, fitted.numpy(), strict=True)]
    return replace(seen, mattes=torch.stack(mattes).to(seen.mattes))


def render_blurred(
    variables: Variables, camera: PinholeCamera, *, body: Body, rasterizer: Rasterizer, subframes: int
) -> Float[Tensor, "T H W 4"]:
    """Render the fit's re-blurred images: premultiplied colour and silhouette; no gradient.

    Args:
        variables: the fit.
        camera: camera of the image.
        body: the body model.
        rasterizer: renders the images.
        subframes: N.
    """
    with torch.no_grad():
        return torch.stack(
            [
                rasterizer.render_mean(one, variables.texture, camera, body.mesh)
                for one in see_by_rows(variables.vertices(body, subframes), camera)
            ]
        )


def compose_blurred(blurred: Float[Tensor, "T H W 4"], seen: Observation) -> Observation:
    """Compose the fit's images over the plate, with its silhouettes as mattes.

    Pixels without a person stay as they were observed: both images then have the same camera noise there.

    Args:
        blurred: see `render_blurred`.
        seen: frames, plate and mattes at the same size.
    """
    alpha = blurred[..., 3]
    bare = torch.maximum(alpha, seen.mattes) < _NOBODY
    frames = torch.where(bare[..., None], seen.frames_linear, compose(blurred, seen.plate_linear))
    return replace(seen, frames_linear=frames, mattes=alpha)
