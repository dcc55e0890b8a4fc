"""The `hfb` command line: results go to standard output, everything else to standard error.

Exit codes: 0 success; 1 unexpected error (see the log), or a clip of a batch has no result; 2 unusable input; 3 a
repeated run has a different result; 130 interrupted; 141 standard output was closed. Heavy modules are imported only
once the command is known.
"""

from __future__ import annotations

import argparse
import difflib
import json
import logging
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hfb import __version__
from hfb.errors import InfrastructureError, InputError, ServerLost
from hfb.evaluation.experiment_files import experiment_file
from hfb.flows.cli import app_cli, clips, judging, models_cli, repeating, results, training
from hfb.flows.cli.help_pages import SHELLS, Parser, PrintCompletion
from hfb.flows.cli.options import add_config_flags, run_config
from hfb.flows.runtime import summary
from hfb.flows.runtime.prefect_home import check_home
from hfb.flows.runtime.session import Chain, report, tell, through_prefect, when_ready
from hfb.tasks.telemetry.secrets import without_secrets
from hfb.tasks.workers.engine import engine_of

if TYPE_CHECKING:
    from hfb.evaluation.experiments import Experiment

_DONE, _FAILED, _UNUSABLE, _INTERRUPTED, _NOBODY_READS = 0, 1, 2, 130, 141

_EXAMPLES = {
    "fit": (
        "hfb fit blurred.png --background empty.png --exposure.seconds 0.02",
        "hfb fit blurred.png --background empty.png --clip clip.toml --fit.height-m 1.78 --out runs/jump",
    ),
    "demo": ("hfb demo --out runs/demo",),
    "video": (
        "hfb video jump.mp4 --background empty.png --exposure.seconds 0.02",
        "hfb video jump.mp4 --background median --fit.height-m 1.78 --workers 4 --out runs/jump",
    ),
    "batch": (
        "hfb batch clips --out results --watch 60",
        "hfb batch clips --out results --attempts 2 --notify https://example.org/hook",
    ),
    "synth": ("hfb synth bt-amass --count 10 --out runs/cases", "hfb synth clip --mp4 --frames 12 --out runs/clip"),
    "benchmark": (
        "hfb benchmark bt-amass --count 20 --methods best,static",
        "hfb benchmark real --videos recordings --count 10",
    ),
    "reproduce": ("hfb reproduce table1 --count 10",),
    "export": ("hfb export runs/jump --formats glb,bvh", "hfb export runs/jump --films exact --out runs/films"),
    "report": ("hfb report runs/jump",),
    "view": ("hfb view runs/jump", "hfb view runs/jump --out page"),
}

