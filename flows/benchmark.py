"""Run methods on cases with known truth: make the set, run everything from the same starts, and tabulate."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Literal, TypeVar

from prefect.task_runners import ThreadPoolTaskRunner

from hfb.config import InitConfig, MattingConfig, Record
from hfb.datasets.case import case_name
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.set_spec import listing_of
from hfb.errors import InputError
from hfb.evaluation.baselines.method_spec import MethodSpec
from hfb.evaluation.experiments import Experiment
from hfb.flows.runtime.recorded_flow import recorded_flow
from hfb.interop.writers.export_names import REPORT
from hfb.io.safe_folder import check_tree
from hfb.tasks.benchmark.benchmark_report import BESIDE, BESIDE_PLOT, draw_benchmark_page, write_beside
from hfb.tasks.benchmark.benchmark_results import gallery, record_benchmark, tabulate
from hfb.tasks.benchmark.cases import (
    CaseHandle,
    MakeCall,
    SeeCall,
    SourcesHandle,
    Spec,
    find_sources,
    make_case,
    see_case,
)
from hfb.tasks.benchmark.judge_case import JudgeCall, judge_case
from hfb.tasks.core.result_records import records_in
from hfb.tasks.inputs.inputs import input_file, networks_at_hand, pose_networks
from hfb.tasks.inputs.out_place import check_sources_out
from hfb.tasks.map_task import Outcome, map_task
from hfb.tasks.results.workspace import mark_unfinished, publish, workspace
from hfb.tasks.telemetry import progress
from hfb.tasks.tracking import tracking
from hfb.tasks.workers.engine import Engine
from hfb.tasks.workers.workers import worker_count, workers

R = TypeVar("R")


class BenchmarkPlan(Record):
    """Everything that decides a benchmark's figures; the number of workers does not."""

    spec: Spec
    count: int
    methods: tuple[MethodSpec, ...]
    start: Literal["simulated", "estimated"]
    matting: MattingConfig = MattingConfig()
    init: InitConfig = InitConfig()
    body: Path | None = None


def run_benchmark(
    plan: BenchmarkPlan, out: Path, engine: Engine | int, experiment: Experiment | None = None
) -> dict[str, Any]:
    """Run methods on a set of cases; see `_benchmark`. The engine does not change the result.

    Cases are drawn on this machine; estimates and methods run on the engine.

    Args:
        plan: set, methods and starts.
        out: where the results go.
        engine: where computations run.
        experiment: the paper's table to compare with.
    """
    with workers(engine):
        return recorded_flow("benchmark", task_runner=_threads())(_benchmark)(plan, out, experiment)


def run_synthesis(spec: Spec, count: int, out: Path, engine: Engine | int) -> dict[str, Any]:
    """Write the cases of a set; see `_synthesis`.

    Args:
        spec: the set.
        count: number of cases.
        out: where they go.
        engine: where computations run.
    """
    with workers(engine):
        return recorded_flow("synthesis", task_runner=_threads())(_synthesis)(spec, count, out)


def _threads() -> Any:  # Prefect's own types do not take its own runner
    """Return a runner of one thread per worker: a task waits while its worker computes."""
    return ThreadPoolTaskRunner(max_workers=worker_count())


def _synthesis(spec: Spec, count: int, out: Path) -> dict[str, Any]:
    """Write the cases of a set, ``out/case_0001`` and so on.

    Returns:
        the content of result.json.

    Raises:
        InputError: not one case could be made.
    """
    with workspace(out) as folder, records_in(folder):
        for number in range(1, count + 1):
            check_tree(out, case_name(number))
        sources, cases, skipped = _made(spec, count, folder, cases_folder=out, out=out)
        result = {
            "set": spec.set,
            "count": len(cases),
            "skipped": len(skipped),
            "skipped_reasons": skipped,
            "seed": spec.seed,
            "out": str(out.resolve()),
            "sources": len(sources.usable),
        }
        publish(out, {}, result)
    return result


