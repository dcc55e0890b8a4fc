"""Duration of a training, its learning rate, and the running average of its weights."""

import math
import sys
import time

import torch
from torch import nn


def tell(text: str) -> None:
    """Print a line of progress to standard error.

    Args:
        text: one line.
    """
    print(text, file=sys.stderr, flush=True)


class Schedule:
    """The end of a training by iterations or by time, whichever comes first."""

    def __init__(self, iterations: int, minutes: float) -> None:
        """Start the clock.

        Args:
            iterations: at most.
            minutes: at most.
        """
        self._iterations, self._minutes, self._began = iterations, minutes, time.monotonic()

    @property
    def minutes(self) -> float:
        """Minutes since the start."""
        return (time.monotonic() - self._began) / 60

    def share(self, iteration: int) -> float:
        """Return the completed share of the training, at most 1.

        Args:
            iteration: completed iterations.
        """
        return min(1.0, max(iteration / self._iterations, self.minutes / self._minutes))


def cosine(share: float, floor: float = 0.0) -> float:
    """Return a factor that falls from 1 to ``floor`` along half a cosine.

    Args:
        share: completed share of the training, in [0, 1].
        floor: final value.
    """
    return floor + (1 - floor) * (1 + math.cos(math.pi * share)) / 2


@torch.no_grad()
def update_average(average: nn.Module, network: nn.Module, keep: float) -> None:
    """Move averaged weights towards the network's; counts are copied.

    Args:
        average: changed in place.
        network: of the same layers.
        keep: share of the average that stays.
    """
    for mean, new in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
        if mean.is_floating_point():
            mean.lerp_(new, 1 - keep)
        else:
            mean.copy_(new)


class Counter:
    """Progress output: a line at every ``every``-th sample."""

    def __init__(self, noun: str, every: int) -> None:
        """Start the clock.

        Args:
            noun: what is counted, in plural.
            every: samples per line.
        """
        self._noun, self._every, self._began = noun, every, time.monotonic()

    def reached(self, number: int) -> bool:
        """Print progress at every ``every``-th sample; returns whether it did.

        Args:
            number: samples so far.
        """
        if number % self._every:
            return False
        tell(f"{number} {self._noun} in {time.monotonic() - self._began:.0f} s")
        return True
