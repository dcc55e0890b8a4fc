"""Training of the motion prior: what is done to motions on purpose, and that the networks learn to tell it."""

import pytest
import torch

from hfb.priors.motion_columns import LIMBS, reversed_columns
from hfb.training.priors.motion_corruption import corrupt, draw_reversals, with_errors_of_a_fit
from hfb.training.priors.motion_measures import measure_motion_prior
from hfb.training.priors.motion_training import LOSSES, train_motion_prior
from hfb.training.priors.training_spec import MotionTraining, NetworkSizes

SMALL = NetworkSizes(discriminator_width=48, discriminator_depth=2, corrector_width=48, corrector_depth=2)


def made_motions(count: int, seed: int) -> torch.Tensor:
    """C of a people that always moves forwards, turning their left arms up and their right legs back."""
    generator = torch.Generator().manual_seed(seed)
    columns = torch.zeros(count, 3, 25, 4)
    columns[:, 0, :24, 0] = 1
    columns[:, 0, :24, 1:] = 0.2 * torch.randn(count, 24, 3, generator=generator)
    columns[:, 1:, :, 1:] = 0.02 * torch.randn(count, 2, 25, 3, generator=generator)
    speed = 0.2 + 0.3 * torch.rand(count, generator=generator)
    columns[:, 1, 24, 2], columns[:, 1, 24, 3] = speed, 0
    columns[:, 1, 24, 0] = 0
    columns[:, 1, 16, 3], columns[:, 1, 2, 1] = speed, speed
    columns[:, 2, 24, 3] = 0
    return columns


def test_corruption_says_what_it_did() -> None:
    clean = made_motions(400, 0)
    batch = corrupt(clean, torch.Generator().manual_seed(1))
    as_told = reversed_columns(batch.clean, batch.backwards)
    intact = ~batch.unrealistic
    torch.testing.assert_close(batch.columns.transpose(1, 2)[intact], as_told.transpose(1, 2)[intact], rtol=0, atol=0)
    differs = (batch.columns - as_told).abs().amax((1, 3))
    assert (differs[batch.unrealistic] > 0).float().mean() > 0.95
    assert 0.005 < batch.unrealistic.float().mean() < 0.1
    assert not batch.unrealistic[:, 0].any()
    whole = batch.whole[~torch.isnan(batch.whole)]
    assert 0.35 < whole.mean() < 0.65
    assert batch.columns[:, :, 24, 3].abs().max() == 0
    again = corrupt(clean, torch.Generator().manual_seed(1))
    torch.testing.assert_close(again.columns, batch.columns, rtol=0, atol=0)


def test_a_fit_errs_and_finds_less_of_the_motion() -> None:
    true = made_motions(2000, 0)
    found = with_errors_of_a_fit(true, torch.Generator().manual_seed(1))
    torch.testing.assert_close(found[:, 0, [0, 24]], true[:, 0, [0, 24]], rtol=0, atol=0)  # what defines the frame
    assert found[:, :, 24, 3].abs().max() == 0
    for column, low, high in ((16, 0.45, 0.65), (24, 0.65, 0.85)):
        of, to = true[:, 1, column], found[:, 1, column]
        share = (to * of).sum(1) / (of * of).sum(1)
        assert low < share.mean() < high
        assert share.std() > 0.2
    bent = (found[:, 2] - true[:, 2]).mean(0)
    assert bent.abs().max() < 0.05  # errors prefer no direction of time


def test_reversals_have_even_odds_and_respect_limbs() -> None:
    backwards, whole = draw_reversals(4000, torch.Generator().manual_seed(0))
    assert torch.allclose(backwards.float().mean(0), torch.tensor(0.5), atol=0.04)
    agree = ~torch.isnan(whole)
    assert (backwards[agree] == backwards[agree, :1]).all()
    limbs = torch.stack([backwards[:, list(m)].float().mean(1) for m in LIMBS.values()], 1)
    unmixed = ((limbs == 0) | (limbs == 1)).all(1)
    assert unmixed.float().mean() > 0.7


def test_training_learns_the_direction_and_the_correction() -> None:
    spec = MotionTraining(epochs=12, batch=64, sizes=SMALL, dropout=0.0)
    losses: list[dict[str, float]] = []
    result = train_motion_prior(made_motions(1200, 0), spec, 0, lambda epoch, epochs, means: losses.append(means))
    assert [list(one) for one in losses] == [list(LOSSES)] * 12
    assert {name: len(values) for name, values in result.history.items()} == dict.fromkeys(LOSSES, 12)
    assert result.history["indicator"][-1] < 0.85 * result.history["indicator"][0]
    unseen = made_motions(300, 1)
    found = measure_motion_prior(result.discriminator, result.corrector, unseen, torch.full((300,), 0.1).numpy(), 0)
    assert found["all"]["whole_body"] > 0.95
    assert found["all"]["torso"] > 0.9
    assert found["all"]["coefficients_corrected"] < found["all"]["coefficients_wrong"]
    assert found["by_exposure"][1]["count"] == 300
    assert found["by_exposure"][0]["whole_body"] is None
    assert not result.discriminator.training


def test_the_seed_decides_everything() -> None:
    spec = MotionTraining(epochs=1, batch=64, sizes=SMALL)
    motions = made_motions(128, 0)
    torch.manual_seed(5)
    before = torch.random.get_rng_state()
    first, second, third = (train_motion_prior(motions, spec, seed) for seed in (3, 3, 4))
    assert torch.equal(torch.random.get_rng_state(), before)
    weights = [one.discriminator.exit.weight for one in (first, second, third)]
    torch.testing.assert_close(weights[0], weights[1], rtol=0, atol=0)
    assert not torch.equal(weights[0], weights[2])


def test_nothing_to_learn_from() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        train_motion_prior(made_motions(1, 0), MotionTraining(epochs=1, sizes=SMALL), 0)
