"""The commands on a finished result: `hfb export`, `hfb report`, `hfb record`. Light to import."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from contextlib import closing, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast, get_args

from hfb.config import CameraConfig, ExportConfig, Film, MeshFormat, MotionFormat
from hfb.errors import InputError, install_advice
from hfb.flows.cli.app_cli import HOST, listen
from hfb.flows.cli.options import placeholder
from hfb.flows.runtime.session import libraries, open_session, output_folder_of, results_alone_on_stdout, tell
from hfb.io.toml_file import to_record

_MESHES: tuple[MeshFormat, ...] = get_args(MeshFormat)
_FILMS: tuple[Film, ...] = get_args(Film)
_ALL = (*get_args(MotionFormat), *_MESHES, "mot")
_PLACE = ("tilt_deg", "roll_deg", "world_up", "floor")
_RATE, _FPS = ExportConfig().amass_rate, ExportConfig().fps


def add_export_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb export`.

    Args:
        parser: of the command.
    """
    shown = ",".join(ExportConfig().formats)
    add = parser.add_argument
    add("source", metavar="RESULT", help="a result's folder, a motion.npz, or the id of a recorded run")
    add(
        "--formats",
        metavar="NAME,...",
        help=f"of {', '.join(_ALL)}; obj and ply are a mesh per sub-frame, mot OpenSim's [{shown}]",
    )
    add("--amass-rate", type=int, choices=(30, 60, 120), help=f"poses per second in amass.npz [{_RATE}]")
    add("--csv-frame", choices=("camera", "world"), default="camera", help="coordinates in joints.csv [camera]")
    described = ExportConfig.model_fields["fps"].description
    add("--fps", metavar="X", default=_FPS, help=f"{described} [{_FPS:g}]")
    add("--clip", type=Path, metavar="clip.toml", help="the camera's place in the world, as rotation and translation")
    for name in _PLACE:
        field = CameraConfig.model_fields[name]
        flag = name.replace("_", "-")
        add(f"--{flag}", f"--camera.{flag}", dest=name, metavar=placeholder(name, field), help=field.description)
    add("--films", metavar="NAME,...", help=f"of {', '.join(_FILMS)}: drawn again from the result and its pictures")
    add("--inputs", type=Path, metavar="DIR", help="where the pictures lie, for films, if they were moved")
    add("--body", type=Path, metavar="FILE", help="the SMPL file that was fitted [the one the result names]")


def export(args: argparse.Namespace) -> None:
    """Run `hfb export`.

    Args:
        args: the parsed options.
    """
    films = parse_films(args.films)
    formats, meshes, opensim = parse_formats(args.formats) if args.formats or not films else ((), (), False)
    given = {name: getattr(args, name) for name in _PLACE if getattr(args, name) is not None}
    camera = to_record(CameraConfig, given, "options")
    with open_session(args, args.out or output_folder_of(args.source), recorded=False):
        with libraries():
            from hfb.flows.export import export_result
        rate = args.amass_rate or _RATE
        result = export_result(
            args.source,
            args.out,
            formats,
            meshes,
            body=args.body,
            amass_rate=rate,
            films=films,
            inputs=args.inputs,
            csv_frame=args.csv_frame,
            fps=to_record(ExportConfig, {"fps": args.fps}, "options").fps,
            camera=camera,
            clip=args.clip,
            opensim=opensim,
        )
    tell(args, result, export_text(result))


def parse_formats(words: str | None) -> tuple[tuple[MotionFormat, ...], tuple[MeshFormat, ...], bool]:
    """Parse a list of formats into (motion files, meshes, whether OpenSim's files).

    Args:
        words: comma-separated names; None for the defaults.

    Raises:
        InputError: a name is none of them, or there is none.
    """
    if words is None:
        return ExportConfig().formats, (), False
    names = _known(words, _ALL, "format")
    motion = tuple(cast(MotionFormat, name) for name in names if name not in (*_MESHES, "mot"))
    return motion, tuple(name for name in names if name in _MESHES), "mot" in names


def parse_films(words: str | None) -> tuple[Film, ...]:
    """Parse a list of films, each once. Raises InputError for an unknown name.

    Args:
        words: comma-separated names; None for no films.
    """
    return () if words is None else tuple(cast(Film, name) for name in _known(words, _FILMS, "film"))


