"""The embedded example through the whole chain, judged against its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from flows.fit_image import fit_image
from hfb.config import RunConfig
from hfb.datasets.example import ExamplePaths, write_example
from tasks import progress


def make_example(out: Path, seed: int) -> ExamplePaths:
    """The example's pictures and truth, in ``out/example``."""
    with progress.step("example"):
        return write_example(out / "example", seed)


def fit_example(example: ExamplePaths, out: Path, config: RunConfig) -> dict[str, Any]:
    """The whole chain on the example; the result holds the errors against its truth."""
    return fit_image([example.frame], example.background, out, config, truth=example.truth)