_told_to_end: list[int] = []  # the exit code of a signal that came
_ENDS_WITHIN_S = 60.0
_ONCE_MORE_S = 0.1
_last_resorts: list[threading.Timer] = []


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code.

    Args:
        arguments: words of the command line; None for those of this process.
    """
    words = sys.argv[1:] if arguments is None else arguments
    as_json = "--json" in words
    signal.signal(signal.SIGTERM, _end_orderly)
    at_interrupt = signal.getsignal(signal.SIGINT)
    if at_interrupt is signal.default_int_handler:  # and not ignored, as in the background of a shell
        signal.signal(signal.SIGINT, _interrupt)
    shown, sys.unraisablehook = sys.unraisablehook, partial(_send_again, sys.unraisablehook)
    try:
        args = _parse(words)
        check_home()
        code = args.run(args) or _DONE
        sys.stdout.flush()
        return code
    except InputError as error:
        return _complain(str(error), as_json, _UNUSABLE)
    except ServerLost as error:
        _complain(str(error), as_json, _FAILED)
        sys.stdout.flush()
        os._exit(_FAILED)  # at a normal exit Prefect would try for minutes to send its server what is left
    except InfrastructureError as error:
        return _complain(str(error), as_json, _FAILED)
    except BrokenPipeError:  # whoever read the results has gone, as `head` goes
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what is left to say is said to nobody
        return _NOBODY_READS
    except KeyboardInterrupt:
        return _complain("interrupted; the same command goes on from here", as_json, _INTERRUPTED)
    except Exception as error:
        if _told_to_end:  # a library that was interrupted may turn the end into a failure of its own
            return _told_to_end[0]
        return _complain(_unexpected(error), as_json, _FAILED)
    finally:
        sys.unraisablehook = shown
        if at_interrupt is signal.default_int_handler:
            signal.signal(signal.SIGINT, at_interrupt)
        while _last_resorts:
            _last_resorts.pop().cancel()


def _parse(words: list[str]) -> argparse.Namespace:
    args, unknown = command_line().parse_known_args(words)
    if unknown:
        flags = re.findall(r"--[a-z][\w.-]*", args.command.format_help_all())
        close = difflib.get_close_matches(unknown[0].partition("=")[0], flags, n=1)
        hint = f"did you mean {close[0]}?" if close else f"see `{args.command.prog} --help`"
        raise InputError(f"unrecognized argument {unknown[0]}; {hint}")
    args.words = words
    return args


def command_line() -> Parser:
    """Return the parser of all commands."""
    parser = Parser("hfb", description="Human from Blur: how a person moved during one exposure.")
    parser.add_argument("--version", action="version", version=f"hfb {__version__}")
    what = f"print what makes a shell complete commands, options and files: {', '.join(SHELLS)}"
    parser.add_argument("--print-completion", action=PrintCompletion, choices=SHELLS, metavar="SHELL", help=what)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=Parser)

    fit = _command(commands, "fit", _fit, "blurred pictures of a static camera -> a moving body")
    fit.add_argument("frames", nargs="+", type=Path, metavar="FRAME", help="blurred picture; several are one problem")
    fit.add_argument("--background", required=True, type=Path, metavar="PLATE", help="the same view without the person")
    fit.add_argument("--clip", type=Path, metavar="clip.toml", help="camera and exposure of the recording")
    add_config_flags(fit)

    demo = _command(commands, "demo", _demo, "the whole chain on an example with known truth")
    add_config_flags(demo)

    video = _command(commands, "video", clips.video, "a blurred video of a static camera -> one continuous motion")
    clips.add_video_flags(video)
    add_config_flags(video)

    batch = _command(commands, "batch", clips.batch, "every clip of a folder; failures again later")
    clips.add_batch_flags(batch)
    add_config_flags(batch)

    of_sets = partial(_command, commands, configured=False)
    synth = of_sets("synth", _synth, "write the cases of a set: pictures, and what happened")
    synth.add_argument("set", choices=(*judging.SETS, "clip"), help="which set; clip: one clip for hfb video")
    synth.add_argument("--mp4", action="store_true", help="clip: a video instead of a folder of its frames")
    synth.add_argument("--frames", type=int, default=1, metavar="T", help="blurred frames per case [1]")
    judging.add_set_flags(synth)

    benchmark = of_sets("benchmark", _benchmark, "methods against cases of known truth: tables and plots")
    benchmark.add_argument("set", choices=judging.SETS, help="which set")
    benchmark.add_argument("--frames", type=int, default=1, metavar="T", help="blurred frames per case [1]")
    judging.add_set_flags(benchmark)
    judging.add_method_flags(benchmark)

    reproduce = of_sets("reproduce", _reproduce, "a table of the paper: ours beside its numbers")
    reproduce.add_argument("experiment", metavar="table1|...|table5", help="a table of the paper")
    judging.add_set_flags(reproduce, count=None)
    judging.add_method_flags(reproduce, of_set=False)

    what = "train a network or another part that hfb ships"
    programs = commands.add_parser("train", help=what, description=what)
    programs.set_defaults(run=_train, command=programs)
    training.add_program_flags(programs)

    what = "learn from your motion capture how people move, or stand"
    training.add_training_flags(of_sets("train-prior", _train_prior, what, out="FILE"))

    of_runs = partial(_command, commands, seeded=True)
    models = of_runs("models", models_cli.models, "networks and files that can be used; get the rest")
    models_cli.add_models_flags(models)

    of_results = partial(of_runs, configured=False)
    repeating.add_rerun_flags(of_results("rerun", repeating.rerun, "repeat a recorded run, and compare"))
    repeating.add_compare_flags(of_results("compare", repeating.compare, "recorded runs beside each other"))
    what = "a result for Blender, AMASS's tools, OpenSim ..."
    results.add_export_flags(of_results("export", results.export, what))
    results.add_report_flags(of_results("report", results.report_result, "a result on one page that opens anywhere"))
    results.add_view_flags(
        of_results("view", results.view_result, "a result in a live 3D viewer (viser), or on a page")
    )
    what = "put a result into MLflow that could not be recorded when made"
    results.add_record_flags(of_results("record", results.record_result, what))

    page = _command(commands, "app", app_cli.app, "a page to drop a picture or a video on, on this machine alone")
    page.add_argument("--port", type=int, default=8512, help="0: any that is free [8512]")
    add_config_flags(page)

    runs = of_runs("runs", models_cli.runs, "show the recorded runs in a browser (MLflow)")
    runs.add_argument("--port", type=int, default=5000, help="[5000]")
    return parser


def _command(
    commands: Any, name: str, run: Any, what: str, *, seeded: bool = False, configured: bool = True, out: str = "DIR"
) -> Parser:
    command: Parser = commands.add_parser(name, help=what, description=what, examples=_EXAMPLES.get(name, ()))
    command.set_defaults(run=run, began=time.perf_counter(), command=command)
    command.add_argument("--out", type=Path, metavar=out, help="where results go [a folder in runs]")
    if configured:
        command.add_argument("--config", type=Path, metavar="FILE.toml", help="options of the method, by section")
    if seeded:  # where the configuration's own --seed is not offered; every command takes one
        command.add_argument("--seed", type=int, help=argparse.SUPPRESS)
    command.add_argument("--json", action="store_true", help="the last line on standard output is one JSON object")
    command.add_argument("--quiet", action="store_true", help="no progress")
    command.add_argument("--verbose", action="store_true", help="Prefect's and MLflow's own messages too")
    return command


def _fit(args: argparse.Namespace) -> None:
    from hfb.tasks.inputs.inputs import assumptions, take_inputs

    config = run_config(args)
    out = args.out or Path("runs") / args.frames[0].stem
    inputs = take_inputs(args.frames, args.background, config, args.clip, out=out)  # what is missing is said at once
    if not args.quiet:
        for assumed in assumptions(inputs, config):
            print(f"hfb: {assumed}", file=sys.stderr)

    def load() -> Chain:
        from hfb.flows.fit_image import fit_image

        return when_ready(lambda: fit_image(args.frames, args.background, out, config, clip=args.clip))

    result = through_prefect(args, out, load)
    report(args, result, summary.FIT_KEYS, summary.FIT_ROWS)


def _demo(args: argparse.Namespace) -> None:
    config = run_config(args)
    out = args.out or Path("runs/demo")

    def load() -> Chain:
        from hfb.flows.fit_image import fit_example

        return lambda ready: fit_example(out, config, ready)

    result = through_prefect(args, out, load)
    report(args, result, summary.DEMO_KEYS, summary.DEMO_ROWS)


def _synth(args: argparse.Namespace) -> None:
    if args.set == "clip":
        clips.synth_clip(args)
        return
    if args.mp4:
        raise InputError("the cases of a set are pictures: leave --mp4 out, or take `hfb synth clip`")
    spec = judging.set_spec(args, args.frames)
    out, engine = args.out or Path("runs") / f"{args.set}-cases", engine_of(args.workers, args.store)

    def load() -> Chain:
        from hfb.flows.benchmark import run_synthesis

        return when_ready(lambda: run_synthesis(spec, args.count, out, engine))

    result = through_prefect(args, out, load)
    tell(args, result, f"{result['count']} cases ({result['skipped']} left out) in {result['out']}")


def _benchmark(args: argparse.Namespace) -> None:
    out = args.out or Path("runs") / args.set
    result = _run_benchmark(args, args.frames, out)
    tell(args, result, judging.benchmark_text(result))


def _reproduce(args: argparse.Namespace) -> None:
    experiment_file(args.experiment)  # a misspelt name is told before anything is loaded
    from hfb.evaluation.experiments import find_experiment

    experiment = find_experiment(args.experiment)
    args.set, args.fill = experiment.set, experiment.fill
    args.count = args.count or experiment.count
    args.methods = args.methods or ",".join(experiment.methods)
    out = args.out or Path("runs") / args.experiment
    result = _run_benchmark(args, experiment.frames, out, experiment)
    tell(args, result, f"{(out / 'beside_paper.md').read_text()}\npage     {result['page']}")


def _run_benchmark(
    args: argparse.Namespace, frames: int, out: Path, experiment: Experiment | None = None
) -> dict[str, Any]:
    judging.methods_of(args)  # what is wrong is said before anything is loaded
    judging.set_spec(args, frames)
    engine = engine_of(args.workers, args.store)

    def load() -> Chain:
        from hfb.flows.benchmark import run_benchmark

        plan = judging.plan_of(args, frames)
        return when_ready(lambda: run_benchmark(plan, out, engine, experiment))

    return through_prefect(args, out, load)


def _train(args: argparse.Namespace) -> None:
    kind, is_prior, _ = args.name.partition("-prior")
    if is_prior:
        prior = _parse(["train-prior", "--kind", kind, *args.options])
        return prior.run(prior)
    return training.run_program(args)


def _train_prior(args: argparse.Namespace) -> None:
    out = args.out or training.DEFAULT_OUT[args.kind]

    def load() -> Chain:
        from hfb.flows.train_prior import train_prior

        plan = training.plan_of(args)
        return when_ready(lambda: train_prior(plan, out))

    result = through_prefect(args, out.parent, load)
    tell(args, result, training.training_text(result))


def _complain(message: str, as_json: bool, code: int) -> int:
    message = without_secrets(" ".join(message.splitlines()))  # one line, whatever a file is called
    print(f"hfb: {message}", file=sys.stderr)
    if as_json:
        print(json.dumps({"error": message}))
    return code


def _unexpected(error: Exception) -> str:
    from hfb.flows.runtime.server import log_path

    logging.getLogger("hfb").exception("unexpected")
    is_kept = any(isinstance(one, logging.FileHandler) for one in logging.getLogger().handlers)
    where = f"the log is {log_path()}" if is_kept else "no log was kept"
    reason = str(error).strip().splitlines()
    return f"unexpected {type(error).__name__}{': ' + reason[0] if reason else ''}; {where}"


def _end_orderly(signum: int, _frame: object) -> NoReturn:
    _told_to_end.append(128 + signum)
    _end_at_last(_told_to_end[0])
    raise SystemExit(_told_to_end[0])


def _interrupt(_signum: int, _frame: object) -> NoReturn:
    _end_at_last(_INTERRUPTED)
    raise KeyboardInterrupt


def _send_again(show: Callable[[sys.UnraisableHookArgs], object], lost: sys.UnraisableHookArgs) -> None:
    """Send a signal once more whose exception Python ignored.

    It ignores what is raised within `__del__`, such as llvmlite's while kernels are loaded: the run went on for ever.
    """
    names = {"KeyboardInterrupt": signal.SIGINT, "SystemExit": signal.SIGTERM, "TerminationSignal": signal.SIGTERM}
    if (number := names.get(lost.exc_type.__name__)) is None:
        show(lost)
    else:  # from another thread: within this hook it would be ignored again
        threading.Timer(_ONCE_MORE_S, os.kill, (os.getpid(), number)).start()


def _end_at_last(code: int) -> None:
    """End the process after a while, whatever it waits for.

    A signal during a library's locking leaves the lock taken; Prefect's clean-up through the same connection would then
    wait forever.
    """

    def end() -> None:
        print("hfb: it was told to end and did not in a minute; the same command goes on from here", file=sys.stderr)
        os._exit(code)

    last_resort = threading.Timer(_ENDS_WITHIN_S, end)
    last_resort.daemon = True
    last_resort.start()
    _last_resorts.append(last_resort)


if __name__ == "__main__":
    sys.exit(main())