def _known(words: str, names: Sequence[str], what: str) -> tuple[str, ...]:
    """Parse comma-separated names, each once.

    Raises:
        InputError: one of them is unknown, or there is none.
    """
    found = tuple(dict.fromkeys(word.strip() for word in words.split(",") if word.strip()))
    unknown = [name for name in found if name not in names]
    if unknown or not found:
        raise InputError(f"{(unknown or [words])[0]!r} is no {what}: take some of {', '.join(names)}")
    return found


def export_text(result: Mapping[str, Any]) -> str:
    """Return the lines printed at the end of `hfb export`.

    Args:
        result: as `hfb.flows.export.export_result` returns it.
    """
    lines = ["", *(f"{name:<22}{size / 1e6:8.2f} MB" for name, size in result["files"].items())]
    if result["meshes"]:
        lines.append(f"{'meshes/':<22}{result['meshes']:8} files")
    return "\n".join([*lines, "", f"result   {result['out']}"])


def add_report_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb report`.

    Args:
        parser: of the command.
    """
    add = parser.add_argument
    add("source", metavar="RESULT", help="a result's folder, or the id of a recorded run")
    add("--inputs", type=Path, metavar="DIR", help="where the pictures lie, for the film, if they were moved")
    add("--body", type=Path, metavar="FILE", help="the SMPL file that was fitted [the one the result names]")


def report_result(args: argparse.Namespace) -> None:
    """Run `hfb report`.

    Args:
        args: the parsed options.
    """
    with open_session(args, args.out or output_folder_of(args.source), recorded=False):
        with libraries():
            from hfb.flows.report import make_report
        result = make_report(args.source, args.out, args.body, args.inputs)
    tell(args, result, report_text(result))


def report_text(result: Mapping[str, Any]) -> str:
    """Return the line printed at the end of `hfb report`.

    Args:
        result: as `hfb.flows.report.make_report` returns it.
    """
    size = f"{result['bytes'] / 1e6:.1f} MB"
    lacks = [f"without {name}" for name in ("film", "surface") if not result[name]]
    return f"report   {result['report']}  ({', '.join([size, *lacks])})"


def add_view_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb view`.

    Args:
        parser: of the command.
    """
    add = parser.add_argument
    add("source", metavar="RESULT", help="a result's folder, a motion.npz, or the id of a recorded run")
    add("--port", type=int, default=8513, help="of the live viewer; 0: any that is free [8513]")
    add("--body", type=Path, metavar="FILE", help="the SMPL file that was fitted [the one the result names]")


def view_result(args: argparse.Namespace) -> None:
    """Run `hfb view`: serve the live viewer on this machine alone until Ctrl-C, or write a page where viser is missing.

    Args:
        args: the parsed options.
    """
    from hfb.flows.view_result import load_viewed, view_live, write_view

    if find_spec("viser") is None or args.out is not None:
        viewed = load_viewed(args.source, args.body)
        path = write_view(viewed, args.out or viewed.folder)
        advice = "" if args.out else f"\n(live, with the plate, where viser is installed: {install_advice('view')})"
        tell(args, {"page": str(path)}, f"page     {path}{advice}")
        return
    with listen(args.port) as listening:
        with results_alone_on_stdout():
            view = view_live(load_viewed(args.source, args.body), listening)
        url = f"http://{HOST}:{listening.getsockname()[1]}"
        print(json.dumps({"url": url}) if args.json else f"{url}  (Ctrl-C ends it)", flush=True)
        with results_alone_on_stdout(), closing(view), suppress(KeyboardInterrupt):
            view.run()


def add_record_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hfb record`.

    Args:
        parser: of the command.
    """
    parser.add_argument("source", type=Path, metavar="RESULT", help="the folder of a finished result")


def record_result(args: argparse.Namespace) -> None:
    """Run `hfb record`.

    Args:
        args: the parsed options.
    """
    with open_session(args, args.source):
        with libraries():
            from hfb.flows.record import record_folder
            from hfb.tasks.tracking import tracking

            tracking.open_store()
        result = record_folder(args.source)
    tell(args, result, record_text(result))


def record_text(result: Mapping[str, Any]) -> str:
    """Return the lines printed at the end of `hfb record`.

    Args:
        result: as `hfb.flows.record.record_folder` returns it.
    """
    return "\n".join(
        f"{'recorded' if one['new'] else 'recorded already'}  {one['out']}\nMLflow    {one['mlflow_link']}"
        for one in result["runs"]
    )
