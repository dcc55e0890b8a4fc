"""Search for the directions of a motion: hypotheses that reverse the fitted motion, or a limb of it, in time.

One uniformly exposed image is the same for both directions of the whole body, and nearly the same for both directions
of a limb; the fit finds one of these motions by chance. The others are computed from it exactly, refitted briefly, and
compared by the objective (image, matte, pose prior and, for several frames, continuity) and by the motion prior.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from hfb.body.model import ShapedBody
from hfb.config import DirectionsConfig
from hfb.fitting.alternatives import LIMB_JOINTS, MOVES_M, Alternatives
from hfb.fitting.direction_odds import EVIDENCE, LARGEST_EXCESS, probabilities
from hfb.fitting.reversal import limb_columns, reverse_columns
from hfb.fitting.variables import Variables
from hfb.kernels.adam import Adam
from hfb.motion.clock import subframe_clock
from hfb.motion.sampled import SampledMotion, sample_motion
from hfb.motion.trajectory import Trajectory
from hfb.objective.objective import Objective
from hfb.priors.motion_columns import LIMBS
from hfb.typing import Array, Bool, Float, Tensor

_REFIT_RATE, _POLISH_RATE = 0.003, 0.002
"""Learning rates of Adam [rad and m per step]; only the effects of the reversal need repair."""

_ROLLING_REFIT = 60
"""Least iterations of a refit with a rolling shutter: a motion that runs backwards leans the other way, by .1 rad."""

_ADAM_EPSILON = 1e-4
_CONVINCING = 1.25
"""Ratio of probabilities above which a motion with reversed limbs replaces the fitted one (or its reverse)."""

_IN_DOUBT = (0.02, 1.0)
"""Range of the excess loss, before refitting, in which a refit may change the choice."""


@dataclass(frozen=True)
class _Hypothesis:
    """A motion with some limbs reversed, its terms, and their weighted sum."""

    reversed_limbs: Bool[Tensor, "T 5"]
    trajectory: Trajectory
    terms: dict[str, float]
    loss: float

    def mirrored(self, found: Variables, objective: Objective, shaped: ShapedBody) -> "_Hypothesis":
        """Return the whole motion of one frame reversed: its image, and so the image terms, stay the same."""
        trajectory = reverse_columns(self.trajectory, limb_columns(torch.ones_like(self.reversed_limbs)))
        with torch.no_grad():
            here, there = (
                _without_prior(objective.body_terms(one, found.betas, shaped)) for one in (self.trajectory, trajectory)
            )
            change = {name: (there[name] - here[name]).item() for name in here}
            loss = self.loss + (objective.total(there) - objective.total(here)).item() if here else self.loss
        terms = {name: value + change.get(name, 0.0) for name, value in self.terms.items()}
        return _Hypothesis(~self.reversed_limbs, trajectory, terms, loss)


def search_directions(
    found: Variables, coarse: Objective, fine: Objective, config: DirectionsConfig
) -> tuple[Trajectory, Alternatives]:
    """Find the likeliest directions of a motion; the fitted motion stays bit for bit where none is likelier.

    Args:
        found: fitted variables; every hypothesis keeps their shape and texture.
        coarse: the objective of the last stage at a small image size: there hypotheses are refitted and compared.
        fine: the objective of the last stage: there the winner is polished, where it is another than what was fitted.
            Its motion prior is what knows time's arrow; without one an image says nothing about the whole body.
        config: options of the search.
    """
    with torch.no_grad():
        shaped = fine.body.shape(found.betas)
    rolling = fine.observation.camera.row_clock is not None
    if rolling:
        config = config.model_copy(update={"iterations": max(config.iterations, _ROLLING_REFIT)})
    hypotheses = _hypotheses(found, shaped, coarse, config)
    several, ways = len(hypotheses[0].reversed_limbs) > 1, len(hypotheses)
    if rolling and not several:
        hypotheses += _other_way(found, shaped, coarse, config)
        hypotheses[ways] = _refit(hypotheses[ways], found, fine, config.iterations, _POLISH_RATE)
    elif not several:
        hypotheses += [one.mirrored(found, coarse, shaped) for one in hypotheses]
    fitted = hypotheses[0].loss
    evidence = np.array([_evidence(one, fitted, fine, shaped) for one in hypotheses])
    scores = {name: np.array([one.terms[name] for one in hypotheses]) for name in hypotheses[0].terms}
    losses = [one.loss for one in hypotheses]
    probability = probabilities(evidence, several)
    as_fitted = [0] if several else [0, ways]  # the motion that was fitted, and its reverse
    chosen = _likeliest(probability, as_fitted)
    if chosen not in as_fitted:
        hypotheses[chosen] = _refit(hypotheses[chosen], found, fine, config.polish, _POLISH_RATE)
    motions = [_sampled(one.trajectory, found, fine, shaped) for one in hypotheses]
    alternatives = Alternatives(
        reversed_limbs=torch.stack([one.reversed_limbs for one in hypotheses]).numpy(),
        poses=np.stack([motion.poses for motion in motions]),
        trans=np.stack([motion.trans for motion in motions]),
        joints=np.stack([motion.joints for motion in motions]),
        scores=scores | {"loss": np.array(losses)} | dict(zip(EVIDENCE, evidence.T, strict=True)),
        probability=probability,
        chosen=chosen,
        frame_index=motions[0].frame_index,
    )
    if not several and chosen in as_fitted and np.round(alternatives.body_right()[0], 6) < 0.5:
        # Likelier than any other alone, but the others together imply that the body moved the other way.
        alternatives = replace(alternatives, chosen=ways - chosen)
    return hypotheses[alternatives.chosen].trajectory, alternatives


def _likeliest(probability: Float[Array, "A"], as_fitted: Sequence[int]) -> int:
    """Return the likeliest hypothesis; one that was not fitted to the full images must be clearly likelier."""
    handicapped = probability / _CONVINCING
    handicapped[as_fitted] = probability[as_fitted]
    return int((handicapped > handicapped.max() - 1e-5).argmax())  # a tie but for rounding stays what was fitted


def _hypotheses(
    found: Variables, shaped: ShapedBody, objective: Objective, config: DirectionsConfig
) -> list[_Hypothesis]:
    """Return the fitted motion, then its reversals, the likeliest of them refitted."""
    moves = _moving_limbs(found.trajectory, shaped, subframe_clock(objective.subframes))
    turned = [
        _evaluate_hypothesis(limbs, reverse_columns(found.trajectory, limb_columns(limbs)), found, objective)
        for limbs in _turns(moves, config.limbs)
    ]
    start = _evaluate_hypothesis(torch.zeros_like(moves), found.trajectory, found, objective)
    low, high = (start.loss + bound for bound in _IN_DOUBT)
    doubtful = [index for index, one in enumerate(turned) if low < one.loss < high]
    if not doubtful:
        return [start, *turned]
    # The fitted motion is refitted at this image size, too, for the comparison only; hypotheses that are not refitted
    # are assumed to gain as much.
    compared = _refit(start, found, objective, config.iterations, _REFIT_RATE)
    gain = start.loss - compared.loss
    turned = [replace(one, loss=one.loss - gain) for one in turned]
    for index in sorted(doubtful, key=lambda index: turned[index].loss)[: config.refits]:
        turned[index] = _refit(turned[index], found, objective, config.iterations, _REFIT_RATE)
    return [replace(compared, trajectory=found.trajectory), *turned]


def _other_way(
    found: Variables, shaped: ShapedBody, objective: Objective, config: DirectionsConfig
) -> list[_Hypothesis]:
    """Return the whole motion of one frame backwards, refitted, then with each limb forwards.

    With a rolling shutter the reversed motion has another image: what leaned because its rows are seen one after
    another leans the other way.
    """
    whole = torch.ones(1, len(LIMBS), dtype=torch.bool)
    back = _evaluate_hypothesis(whole, reverse_columns(found.trajectory, limb_columns(whole)), found, objective)
    back = _refit(back, found, objective, config.iterations, _REFIT_RATE)
    refitted = _hypotheses(replace(found, trajectory=back.trajectory), shaped, objective, config)
    return [replace(one, reversed_limbs=~one.reversed_limbs) for one in refitted]


def _moving_limbs(trajectory: Trajectory, shaped: ShapedBody, clock: Float[Tensor, "S"]) -> Bool[Tensor, "T 5"]:
    """Return limbs whose reversal moves one of their joints; for the torso, any joint."""
    frames = trajectory.rotation.shape[0]

    def joints(motion: Trajectory) -> Float[Tensor, "T S 24 3"]:
        with torch.no_grad():
            rotations, translations = motion.at(clock)
            return shaped.joints_of(rotations.flatten(0, 1), translations.flatten(0, 1)).unflatten(0, (frames, -1))

    before, moves = joints(trajectory), []
    for place, members in enumerate(LIMB_JOINTS):
        limbs = torch.zeros(frames, len(LIMBS), dtype=torch.bool)
        limbs[:, place] = True
        moved = (joints(reverse_columns(trajectory, limb_columns(limbs))) - before).norm(dim=-1)
        moves.append(moved[:, :, slice(None) if 0 in members else list(members)].amax((1, 2)) >= MOVES_M)
    return torch.stack(moves, 1)


def _turns(moves: Bool[Tensor, "T 5"], each_limb: bool) -> list[Bool[Tensor, "T 5"]]:
    """Return reversals to try: for several frames each one and all of them; for every frame each limb that moves."""
    frames, turns = len(moves), []
    whole: Sequence[int | slice] = (*range(frames), slice(None)) if frames > 1 else ()
    places = [tuple(place) for place in moves.nonzero().tolist()] if each_limb else []
    for place in (*whole, *places):
        limbs = torch.zeros_like(moves)
        limbs[place] = True
        turns.append(limbs)
    return turns


def _terms(trajectory: Trajectory, found: Variables, objective: Objective) -> dict[str, Float[Tensor, ""]]:
    return _without_prior(objective.terms(trajectory, found.betas.detach(), found.texture.detach()))


def _without_prior(terms: dict[str, Float[Tensor, ""]]) -> dict[str, Float[Tensor, ""]]:
    """Return all terms but the motion prior's, which is a separate kind of evidence."""
    return {name: value for name, value in terms.items() if name != "adversarial"}


