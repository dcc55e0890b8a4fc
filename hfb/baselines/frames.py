"""Several frames one by one, and what every method does around its own work."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import torch

from hfb.observation import Observation


def one_by_one(observation: Observation) -> list[Observation]:
    """Each frame as an observation of its own, as if there were no others."""
    return [
        replace(observation, frames_linear=frame[None], mattes=matte[None])
        for frame, matte in zip(observation.frames_linear, observation.mattes, strict=True)
    ]


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """One thread of torch: sums come out the same on every machine and beside any number of other workers."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
