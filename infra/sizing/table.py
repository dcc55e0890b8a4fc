"""How much of everything a million hours of video take: one table, computed from what was measured.

    python infra/sizing/table.py [--hours 1e6] [--fps 30] [--days 365] [--minutes 10] [--set NAME=NUMBER ...]

measured.toml says how each number was measured. Prints Markdown; infra/sizing/README.md holds it as it comes.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

MEASURED = Path(__file__).with_name("measured.toml")
_DAY_S, _GB, _TB, _PB = 86_400, 1e9, 1e12, 1e15


@dataclass(frozen=True)
class Task:
    """What is to be done.

    Attributes:
        hours: of video; fps: of it [Hz]; days: until all is done; minutes: of one clip.
    """

    hours: float = 1e6
    fps: float = 30.0
    days: float = 365.0
    minutes: float = 10.0


@dataclass(frozen=True)
class Row:
    """One line of the table: what, how much of it, and how that follows."""

    what: str
    amount: str
    how: str


def load(path: Path = MEASURED) -> dict[str, float]:
    """The measured numbers by name."""
    return {name: float(one["value"]) for name, one in tomllib.loads(path.read_text()).items()}


def rows(task: Task, m: Mapping[str, float]) -> list[Row]:
    """The table; names in its formulas are those of measured.toml."""
    frames = task.hours * 3600 * task.fps
    rate = frames / (task.days * _DAY_S)
    clips = task.hours * 60 / task.minutes
    cores = rate * m["core_s"] / m["busy"]
    commands = rate / per_command(m)
    runs, points = rate * m["task_runs"], rate * m["points"]
    return [
        Row("frames", f"{frames:.3g}", "hours x 3600 x fps"),
        Row("frames a second", f"{rate:,.0f}", "frames / (days x 86,400)"),
        Row("clips (MLflow runs)", f"{clips:,.0f}", "hours x 60 / minutes of a clip"),
        Row("cores that compute", f"{cores:,.0f}", "frames a second x core_s / busy; a GPU: not measured"),
        Row("their memory", f"{cores * m['worker_gb'] / 1000:,.1f} TB", "cores x worker_gb"),
        Row("commands at a time", f"{commands:,.0f}", "frames a second x command_s (each is one core of Python)"),
        Row("their memory", f"{commands * m['command_gb'] / 1000:,.2f} TB", "commands x command_gb"),
        Row("Prefect: task runs a second", f"{runs:,.0f}", "frames a second x task_runs"),
        Row("Prefect: cores of its servers", f"{rate * m['server_s']:,.1f}", "frames a second x server_s"),
        Row("Prefect: cores of its databases", f"{rate * m['database_s']:,.1f}", "frames a second x database_s"),
        Row("Prefect: written a day", f"{rate * _DAY_S * m['prefect_bytes'] / _TB:,.2f} TB", "x prefect_bytes"),
        Row("Prefect: if nothing is deleted", f"{frames * m['prefect_bytes'] / _TB:,.0f} TB", "frames x prefect_bytes"),
        Row("MLflow: points", f"{frames * m['points']:.2g}", "frames x points"),
        Row("MLflow: points a second", f"{points:,.0f}", f"one client writes {m['points_per_s']:,.0f} a second"),
        Row("MLflow: database", f"{frames * m['points'] * m['point_bytes'] / _TB:,.0f} TB", "points x point_bytes"),
        Row("results", f"{frames * m['result_bytes'] / _PB:,.2f} PB", "frames x result_bytes"),
        Row("while a clip is worked on", f"{task.minutes * 60 * task.fps * m['work_bytes'] / _GB:,.1f} GB",
            "frames of a clip x work_bytes; intermediate/ may go when it is done"),
        Row("intermediate files, if all are kept", f"{frames * m['work_bytes'] / _PB:,.1f} PB", "frames x work_bytes"),
        Row("network to and from the store", f"{8 * rate * m['store_bytes'] / _GB:,.0f} Gbit/s",
            "frames a second x store_bytes x 8"),
    ]  # fmt: skip


def per_command(m: Mapping[str, float]) -> float:
    """Frames a second at which the process of one command is busy all the time."""
    return 1 / m["command_s"]


def limits(m: Mapping[str, float]) -> list[tuple[float, str, str]]:
    """(cores that compute, what bears no more, what then), the first to break first."""

    def cores(frames_per_s: float) -> float:
        return frames_per_s * m["core_s"] / m["busy"]

    found = [
        (cores(per_command(m)), "the process of one `hfb video`: its Python is busy all the time",
         "more clips at a time, each its own command: nothing is shared between clips"),
        (cores(1 / m["server_s"]), "the process of one Prefect server",
         "several behind the proxy (compose.ha.yaml), then a server and a database per so many cores"),
        (cores(m["points_per_s"] / m["points"]), "points that one client writes into MLflow's database",
         "every command is a client of its own: the database's disk is the next limit"),
        (cores(1 / m["database_s"]), "one core of Prefect's PostgreSQL", "more cores: it uses them"),
    ]  # fmt: skip
    return sorted(found)


def markdown(task: Task, m: Mapping[str, float]) -> str:
    """Both tables."""
    lines = ["| | | how |", "|---|---|---|"]
    lines += [f"| {row.what} | {row.amount} | {row.how} |" for row in rows(task, m)]
    lines += ["", "| breaks at | what | then |", "|---|---|---|"]
    lines += [f"| {cores:,.0f} cores | {what} | {then} |" for cores, what, then in limits(m)]
    return "\n".join(lines)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in vars(Task()).items():
        parser.add_argument(f"--{name}", type=float, default=default)
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=NUMBER", help="instead of what was measured"
    )
    given = parser.parse_args()
    measured = load()
    for one in given.set:
        name, _, number = one.partition("=")
        if name not in measured:
            parser.error(f"--set {name}: there are {', '.join(measured)}")
        measured[name] = float(number)
    print(markdown(Task(given.hours, given.fps, given.days, given.minutes), measured))


if __name__ == "__main__":
    main()
