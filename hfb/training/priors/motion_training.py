"""Training of the adversarial motion prior: D and G together, by the paper's four losses."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch.nn import functional

from hfb.kernels.determinism import one_torch_thread
from hfb.priors.motion_columns import at_instants, joint_places, mean_rest_joints
from hfb.priors.motion_networks import Corrector, Discriminator, motion_features
from hfb.priors.motion_weights import make_networks
from hfb.training.priors.motion_corruption import Corrupted, corrupt, mirrored_columns
from hfb.training.priors.training_spec import MotionTraining
from hfb.typing import Float, Tensor

LOSSES = ("indicator", "coefficients", "poses", "joints")
"""The paper's losses: cross entropy of the indicator, L1 of C, L2 of the poses, MPJPE [m]."""

_WEIGHTS = {"indicator": 1.0, "coefficients": 5.0, "poses": 1.0, "joints": 2.0}
_LEAST_SPREAD = 0.05
_LEAST_COEFFICIENT = 0.02
"""Smallest scale of entries of C that hardly vary in the recordings."""

# (epoch, of how many, mean losses of the epoch)
OnEpoch = Callable[[int, int, dict[str, float]], None]


@dataclass(frozen=True)
class TrainedMotionPrior:
    """The networks and one mean loss per epoch for every name in `LOSSES`."""

    discriminator: Discriminator
    corrector: Corrector
    history: dict[str, list[float]]


def train_motion_prior(
    columns: Float[Tensor, "n 3 25 4"], spec: MotionTraining, seed: int, on_epoch: OnEpoch | None = None
) -> TrainedMotionPrior:
    """Train on true motions' C; every batch is mirrored and corrupted anew. The same seed gives the same weights.

    Args:
        columns: motion in the body's own frame, see `motion_columns`.
        spec: sizes, epochs and rates.
        seed: of the random numbers.
        on_epoch: called with the epochs done and their total.

    Raises:
        ValueError: fewer than two motions.
        FloatingPointError: a loss is no longer a number.
    """
    if len(columns) < 2:
        raise ValueError(f"a motion prior is trained on at least 2 motions, not {len(columns)}")
    generator = torch.Generator().manual_seed(seed)
    with one_torch_thread(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)  # fresh weights and dropout come from torch's own generator, given back afterwards
        networks = make_networks(spec.sizes, spec.dropout)
        set_scales(*networks, columns)
        parameters = [one for network in networks for one in network.parameters()]
        optimizer = torch.optim.AdamW(parameters, lr=spec.learning_rate, weight_decay=spec.weight_decay)
        batches = -(-len(columns) // spec.batch)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, spec.epochs * batches)
        history: dict[str, list[float]] = {name: [] for name in LOSSES}
        for epoch in range(spec.epochs):
            means = dict.fromkeys(LOSSES, 0.0)
            for chosen in torch.randperm(len(columns), generator=generator).tensor_split(batches):
                batch = corrupt(_some_mirrored(columns[chosen], generator), generator)
                losses = motion_losses(*networks, batch)
                _step(optimizer, losses)
                schedule.step()
                for name in LOSSES:
                    means[name] += losses[name].item() * len(chosen) / len(columns)
            for name in LOSSES:
                history[name].append(means[name])
            if on_epoch:
                on_epoch(epoch + 1, spec.epochs, means)
    networks[0].temperature.copy_(torch.tensor([spec.temperature, spec.whole_temperature]))
    return TrainedMotionPrior(networks[0].eval(), networks[1].eval(), history)


def _step(optimizer: torch.optim.Optimizer, losses: dict[str, Float[Tensor, ""]]) -> None:
    """Take one step down the weighted sum of the losses."""
    total = torch.stack([_WEIGHTS[name] * losses[name] for name in LOSSES]).sum()
    if not torch.isfinite(total):
        raise FloatingPointError(f"the training's loss is not a number any more: {losses}")
    optimizer.zero_grad()
    total.backward()
    for group in optimizer.param_groups:
        torch.nn.utils.clip_grad_norm_(group["params"], 1.0)
    optimizer.step()


def set_scales(discriminator: Discriminator, corrector: Corrector, columns: Float[Tensor, "n 3 25 4"]) -> None:
    """Set means and scales of the networks' input; first differences have mean zero, as reversal demands.

    Args:
        discriminator: changed in place.
        corrector: changed in place.
        columns: motion in the body's own frame, see `motion_columns`.
    """
    some = columns[:: max(len(columns) // 8000, 1)]
    some = torch.cat([some, mirrored_columns(some)])
    features = motion_features(some, mean_rest_joints())
    mean = features.mean(0) * (discriminator.signs > 0)
    discriminator.mean.copy_(mean)
    discriminator.spread.copy_((features - mean).square().mean(0).sqrt().clamp_min(_LEAST_SPREAD))
    mean = some.mean(0)
    mean[1] = 0
    corrector.mean.copy_(mean)
    corrector.spread.copy_((some - mean).square().mean(0).sqrt().clamp_min(_LEAST_COEFFICIENT))


def motion_losses(discriminator: Discriminator, corrector: Corrector, batch: Corrupted) -> dict[str, Float[Tensor, ""]]:
    """Return the four losses of a batch.

    The indicator is detached in G's input: D is trained by its cross entropy alone, so that its odds stay calibrated.

    Args:
        discriminator: in training.
        corrector: in training.
        batch: corrupted motions.
    """
    rest = mean_rest_joints().to(batch.columns)
    backwards, unrealistic, whole = discriminator(batch.columns, rest)
    corrected = corrector(batch.columns, backwards.detach(), unrealistic.detach())
    u = batch.columns.new_tensor([0.0, 0.5, 1.0])
    turns, places = zip(*(_posed(one, u, rest) for one in (corrected, batch.clean)), strict=True)
    return {
        "indicator": _indicator_loss(backwards, unrealistic, whole, batch),
        "coefficients": (corrected - batch.clean).abs().mean(),
        "poses": (turns[0] - turns[1]).square().sum((-1, -2)).mean(),
        "joints": (places[0] - places[1]).norm(dim=-1).mean(),
    }


def _indicator_loss(backwards: Tensor, unrealistic: Tensor, whole: Tensor, batch: Corrupted) -> Float[Tensor, ""]:
    """Return binary cross entropies of both indicators and of the whole body's direction, each where defined."""
    realistic = ~batch.unrealistic
    agreed = ~torch.isnan(batch.whole)
    entropy = functional.binary_cross_entropy_with_logits
    loss = entropy(backwards[realistic], batch.backwards[realistic].to(backwards))
    loss = loss + entropy(unrealistic, batch.unrealistic.to(unrealistic))
    if agreed.any():
        loss = loss + 0.5 * entropy(whole[agreed], batch.whole[agreed].to(whole))
    return loss


def _posed(columns: Tensor, u: Tensor, rest: Tensor) -> tuple[Tensor, Tensor]:
    rotations, translations = at_instants(columns, u)
    return rotations, joint_places(rest, rotations.flatten(0, 1), translations.flatten(0, 1))


def _some_mirrored(columns: Float[Tensor, "T 3 25 4"], generator: torch.Generator) -> Float[Tensor, "T 3 25 4"]:
    """Mirror half of the motions."""
    mirrored = torch.rand(len(columns), 1, 1, 1, generator=generator) < 0.5
    return torch.where(mirrored, mirrored_columns(columns), columns)
