"""What a run of the benchmarks found: the figures of bench.json, and lines for a person."""

import json
from dataclasses import dataclass, field
from pathlib import Path

BARS = {
    "raster_vs_drtk_256": ">= 14",
    "raster_vs_drtk_512": ">= 20",
    "raster_vs_pytorch3d_256": ">= 1000",
    "iteration_vs_floor": "<= 4",
    "fit_seconds_1core": "<= 2.0",
    "two_fits_throughput": ">= 1.9",
    "video_seconds_per_frame": "<= 4",
    "command_seconds": "<= .33 of adb3d25",
    "cold_command_seconds": "<= .4 of adb3d25",
    "clip_worker_mb": "<= 600",
    "help_seconds": "< 1",
    "fit_peak_mb": "<= 1500",
}
"""The keys of bench.json and what each is to reach."""


@dataclass
class Figures:
    """Filled by the benchmarks as they run; a figure that was not measured (no peer installed) stays None."""

    values: dict[str, float | None] = field(default_factory=lambda: dict.fromkeys(BARS))
    lines: list[str] = field(default_factory=list)

    def set(self, key: str, value: float, note: str = "") -> None:
        """A figure of bench.json."""
        if key not in BARS:
            raise KeyError(key)
        self.values[key] = round(value, 4)
        self.say(f"{key} = {value:.4g}   (to reach: {BARS[key]}){'   ' + note if note else ''}")

    def say(self, line: str) -> None:
        """A line of the summary."""
        self.lines.append(line)

    def write(self, path: Path) -> None:
        """bench.json: every key, null where nothing was measured."""
        path.write_text(json.dumps(self.values, indent=1) + "\n")
