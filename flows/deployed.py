"""Flows that a Prefect server starts: the deployments of infra/prefect.yaml; their parameters are the form on its page.

Each does the same as the command of its name, with files and folders of the worker's machine. An error becomes the
flow run's message.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from hfb.config import RunConfig, preset
from hfb.evaluation.baselines.method_spec import program_of
from hfb.flows import batch as every_clip
from hfb.flows import fit_image, train_prior
from hfb.flows.benchmark import run_benchmark
from hfb.flows.cli import judging
from hfb.flows.everyone import run_clip
from hfb.flows.runtime import places
from hfb.flows.runtime.failures import explain_failures
from hfb.flows.runtime.reaper import end_abandoned_flow_runs
from hfb.flows.runtime.recorded_flow import recorded_flow
from hfb.flows.train_prior import TrainingPlan
from hfb.io.clip import BACKGROUND_WORDS
from hfb.io.toml_file import merged, to_record
from hfb.tasks.batch.notifications import addresses_of, enable_notifications
from hfb.tasks.batch.prometheus_metrics import serve_metrics
from hfb.tasks.inputs.video_inputs import take_video_inputs
from hfb.tasks.results.workspace import check_writable
from hfb.tasks.telemetry.displays import show_progress
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.store_place import check_store, tracking_uri
from hfb.tasks.workers.engine import engine_of

Count = Annotated[int, Field(ge=1)]
Workers = Count | str  # as --workers
Natural = Annotated[int, Field(ge=0)]


class Options(RunConfig):
    """The options of the method as in `hfb fit --help`; of `fit` only those that differ from the preset."""

    fit: dict[str, Any] = Field(  # type: ignore[assignment]  # a form would fill in one preset's values for the other
        {}, description='what is unlike the preset, such as {"subframes": 12}; {"rasterizer": "cuda"} draws on a GPU'
    )

    def config(self) -> RunConfig:
        """Return the configuration of the preset with these options; raises InputError."""
        fit = to_record(RunConfig, {"fit": self.fit}, "options").model_dump(exclude_unset=True)
        return to_record(RunConfig, merged(preset(self.preset).model_dump(), self.model_dump() | fit), "options")


_BEST = Options()


@recorded_flow("fit")
def fit(
    frames: Annotated[list[Path], Field(min_length=1)],
    background: Path,
    out: Path,
    clip: Path | None = None,
    *,
    options: Options = _BEST,
) -> dict[str, Any]:
    """Fit blurred images of a static camera to a moving body, as `hfb fit`.

    Args:
        frames: blurred images, in their order; several are one problem.
        background: the same view without the person.
        out: the folder of the results, which need not exist.
        clip: a clip.toml with camera and exposure of the recording.
        options: of the method.

    Returns:
        the content of result.json.

    Raises:
        InputError: an input cannot be used; ``out`` is then as it was.
        InfrastructureError: the disk is full, or a server went away; what is finished is kept.
    """
    config = options.config()
    with _on_a_worker(out, config, frames=frames, background=background, clip=clip):
        return fit_image.fit_image.fn(frames, background, out, config, clip=clip)


@recorded_flow("clip")
def video(
    source: Path,
    out: Path,
    background: str | None = None,
    clip: Path | None = None,
    *,
    everyone: bool = False,
    workers: Workers = 1,
    store: str | None = None,
    options: Options = _BEST,
) -> dict[str, Any]:
    """Fit a blurred video of a static camera to one continuous motion, as `hfb video`. A repeated run continues.

    Args:
        source: a video, a folder of its frames, or a folder with a clip.toml.
        out: the folder of the results, which need not exist.
        background: an image of the view without the person, or the word median or still.
        clip: camera, exposure, time range and person; else the clip.toml in the folder.
        everyone: whether to fit all visible people, one after the other.
        workers: number of processes, or a cluster such as dask:tcp://host:8786; the result does not depend on it.
        store: shared files, such as s3://bucket/prefix, for a cluster that does not share this machine's disk.
        options: of the method.

    Returns:
        the content of result.json.

    Raises:
        InputError: an input cannot be used; ``out`` is then as it was.
        InfrastructureError: the disk is full, or a server went away; what is finished is kept.
    """
    config = options.config()
    plate = None if background in BACKGROUND_WORDS else background
    with _on_a_worker(out, config, workers, store, source=source, background=plate, clip=clip):
        inputs = take_video_inputs(source, config, clip, background, everyone=everyone, out=out)
        return run_clip(inputs, out, config, engine_of(workers, store))


@recorded_flow("batch")
def batch(
    folder: Path,
    out: Path,
    *,
    workers: Workers = 1,
    store: str | None = None,
    attempts: Count = 3,
    wait_s: Annotated[float, Field(gt=0)] = 60.0,
    again: bool = False,
    options: Options = _BEST,
) -> dict[str, Any]:
    """Fit every clip of a folder once; failures are retried, hopeless ones set aside. As `hfb batch`.

    Args:
        folder: NAME.mp4 with NAME.toml, and folders NAME/ with a clip.toml.
        out: the folder of the results, NAME/ each, with summary.html.
        workers: number of processes, or a cluster such as dask:tcp://host:8786; the result does not depend on it.
        store: shared files, such as s3://bucket/prefix, for a cluster that does not share this machine's disk.
        attempts: failures after which a clip is set aside.
        wait_s: seconds before a second attempt, doubled for each further.
        again: whether to retry clips that were set aside.
        options: of the method.

    Returns:
        the number of clips in each state, and the page.

    Raises:
        InputError: the folder cannot be read or ``out`` not be written, or another process works on it.
    """
    config = options.config()
    with _on_a_worker(out, config, workers, store, folder=folder):
        content = config.model_dump(mode="json")
        with enable_notifications(addresses_of(())):  # the worker's own: an address in a form would be recorded
            return every_clip.batch.fn(
                folder, out, content, workers=workers, attempts=attempts, wait_s=wait_s, again=again, store=store
            )


@recorded_flow("methods")
def benchmark(
    out: Path,
    *,
    set: Literal["bt-amass", "bc-cape", "b-aist", "real"] = "bt-amass",
    count: Count = 20,
    frames: Count = 1,
    methods: Annotated[list[str], Field(min_length=1)] | None = None,
    start: Literal["simulated", "estimated"] | None = None,
    seed: Natural = 0,
    motions: Path | None = None,
    videos: Path | list[Path] | None = None,
    average: Count | list[Count] | None = None,
    body: Path | None = None,
    fill: Literal["paper", "even", "natural"] = "paper",
    chains: Path | None = None,
    workers: Workers = 1,
    store: str | None = None,
) -> dict[str, Any]:
    """Compare methods on cases of known truth: tables, plots, a page. As `hfb benchmark`. A repeated run continues.

    Args:
        out: the folder of cases, results and tables, which need not exist.
        set: which set.
        count: number of cases.
        frames: blurred frames per case.
        methods: names as in `hfb benchmark --help`; empty for the set's default.
        start: origin of the static bodies; empty for the set's default.
        seed: of the random numbers.
        motions: a folder with AMASS, BVH, DeepMimic, CAPE or hfb's own motion files; left empty, the built-in ones.
        videos: of real and b-aist, folders with videos of a static camera.
        average: of real and b-aist, frames per exposure; empty for the set's default.
        body: a SMPL file, for the truth and the fit; left empty, the embedded body.
        fill: distribution of the cases over intervals of blur.
        chains: a file with deblur-then-estimate chains.
        workers: number of processes, or a cluster such as dask:tcp://host:8786; the result does not depend on it.
        store: shared files, such as s3://bucket/prefix, for a cluster that does not share this machine's disk.

    Returns:
        the content of result.json.

    Raises:
        InputError: something given cannot be used, or not one case is left.
    """
    entries = [one.strip() for text in methods or () for one in text.split(",")]
    programs = [program for one in entries if (program := program_of(one))]
    configs = [one.partition("=")[2] for one in entries if "=" in one and not program_of(one)]
    folders = [videos] if isinstance(videos, Path) else videos
    files = {"motions": motions, "videos": folders, "body": body, "methods": configs}
    with _on_a_worker(out, None, workers, store, **files):
        if places.is_limited():
            places.check_programs("chains", chains)
            places.check_programs("methods", programs)
        args = argparse.Namespace(
            set=set,
            count=count,
            methods=None if methods is None else ",".join(methods),
            start=start,
            seed=seed,
            motions=motions,
            videos=folders,
            average=average,
            body=body,
            fill=fill,
            chains=chains,
            backgrounds=None,
            textures=None,
            size=None,
            easy=False,
            init=None,
            init_weights=None,
        )
        plan = judging.plan_of(args, frames)
        if places.is_limited():
            for spec in plan.methods:
                places.check_config(spec.config, f"methods: {spec.name}")
        return run_benchmark(plan, out, engine_of(workers, store))


@recorded_flow("train-prior")
def train(plan: TrainingPlan, out: Path) -> dict[str, Any]:
    """Train a prior of motions or poses from motion capture, as `hfb train-prior`. A repeated run continues.

    Args:
        plan: recordings and options of the training.
        out: the file of the weights, NAME.safetensors.

    Returns:
        measurements of the prior, and its files.

    Raises:
        InputError: an input cannot be used; ``out`` is then as it was.
    """
    with _on_a_worker(out.parent, out=out, motions=plan.motions):
        return train_prior.train_prior.fn(plan, out)


@contextmanager
def _on_a_worker(
    folder: Path,
    config: RunConfig | None = None,
    workers: int | str = 1,
    store: str | None = None,
    /,
    **files: Path | str | Sequence[Path | str] | None,
) -> Iterator[None]:
    """Set up what `hfb.flows.runtime.session` sets up around a command, after a check of the parameters' paths.

    A store that does not answer is reported before anything is computed.
    """
    if places.is_limited():
        for name, paths in {"out": folder, **files}.items():
            places.check_files(name, paths)
        places.check_addresses(workers, store)
        if config is not None:
            places.check_config(config)
    check_writable(folder)
    check_store(tracking_uri())
    tracking.open_store()
    with suppress(Exception):  # tidying up after killed runs must not stop this one
        end_abandoned_flow_runs()
    with serve_metrics(), show_progress(), explain_failures(folder):
        yield
