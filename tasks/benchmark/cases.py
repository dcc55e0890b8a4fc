"""The cases of a set: made from motions or from real video, then looked at as a user's pictures would be."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from hfb.config import CameraConfig, ExposureConfig, InitConfig, MattingConfig, Record
from hfb.datasets.case import Case, case_name, load_case
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.set_spec import SetSpec
from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.io.clip import read_clip
from hfb.tasks.core.handles import ClipHandle, FileHandle, digest
from hfb.tasks.core.task import task
from hfb.tasks.image.matte import matte
from hfb.tasks.image.prepare import prepare
from hfb.tasks.inputs.given_networks import check_networks
from hfb.tasks.telemetry import progress
from hfb.tasks.workers.workers import compute, spread

Spec = SetSpec | RealSpec


class SourcesHandle(FileHandle):
    """What a set can be made from.

    Attributes:
        usable: numbers of the motions, or of the stretches of video, that cases are made from.
        refused: name -> reason, for those that cannot be used.
    """

    usable: tuple[int, ...]
    refused: dict[str, str]


class CaseHandle(Record):
    """The files of one case."""

    number: int
    files: tuple[FileHandle, ...]

    def open(self) -> Case:
        """The case where its files lie now: in one folder, or one by one, as they come out of a shared store."""
        folder = self.files[0].path.parent
        if any(file.path.parent != folder for file in self.files):
            folder = folder.parent / f"case-{digest(self)[:40]}"
            folder.mkdir(exist_ok=True)
            for file in self.files:
                with suppress(FileExistsError):
                    (folder / file.path.name).hardlink_to(file.path)
        return load_case(folder)


class ReadyHandle(Record):
    """A case as every method sees it: the pictures, estimated mattes, and the static bodies all start from.

    Attributes:
        initial: scores of the starts held still (a JSON file).
    """

    case: CaseHandle
    clip: ClipHandle
    mattes: tuple[FileHandle, ...]
    starts: tuple[FileHandle, ...]
    initial: FileHandle


@task("motions")
def find_sources(spec: Spec, listing: str, folder: Path) -> SourcesHandle:
    """Open everything once: what is damaged is known, and named, before a case is drawn.

    Args:
        listing: what lies in the folders that the set is made from (`listing_of`); with other files this is done again.

    Raises:
        InputError: nothing can be used; the sentence gives the first reasons.
    """
    if isinstance(spec, RealSpec):
        from hfb.datasets.real.windows import real_windows

        windows, refused = real_windows(spec)
        usable: Sequence[int] = range(len(windows))
    else:
        from hfb.datasets.motions.sources import open_motions
        from hfb.datasets.motions.sources import usable as usable_of

        usable, refused = usable_of(open_motions(spec.motions, spec.seed), progress.advance)
    if not usable:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in list(refused.items())[:3])
        raise InputError(f"no case can be made from what was given ({reasons})")
    path = folder / "sources.json"
    write_bytes_atomic(path, json.dumps({"usable": list(usable), "refused": refused, "listing": listing}).encode())
    return SourcesHandle.of(path, usable=tuple(usable), refused=refused)


@task("case")
def make_case(
    spec: Spec, number: int, sources: SourcesHandle, networks: tuple[FileHandle, ...], folder: Path
) -> CaseHandle:
    """Make one case in ``folder/case_0001``.

    Args:
        networks: the pose networks at hand, where they make the truth of real video: with other ones it is made again.

    Raises:
        InputError: this case cannot be made.
    """
    return compute(_make, spec, number, sources.usable, folder / case_name(number))


@task("mattes and starts")
def see_case(
    case: CaseHandle,
    start: Literal["simulated", "estimated"],
    matting: MattingConfig,
    init: InitConfig,
    networks: tuple[FileHandle, ...],
    body: FileHandle | None,
    folder: Path,
) -> ReadyHandle:
    """Estimate the mattes, and the static bodies unless the simulated ones are asked for.

    Raises:
        InputError: nothing differs from the background, or no person is found.
    """
    return spread(_see, case, start, matting, init, networks, body, folder / case_name(case.number))


def set_name(spec: Spec) -> str:
    """The set, as on the command line."""
    return "b-aist" if isinstance(spec, RealSpec) else spec.set


def listing_of(*folders: Path | None) -> str:
    """What lies in some folders, by name, size and time of change: hashing a large library would take minutes."""
    lines: list[str] = []
    for folder in folders:
        if folder is not None:
            files = sorted(path for path in folder.rglob("*") if path.is_file())
            lines += [f"{path.relative_to(folder)} {_stamp(path)}" for path in files]
    return "\n".join(lines)


def _stamp(path: Path) -> str:
    facts = path.stat()
    return f"{facts.st_size} {facts.st_mtime_ns}"


def _make(spec: Spec, number: int, usable: Sequence[int], folder: Path) -> CaseHandle:
    if isinstance(spec, RealSpec):
        from hfb.datasets.real.real_case import make_numbered_real_case

        make_numbered_real_case(spec, number, folder)
    else:
        from hfb.datasets.synthesis import make_case as make

        make(spec, number, usable, folder)
    files = sorted(path for path in folder.iterdir() if path.is_file())
    return CaseHandle(number=number, files=tuple(FileHandle.of(path) for path in files))


def _see(
    handle: CaseHandle,
    start: Literal["simulated", "estimated"],
    matting: MattingConfig,
    init: InitConfig,
    networks: tuple[FileHandle, ...],
    body: FileHandle | None,
    folder: Path,
) -> ReadyHandle:
    from hfb.datasets.truth import load_truth_of
    from hfb.evaluation.judge import judge_start
    from hfb.motion.static_pose import load_first_body
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    if start == "estimated":
        check_networks(init, networks)
    case = handle.open()
    # What a user has, and no more: pictures, plate, clip.toml.
    clip = prepare.fn(
        tuple(FileHandle.of(path) for path in case.frame_paths()),
        FileHandle.of(case.background),
        read_clip(case.clip),
        CameraConfig(),
        ExposureConfig(),
    )
    folder.mkdir(parents=True, exist_ok=True)
    mattes = tuple(matte.fn(clip, index, matting, folder) for index in range(case.frames))
    starts = _starts(case, start, clip, mattes, init, body, folder)
    scores = judge_start(
        [load_first_body(one.path) for one in starts], load_observation(clip, mattes), load_truth_of(case.truth),
        load_chosen_body(body),
    )  # fmt: skip
    path = folder / "initial.json"
    write_bytes_atomic(path, json.dumps(scores, allow_nan=False).encode())
    return ReadyHandle(case=handle, clip=clip, mattes=mattes, starts=starts, initial=FileHandle.of(path))


def _starts(
    case: Case, start: str, clip: ClipHandle, mattes: tuple[FileHandle, ...], init: InitConfig,
    body: FileHandle | None, folder: Path,
) -> tuple[FileHandle, ...]:  # fmt: skip
    if start == "simulated":
        missing = [path.name for path in case.start_paths() if not path.exists()]
        if missing:
            raise InputError(f"{case.folder} has no {missing[0]}: real video is started with --start estimated")
        return tuple(FileHandle.of(path) for path in case.start_paths())
    from hfb.tasks.image.first_body import first_body
    from hfb.tasks.video.video_windows import mend_fronts

    numbers = tuple(range(case.frames))
    found: Any = tuple(first_body.fn(clip, index, mattes, body, init, (), folder) for index in numbers)
    if len(found) > 1:
        found = mend_fronts.fn(numbers, found, folder).firsts
    return tuple(FileHandle(path=one.path, sha256=one.sha256) for one in found)
