"""The chains as a server starts them: the deployments of infra/prefect.yaml; their parameters are the form on its page.

Each does what the command of that name does, with the files and folders of the machine that the worker runs on. What
went wrong is the flow run's message; nothing is asked, and nothing is kept in a terminal's words.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from prefect import flow
from pydantic import Field

from hfb.config import RunConfig, preset
from hfb.flows import batch as every_clip
from hfb.flows import fit_image, train_prior
from hfb.flows.benchmark import run_benchmark
from hfb.flows.cli import judging
from hfb.flows.everyone import run_clip
from hfb.flows.runtime import places
from hfb.flows.runtime.failures import explain_failures
from hfb.flows.runtime.reaper import end_abandoned_flow_runs, mark_owner
from hfb.flows.runtime.workspace import check_writable
from hfb.flows.train_prior import TrainingPlan
from hfb.io.clip import BACKGROUND_WORDS
from hfb.io.toml_file import merged, to_record
from hfb.tasks.batch.notifications import addresses_of, enable_notifications
from hfb.tasks.batch.prometheus_metrics import serve_metrics
from hfb.tasks.inputs.video_inputs import take_video_inputs
from hfb.tasks.telemetry.displays import show_progress
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.store_place import check_store, tracking_uri
from hfb.tasks.workers.engine import engine_of

Count = Annotated[int, Field(ge=1)]
Workers = Count | str  # as --workers
Natural = Annotated[int, Field(ge=0)]


class Options(RunConfig):
    """The options of the method, as `hfb fit --help` tells them; of `fit` only what is unlike the preset."""

    fit: dict[str, Any] = Field(  # type: ignore[assignment]  # a form would fill in one preset's values for the other
        {}, description='what is unlike the preset, such as {"subframes": 12}; {"rasterizer": "cuda"} draws on a GPU'
    )

    def config(self) -> RunConfig:
        """The configuration that these options and their preset make together; raises InputError."""
        fit = to_record(RunConfig, {"fit": self.fit}, "options").model_dump(exclude_unset=True)
        return to_record(RunConfig, merged(preset(self.preset).model_dump(), self.model_dump() | fit), "options")


_BEST = Options()


@flow(name="fit", persist_result=False, on_running=[mark_owner])
def fit(
    frames: Annotated[list[Path], Field(min_length=1)],
    background: Path,
    out: Path,
    clip: Path | None = None,
    *,
    options: Options = _BEST,
) -> dict[str, Any]:
    """Blurred pictures of a static camera to a moving body, as `hfb fit`.

    Args:
        frames: blurred pictures, in their order; several are one problem.
        background: the same view without the person.
        out: the folder for the results; made where there is none.
        clip: a clip.toml with camera and exposure of the recording.
        options: options of the method.

    Returns:
        the content of result.json.

    Raises:
        InputError: something given cannot be used; ``out`` is then as it was.
        InfrastructureError: the disk is full, or a server went away; what is finished is kept.
    """
    config = options.config()
    with _on_a_worker(out, config, frames=frames, background=background, clip=clip):
        return fit_image.fit_image.fn(frames, background, out, config, clip=clip)


@flow(name="clip", persist_result=False, on_running=[mark_owner])
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
    """A blurred video of a static camera to one continuous motion, as `hfb video`. Run again, it goes on.

    Args:
        source: a video, a folder of its frames, or a folder with a clip.toml.
        out: the folder for the results; made where there is none.
        background: a picture of the view without the person, or the word median or still.
        clip: camera, exposure, time range and person; else the clip.toml in the folder.
        everyone: each person who is seen, one after the other.
        workers: how many processes compute, or a cluster, such as dask:tcp://host:8786; changes no digit.
        store: with a cluster whose workers do not see this machine's files, where they are shared: s3://bucket/prefix.
        options: options of the method.

    Returns:
        the content of result.json.

    Raises:
        InputError: something given cannot be used; ``out`` is then as it was.
        InfrastructureError: the disk is full, or a server went away; what is finished is kept.
    """
    config = options.config()
    plate = None if background in BACKGROUND_WORDS else background
    with _on_a_worker(out, config, workers, store, source=source, background=plate, clip=clip):
        inputs = take_video_inputs(source, config, clip, background, everyone=everyone, out=out)
        return run_clip(inputs, out, config, engine_of(workers, store))


@flow(name="batch", persist_result=False, on_running=[mark_owner])
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
    """Every clip of a folder, once; failures again later, hopeless ones set aside. As `hfb batch`.

    Args:
        folder: NAME.mp4 with NAME.toml, and folders NAME/ with a clip.toml.
        out: the folder for the results, NAME/ each; summary.html in it tells of all.
        workers: how many processes compute, or a cluster, such as dask:tcp://host:8786; changes no digit.
        store: with a cluster whose workers do not see this machine's files, where they are shared: s3://bucket/prefix.
        attempts: failures after which a clip is set aside.
        wait_s: seconds before a second attempt, doubled for each further.
        again: take clips that were set aside once more.
        options: options of the method.

    Returns:
        how many clips there are and what became of them, and where the page is.

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


@flow(name="methods", persist_result=False, on_running=[mark_owner])
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
    """Methods against cases of known truth: tables, plots, a page. As `hfb benchmark`. Run again, it goes on.

    Args:
        out: the folder for cases, answers and tables; made where there is none.
        set: which set.
        count: how many cases.
        frames: blurred frames per case.
        methods: names as in `hfb benchmark --help`; left empty, what suits the set.
        start: what all methods start from; left empty, what suits the set.
        seed: of everything that is random.
        motions: a folder with AMASS, BVH, DeepMimic, CAPE or hfb's own motion files; left empty, the built-in ones.
        videos: of real and b-aist, folders with videos of a static camera.
        average: of real and b-aist, frames per exposure; left empty, what suits the set.
        body: a SMPL file, for the truth and the fit; left empty, the embedded body.
        fill: how many cases each interval of blur gets.
        chains: a file with deblur-then-estimate chains.
        workers: how many processes compute, or a cluster, such as dask:tcp://host:8786; changes no digit.
        store: with a cluster whose workers do not see this machine's files, where they are shared: s3://bucket/prefix.

    Returns:
        the content of result.json.

    Raises:
        InputError: something given cannot be used, or not one case is left.
    """
    configs = [one.partition("=")[2] for one in methods or () if "=" in one]
    folders = [videos] if isinstance(videos, Path) else videos
    files = {"motions": motions, "videos": folders, "body": body, "methods": configs}
    with _on_a_worker(out, None, workers, store, **files):
        if places.is_limited():
            places.check_programs("chains", chains)
        given = argparse.Namespace(
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
        )
        plan = judging.plan_of(given, frames)
        if places.is_limited():
            for spec in plan.methods:
                places.check_config(spec.config, f"methods: {spec.name}")
        return run_benchmark(plan, out, engine_of(workers, store))


@flow(name="train-prior", persist_result=False, on_running=[mark_owner])
def train(plan: TrainingPlan, out: Path) -> dict[str, Any]:
    """Learn from motion capture how people move, or stand, as `hfb train-prior`. Run again, it goes on.

    Args:
        plan: the recordings, and how to learn from them.
        out: the file for the weights, NAME.safetensors.

    Returns:
        what the prior knows, and where it is.

    Raises:
        InputError: something given cannot be used; ``out`` is then as it was.
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
    """What `hfb.flows.runtime.session` sets up around a command, after a look at where the parameters point.

    A store that does not answer is told before anything is done.
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