def _benchmark(plan: BenchmarkPlan, out: Path, experiment: Experiment | None = None) -> dict[str, Any]:
    """Make cases, estimate mattes and starts, run methods, tabulate; recorded in MLflow, published in ``out``.

    A case that cannot be made or has no visible person is left out for every method, and named in the summary.

    Args:
        plan: set, methods and starts.
        out: where the results go.
        experiment: the paper's table to compare with.

    Returns:
        the content of result.json: the summary, and where things are.

    Raises:
        InputError: something given cannot be used, or not one case is left.
    """
    spec, began_ms = plan.spec, time.time_ns() // 1_000_000
    with workspace(out) as folder, records_in(folder):
        for inner in ("cases", "methods"):
            check_tree(out, inner)
        body = input_file(plan.body) if plan.body else None
        networks = pose_networks(plan.init) if plan.start == "estimated" else ()
        _, cases, skipped = _made(spec, plan.count, folder, cases_folder=out / "cases", out=out)
        to_see = [
            SeeCall(
                case=case,
                start=plan.start,
                matting=plan.matting,
                init=plan.init,
                networks=networks,
                body=body,
                folder=folder,
            )
            for case in cases
        ]
        seen = map_task(see_case, to_see, "mattes and starts")
        ready = _successes(seen, [f"case {case.number}" for case in cases], skipped)
        to_judge = [
            JudgeCall(ready=one, method=method, body=body, folder=out / "methods")
            for one in ready
            for method in plan.methods
        ]
        judged = map_task(judge_case, to_judge, "methods")
        rows = tuple(
            _successes(judged, [f"case {one.ready.case.number}, {one.method.name}" for one in to_judge], skipped)
        )
        names = tuple(method.name for method in plan.methods)
        results = tabulate(
            judged=rows,
            set_name=spec.set,
            frames=spec.frames,
            methods=names,
            count=len(ready),
            seed=spec.seed,
            skipped=skipped,
            notes=_notes(plan),
            folder=folder,
        )
        looks = gallery(rows, names, folder)
        beside = write_beside(experiment, results, folder) if experiment is not None else None
        page = draw_benchmark_page(
            judged=rows,
            results=results,
            gallery=looks,
            beside=beside,
            params=_params(plan),
            methods=_options(plan),
            folder=folder,
        )
        files = {
            **results.files(),
            "gallery.png": looks.path,
            REPORT: page.path,
            **({BESIDE: beside.path} if beside is not None else {}),
            **({BESIDE_PLOT: beside.plot.path} if beside is not None and beside.plot is not None else {}),
        }
        places = {"out": str(out.resolve()), "page": str(out.resolve() / REPORT)}
        result = {**results.content(), **places, "mlflow_run_id": None, "mlflow_link": None}
        try:
            run = record_benchmark(
                name=spec.set,
                params=_params(plan),
                methods=_options(plan),
                results=results,
                files=tuple(files.values()),
                began_ms=began_ms,
            )
            result |= {"mlflow_run_id": run.run_id, "mlflow_link": run.link}
        except tracking.StoreLost as lost:
            progress.say(f"not recorded in MLflow, the result itself is complete: {lost}")
        publish(out, files, result)
    return result


def _made(
    spec: Spec, count: int, folder: Path, *, cases_folder: Path, out: Path
) -> tuple[SourcesHandle, list[CaseHandle], dict[str, str]]:
    """Return the cases that could be made, and why others could not."""
    folders = spec.videos if isinstance(spec, RealSpec) else (spec.motions, spec.backgrounds, spec.textures)
    check_sources_out(folders, out)
    for place in folders:
        if place is not None and not place.is_dir():
            raise InputError(f"{place} is no folder")
    sources = find_sources(spec, listing_of(*folders), folder)
    for name, reason in sources.refused.items():
        progress.say(f"left out: {name}: {reason}")
    mark_unfinished(out)  # of an earlier result some cases would be the old ones, some the new ones
    skipped = dict(sources.refused)
    numbers = range(1, count + 1)
    networks = networks_at_hand() if isinstance(spec, RealSpec) and spec.estimator != "matte" else ()
    calls = [
        MakeCall(spec=spec, number=number, sources=sources, networks=networks, folder=cases_folder)
        for number in numbers
    ]
    made = map_task(make_case, calls, "cases")
    return sources, _successes(made, [f"case {number}" for number in numbers], skipped), skipped


def _successes(outcomes: list[Outcome[R]], names: list[str], skipped: dict[str, str]) -> list[R]:
    """Return the results, with failures moved to ``skipped``; raises the first failure where no result is left."""
    for name, outcome in zip(names, outcomes, strict=True):
        if outcome.error is not None:
            skipped[name] = str(outcome.error) or type(outcome.error).__name__
            progress.say(f"left out: {name}: {skipped[name]}")
    results = [outcome.result for outcome in outcomes if outcome.result is not None]
    if not results and outcomes:
        raise next(outcome.error for outcome in outcomes if outcome.error is not None)
    return results


def _notes(plan: BenchmarkPlan) -> tuple[str, ...]:
    """Return notes below the table."""
    start = "simulated after the paper's METRO" if plan.start == "simulated" else f"estimated ({plan.init.method})"
    notes = [f"starts: {start}", f"mattes: {plan.matting.method}"]
    if isinstance(plan.spec, RealSpec):
        compared = (
            "measured truth is compared at hips, knees, ankles, shoulders, elbows and wrists; its hips and shoulders "
            "lie 20 to 50 mm from SMPL's (case.json: truth, truth_joints, truth_offset_mm)"
        )
        averages = ", ".join(map(str, plan.spec.average))
        return (*notes, f"every picture is the mean of K = {averages} frames in linear light", compared)
    motions = plan.spec.motions.name if plan.spec.motions else "procedural"
    notes += [f"motions: {motions}", f"fill: {plan.spec.fill}"]
    if plan.spec.easy:
        notes.append("EASY: the truth is drawn with the fit's own mesh and without noise; not to be quoted")
    return tuple(notes)


def _params(plan: BenchmarkPlan) -> dict[str, Any]:
    return plan.model_dump(mode="json", exclude={"methods"})


def _options(plan: BenchmarkPlan) -> dict[str, Any]:
    return {method.name: method.model_dump(mode="json") for method in plan.methods}