def _values(terms: dict[str, Float[Tensor, ""]]) -> dict[str, float]:
    return {name: value.item() for name, value in terms.items()}


def _evaluate_hypothesis(
    limbs: Bool[Tensor, "T 5"], trajectory: Trajectory, found: Variables, objective: Objective
) -> _Hypothesis:
    with torch.no_grad():
        terms = _terms(trajectory, found, objective)
        return _Hypothesis(limbs, trajectory, _values(terms), objective.total(terms).item())


def _refit(start: _Hypothesis, found: Variables, objective: Objective, iterations: int, rate: float) -> _Hypothesis:
    """Return best iterate of Adam on the motion alone, with a cosine decay of the learning rate."""
    began = start.trajectory
    rotation, translation = (one.detach().clone().requires_grad_() for one in (began.rotation, began.translation))
    free = began.with_coefficients(rotation, translation)
    optimizer = Adam([rotation, translation], _ADAM_EPSILON)
    best = replace(start, loss=math.inf)  # the start's own loss may be of another image size
    for iteration in range(iterations + 1):
        terms = _terms(free, found, objective)
        total = objective.total(terms)
        if total.item() < best.loss:
            motion = began.with_coefficients(rotation.detach().clone(), translation.detach().clone())
            best = _Hypothesis(start.reversed_limbs, motion, _values(terms), total.item())
        if iteration == iterations:
            break
        total.backward()
        optimizer.step([rate * (0.1 + 0.45 * (1 + math.cos(math.pi * iteration / iterations)))] * 2)
    return best if math.isfinite(best.loss) else start


