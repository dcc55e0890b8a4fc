"""Splitting of observations into single frames."""

from dataclasses import replace

from hfb.rendering.observation import Observation


def one_by_one(observation: Observation) -> list[Observation]:
    """Split an observation into one per frame, each without the others.

    Args:
        observation: frames with their mattes, any number.
    """
    return [
        replace(observation, frames_linear=frame[None], mattes=matte[None])
        for frame, matte in zip(observation.frames_linear, observation.mattes, strict=True)
    ]
