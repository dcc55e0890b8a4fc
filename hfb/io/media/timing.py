"""Exposure times by clip.toml and options, on the time stamps of the footage."""

from dataclasses import dataclass

from hfb.config import ExposureConfig
from hfb.errors import InputError
from hfb.io.clip import ClipExposure
from hfb.io.media.footage import Footage
from hfb.typing import Array, Float


@dataclass(frozen=True, eq=False)
class Timing:
    """The clock of a clip.

    Attributes:
        exposure_s: length of each exposure.
        interval_s: nominal, from one opening to the next.
        openings_s: opening of the shutter for every frame, since the first one; true also where the rate varies.
        first_opening_s: on the footage's own clock.
        source: source of the exposure time, one sentence.
    """

    exposure_s: float
    interval_s: float
    openings_s: Float[Array, "T"]
    first_opening_s: float
    source: str


_POSITION = {"start": 0.0, "middle": 0.5, "end": 1.0}


def settle_timing(footage: Footage, exposure: ClipExposure, config: ExposureConfig) -> Timing:
    """Determine when the shutter was open.

    Options have priority over clip.toml, then come the footage's metadata, then a guess. Frames keep their own time
    stamps. Where these are irregular, exposure fractions are of the nominal interval, and a window is fitted as if its
    frames had that interval.

    Args:
        footage: the clip's footage.
        exposure: entries of clip.toml.
        config: options.

    Raises:
        InputError: the exposure is longer than the interval between frames.
    """
    interval_s = footage.interval_s
    exposure_s, source = _exposure(footage, exposure, config)
    if exposure_s > interval_s * 1.001 + footage.tick_s:  # a clock of milliseconds makes 60 per second 60.2
        raise InputError(
            f"an exposure of {exposure_s:g} s does not fit into the {interval_s:g} s between frames: "
            "give the true fps or exposure time"
        )
    exposure_s = min(exposure_s, interval_s)
    late_s = _POSITION[exposure.position] * (interval_s - exposure_s)
    return Timing(
        exposure_s, interval_s, footage.times_s - footage.times_s[0], float(footage.times_s[0] + late_s), source
    )


def _exposure(footage: Footage, exposure: ClipExposure, config: ExposureConfig) -> tuple[float, str]:
    """Return the exposure [s] and its source."""
    interval_s = footage.interval_s
    if footage.average > 1:
        return interval_s, f"exposure: the whole interval, as the mean of {footage.average} frames"
    if config.seconds is not None:
        return config.seconds, "exposure: from the options"
    told = exposure.exposure_s(interval_s)
    if told is not None:
        return told, "exposure: from clip.toml"
    recorded = footage.recorded_exposure
    if recorded is not None:
        return recorded[0], f"exposure: {recorded[0]:.6g} s, from {recorded[1]}"
    asked = " (asked for as auto, but the footage does not tell it)" if exposure.auto else ""
    return interval_s, f"exposure: assumed to be the whole interval of {interval_s:.6g} s{asked}"
