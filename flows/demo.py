"""The embedded example through the whole chain, judged against its truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hfb.config import RunConfig
from hfb.datasets.example import write_example
from hfb.flows.fit_image import fit_image
from hfb.io.safe_folder import check_tree
from hfb.tasks.telemetry import progress

_EXAMPLE = "example"


def fit_example(out: Path, config: RunConfig, ready: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Make the example in ``out/example``, then fit it; the result holds the errors against its truth.

    Args:
        ready: called before the flow, returns when Prefect's server answers.

    The first body is found from the matte alone, whether or not the pose networks are there: the same figures for
    everyone, and the networks were never shown a drawn body.
    """
    if config.init.method == "auto":
        config = config.model_copy(update={"init": config.init.model_copy(update={"method": "matte"})})
    check_tree(out, _EXAMPLE)
    with progress.step("example"):
        paths = write_example(out / _EXAMPLE, config.seed)
    ready()
    return fit_image([paths.frame], paths.background, out, config, truth=paths.truth)
