"""Fit a blurred video, or a folder of its frames, to one continuous motion."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from prefect.task_runners import ThreadPoolTaskRunner

from hfb.config import RunConfig
from hfb.flows.runtime.failures import ServerWatch, ask_server, explain_failures
from hfb.flows.runtime.recorded_flow import recorded_flow
from hfb.interop.writers.export_names import RECORD, REPORT
from hfb.tasks.chains.clip_chain import fit_clip
from hfb.tasks.core.result_records import records_in
from hfb.tasks.inputs.inputs import with_height
from hfb.tasks.inputs.video_inputs import VideoInputs
from hfb.tasks.results.exports import export_motion
from hfb.tasks.results.result_report import ReportParts, add_report, film_beside, write_report
from hfb.tasks.results.workspace import publish, workspace
from hfb.tasks.tracking.video_record import ClipRecord
from hfb.tasks.workers.engine import Engine
from hfb.tasks.workers.workers import busy_share, worker_count, workers

_SPARE_THREADS = 2  # tasks that are being checked and looked up while all workers compute


def run_video(inputs: VideoInputs, out: Path, config: RunConfig, engine: Engine | int) -> dict[str, Any]:
    """Fit a clip to one motion for all its frames; recorded in MLflow, published in ``out``.

    One task per frame for its matte and its first body, one per window for its fit. Finished steps are cached in
    ``out``: the same call continues from them, also after a kill. The engine does not change the result.

    Args:
        inputs: of the run.
        out: where the results go.
        config: all options.
        engine: where computations run.

    Returns:
        the content of result.json.

    Raises:
        InputError: an input cannot be used; ``out`` is then as it was.
        InfrastructureError: the disk is full, or Prefect's server went away; what is finished is kept.
    """
    config = with_height(config, inputs.clip)

    # A closure: as parameters Prefect would send a folder's pictures to its server, which takes half a megabyte.
    def video(clip: str, out_folder: str) -> dict[str, Any]:
        return _motion_of(inputs, out, folder, config)

    with clip_place(out, engine) as folder:
        threads: Any = ThreadPoolTaskRunner(max_workers=worker_count() + _SPARE_THREADS)
        made = recorded_flow("video", task_runner=threads)(video)
        return made(str(inputs.video[0].path), str(out))


def _motion_of(inputs: VideoInputs, out: Path, folder: Path, config: RunConfig) -> dict[str, Any]:
    began = time.perf_counter()
    record = ClipRecord(out.resolve().name, inputs, config)
    try:
        fit = fit_clip(inputs, config, folder, look=ServerWatch().look, on_values=record.frames)
        with film_beside(fit.shot, config.export, folder) as page_film:
            exports = export_motion(fit.shot, fit.texture, config.export, folder)
        files = fit.files() | exports.by_name()
        result = fit.facts() | {
            **exports.facts(),
            "seconds": round(time.perf_counter() - began, 3),
            "workers_busy": busy_share(),
            "out": str(out.resolve()),
            "strip": str(out.resolve() / "strip.png"),
            "report": str(out.resolve() / REPORT) if config.export.report else None,
        }
        ask_server()  # a run that cannot end must not be recorded as finished
        place = record.finish(files, result)
        if place is None:
            files[RECORD] = record.keep(files, result, folder)
        else:
            result |= {"mlflow_run_id": place.run_id, "mlflow_link": place.link}
        if config.export.report:
            parts = ReportParts.among(files, page_film.result(), inputs.body)
            files[REPORT] = write_report(parts, result, folder)
            add_report(result["mlflow_run_id"], files[REPORT])
        publish(out, {name: file.path for name, file in files.items()}, result)
        return result
    except Exception:
        record.stop("FAILED")
        raise
    except BaseException:  # Ctrl-C, SIGTERM
        record.stop("KILLED")
        raise


@contextmanager
def clip_place(out: Path, engine: Engine | int) -> Iterator[Path]:
    """Provide the folder of intermediate files inside the block, locked for this process, and the engine's workers.

    Args:
        out: where the results go.
        engine: where computations run.

    Raises:
        InputError: see `hfb.tasks.results.workspace.workspace` and `hfb.tasks.workers.workers.workers`.
        InfrastructureError: see `hfb.flows.runtime.failures.explain_failures`.
    """
    with explain_failures(out), workspace(out) as folder, workers(engine, apart=True), records_in(folder):
        yield folder
