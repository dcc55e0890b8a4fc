"""A clip's run in MLflow: one run, frames as steps, one point per frame and metric even after a kill.

It is written while the clip is processed, so that progress is visible. If the store fails on the way, the clip goes on;
everything is tried once more at the end, and failing that the same command or `hfb record` completes the record later.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hfb.config import RunConfig
from hfb.interop.writers.export_names import RESULT
from hfb.tasks.core.environment import code_version
from hfb.tasks.core.handles import FileHandle, digest
from hfb.tasks.inputs.video_inputs import VideoInputs, video_hashes
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.recipe import COMMAND_TAG, RECIPE, recipe
from hfb.tasks.tracking.run_record import RecordedFile, RunHandle, RunRecord, describe_run, keep_for_later

_SHOWN = 120  # characters of MLflow's own account, which goes on for lines
_AT_ONCE = 16  # points that are worth a transaction of their own


class ClipRecord:
    """The record of one clip."""

    def __init__(self, name: str, inputs: VideoInputs, config: RunConfig) -> None:
        """Open the run; where the store fails, everything is kept for later.

        Args:
            name: of the run.
            inputs: of the run.
            config: all options.
        """
        self._name, self._inputs, self._config = name, inputs, config
        self._run: tracking.Run | None = None
        self._points: dict[str, dict[int, float]] = {}
        self._there: dict[str, set[int]] = {}
        self._waiting = 0
        self._reached = True
        self._unwatch: Callable[[], None] = lambda: None
        self._try(self._open)

    def frames(self, metric: str, values: Mapping[int, float]) -> None:
        """Log values of some frames; they are kept until the end in case the store fails.

        Args:
            metric: its name.
            values: frame -> value.
        """
        self._points.setdefault(metric, {}).update(values)
        self._waiting += len(values)
        if self._reached and self._waiting >= _AT_ONCE:
            self._try(lambda: self._log(self._points))

    def finish(self, files: Mapping[str, FileHandle], result: Mapping[str, Any]) -> RunHandle | None:
        """Log everything still missing, and set FINISHED; None where the store does not accept it: see `keep`.

        Args:
            files: of the result, by name.
            result: content of result.json.
        """
        self._reached = True
        self._unwatch()
        self._try(lambda: self._finish(files, result))
        if not self._reached or self._run is None:
            return None
        return RunHandle(run_id=self._run.run_id, link=tracking.link(self._run))

    def keep(self, files: Mapping[str, FileHandle], result: Mapping[str, Any], folder: Path) -> FileHandle:
        """Write everything into a file, from which `hfb record` records the clip later.

        Args:
            files: of the result, by name.
            result: content of result.json.
            folder: where the file goes.
        """
        progress.say(f"not recorded in MLflow: `hfb record {result['out']}` records it when MLflow is back")
        kept = clip_record(self._inputs, self._config, points=self._points, files=files, result=result)
        return keep_for_later(kept, folder)

    def stop(self, status: str) -> None:
        """Set FAILED or KILLED for an unfinished clip; the same command continues in the same run.

        Args:
            status: one of these.
        """
        self._unwatch()
        run = self._run
        if run is not None and self._reached:
            self._try(lambda: tracking.end_run(run, status))

    def _open(self) -> None:
        params, key, tags = _identity(self._inputs, self._config)
        self._run = tracking.begin_run(self._name, key, params, tags)
        self._unwatch = tracking.watch_machine(self._run)

    def _log(self, points: Mapping[str, Mapping[int, float]]) -> None:
        """Log points that the run lacks: an earlier start of the same command may have logged some."""
        run = self._run
        if run is None or run.complete:
            return
        for metric in points.keys() - self._there.keys():
            self._there[metric] = tracking.read_logged_steps(run, metric)
        new = {
            metric: {step: value for step, value in values.items() if step not in self._there[metric]}
            for metric, values in points.items()
        }
        tracking.log_points(run, new)
        for metric, values in new.items():
            self._there[metric] |= values.keys()
        self._waiting = 0

    def _finish(self, files: Mapping[str, FileHandle], result: Mapping[str, Any]) -> None:
        if self._run is None:
            self._open()
        run = self._run
        assert run is not None
        if run.complete:
            return
        whole = clip_record(self._inputs, self._config, points=self._points, files=files, result=result)
        self._log(whole.points)
        with tracking.store_losses():
            tracking.log_files(run, [file.path for _, file in sorted(files.items())])
            tracking.log_inputs(run, whole.inputs())
            tracking.describe(run, whole.description)
            for name, content in whole.contents.items():
                tracking.log_dict(run, content, name)
        tracking.end_run(run, "FINISHED")

    def _try(self, action: Any) -> None:
        try:
            action()
        except tracking.StoreLost as lost:
            if self._reached:
                progress.say(
                    f"MLflow does not take the record ({str(lost)[:_SHOWN]}): the clip goes on; once MLflow is back, "
                    "the same command completes the record"
                )
            self._reached = False


def clip_record(
    inputs: VideoInputs,
    config: RunConfig,
    *,
    points: Mapping[str, Mapping[int, float]],
    files: Mapping[str, FileHandle],
    result: Mapping[str, Any],
    lacks: tuple[str, ...] = (),
) -> RunRecord:
    """Return the whole record of a clip, identified by its inputs, its options and the code.

    Args:
        inputs: of the run.
        config: all options.
        points: figure -> values by frame.
        files: of the result, by name.
        result: content of result.json.
        lacks: see `hfb.tasks.tracking.recipe.Recipe`.
    """
    own = result.get("own_parts")  # functions have no hash: what they lead to tells runs apart
    apart = {"own_parts": own, "motion": files["motion.npz"].sha256} if own else {}
    params, key, tags = _identity(inputs, config, apart)
    made_of = recipe("video", config, inputs, files, code=code_version(), lacks=lacks)
    options = config.model_dump(mode="json")
    return RunRecord(
        name=Path(result["out"]).name,
        key=key,
        params=params,
        tags=tags,
        points={**points, **_final(result)},
        files={name: RecordedFile(sha256=file.sha256) for name, file in files.items()},
        description=describe_run("video", config, result),
        contents={RESULT: dict(result), "config.json": options, RECIPE: made_of.model_dump(mode="json")},
    )


def _identity(
    inputs: VideoInputs, config: RunConfig, apart: Mapping[str, Any] = MappingProxyType({})
) -> tuple[dict[str, Any], str, dict[str, str]]:
    """Return parameters, key and tags of a clip's run, with what else tells it apart from others."""
    params = {
        **config.model_dump(mode="json"),
        "input": video_hashes(inputs),
        "clip": inputs.clip.model_dump(mode="json"),
        **apart,
    }
    tags = {"code": code_version(), "seed": str(config.seed), "preset": config.preset, COMMAND_TAG: "video"}
    return params, digest(["video", params, code_version()]), tags


def _final(result: Mapping[str, Any]) -> dict[str, dict[int, float]]:
    final = {f"clip/{name}": {0: float(value)} for name, value in result.items() if isinstance(value, float)}
    return final | {f"warning/{one['code']}": {0: float(one["value"])} for one in result["warnings"]}
