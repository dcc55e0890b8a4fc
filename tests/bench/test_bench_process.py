"""What belongs to a process: start-up, compilation, peak memory."""

import subprocess
import sys

import pytest

from hfb.rendering.backends import make_rasterizer
from tests.bench import jobs
from tests.bench.conftest import Scale
from tests.bench.figures import Figures
from tests.bench.rounds import interleaved
from tests.bench.test_bench_raster import ours, there_and_back


def test_help(scale: Scale, figures: Figures) -> None:
    def show() -> None:
        arguments = [sys.executable, "-m", "hfb.flows.cli.cli", "--help"]
        subprocess.run(arguments, env=jobs.environment(), check=True, stdout=subprocess.DEVNULL)

    found = interleaved({"help": show}, min(scale.rounds // 5 + 1, 5))["help"]
    figures.set("help_seconds", found.best, f"median {found.median:.2f}")


@pytest.mark.usefixtures("thorough")
def test_a_second_process_compiles_nothing(figures: Figures) -> None:
    there_and_back(ours(jobs.SIZE_PX, make_rasterizer()), jobs.SIZE_PX)()
    second = jobs.result_of("draw")
    figures.say(
        f"first picture there and back in a second process: {second['seconds']:.2f} s after {second['imports']:.1f} s "
        f"of imports, {second['compiled']} kernels compiled"
    )
    assert second["compiled"] == 0


@pytest.mark.usefixtures("thorough")
def test_peak_memory(scale: Scale, figures: Figures) -> None:
    """Of preset `best` with all its stages; the first iterations of each reach the peak."""
    """Of all that preset `best` does; test_bench_fit has the bare fit's."""
    if not scale.measures:
        pytest.skip("make bench; test_bench_fit has a small one")
    figures.set("fit_peak_mb", jobs.result_of("memory", 3), "whole process, preset best, 256 px")