def _evidence(one: _Hypothesis, fitted: float, objective: Objective, shaped: ShapedBody) -> Float[Array, "E"]:
    """Return evidence against a hypothesis, see `EVIDENCE`; `fitted` is the loss of the fitted motion."""
    against = [torch.zeros(1)] * (len(EVIDENCE) - 1)
    with torch.no_grad():
        if (prior := objective.motion_prior) is not None:
            columns = prior.reversed_logits(one.trajectory, shaped)
            limbs = torch.stack([columns[:, list(members)].mean(1) for members in LIMBS.values()])
            against[:2] = limbs, prior.whole_body_logit(one.trajectory, shaped)
        if (seen := objective.evidence) is not None:
            rotations, translations = one.trajectory.at(one.trajectory.rotation.new_tensor([0.0, 1.0]))
            joints = shaped.joints_of(rotations.flatten(0, 1), translations.flatten(0, 1)).unflatten(0, (-1, 2))
            opening, closing = seen.units(joints).unbind(1)
            against[2] = seen.backwards_logit(closing - opening)
        costs = [torch.nn.functional.softplus(logits).sum().item() for logits in against]
    return np.array([min(one.loss - fitted, LARGEST_EXCESS), *costs])


def _sampled(trajectory: Trajectory, found: Variables, objective: Objective, shaped: ShapedBody) -> SampledMotion:
    seen = objective.observation
    return sample_motion(
        trajectory, shaped, found.betas, objective.subframes, seen.exposure_s, seen.interval_s, seen.camera.matrix()
    )
