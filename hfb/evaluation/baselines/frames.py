"""Several frames, one by one."""

from dataclasses import replace

from hfb.rendering.observation import Observation


def one_by_one(observation: Observation) -> list[Observation]:
    """Each frame as an observation of its own, as if there were no others."""
    return [
        replace(observation, frames_linear=frame[None], mattes=matte[None])
        for frame, matte in zip(observation.frames_linear, observation.mattes, strict=True)
    ]
