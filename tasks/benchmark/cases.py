"""The cases of a set: made from motions or from real video, then processed like a user's images."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

from hfb.config import CameraConfig, ExposureConfig, InitConfig, MattingConfig, Record
from hfb.datasets.case import Case, case_name, load_case
from hfb.datasets.real.real_spec import RealSpec
from hfb.datasets.set_spec import SetSpec
from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.io.clip import read_clip
from hfb.tasks.core.handles import Call, ClipHandle, FileHandle, digest
from hfb.tasks.image.matte import matte
from hfb.tasks.image.prepare import prepare
from hfb.tasks.inputs.given_networks import check_networks, shade_networks
from hfb.tasks.task import task, without_prefect
from hfb.tasks.telemetry import progress

Spec = SetSpec | RealSpec


class SourcesHandle(FileHandle):
    """Motions or videos that a set can be made from.

    Attributes:
        usable: numbers of the motions, or of the sections of video, that cases are made from.
        refused: name -> reason, for those that cannot be used.
    """

    usable: tuple[int, ...]
    refused: dict[str, str]


class CaseHandle(Record):
    """The files of one case."""

    number: int
    files: tuple[FileHandle, ...]

    def open(self) -> Case:
        """Return the case from its files' current places: in one folder, or one by one, as from a shared store."""
        folder = self.files[0].path.parent
        if any(file.path.parent != folder for file in self.files):
            folder = folder.parent / f"case-{digest(self)[:40]}"
            folder.mkdir(exist_ok=True)
            for file in self.files:
                with suppress(FileExistsError):
                    (folder / file.path.name).hardlink_to(file.path)
        return load_case(folder)


class ReadyHandle(Record):
    """Input of every method for a case: frames, estimated mattes, and the static bodies all start from.

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
    """Open every source once, so that damaged ones are known and named before a case is drawn.

    Args:
        spec: the set.
        listing: files in the folders that the set is made from (`listing_of`); a change repeats the search.
        folder: where the list goes.

    Raises:
        InputError: no source can be used; the sentence gives the first reasons.
    """
    if isinstance(spec, RealSpec):
        from hfb.datasets.real.case_windows import real_windows

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


class MakeCall(Call):
    """A case to make.

    Attributes:
        spec: the set.
        number: of the case.
        sources: usable motions or videos.
        networks: the pose networks that make the truth of real video; a change makes the case again.
        folder: of all cases; the case goes to ``case_0001`` and so on in it.
    """

    spec: Spec
    number: int
    sources: SourcesHandle
    networks: tuple[FileHandle, ...]
    folder: Path


class SeeCall(Call):
    """A case to process.

    Attributes:
        case: its files.
        start: origin of the static bodies.
        matting: options of the mattes.
        init: options of the static bodies.
        networks: the installed pose networks.
        body: the user's body model; None for the embedded one.
        folder: of all cases.
    """

    case: CaseHandle
    start: Literal["simulated", "estimated"]
    matting: MattingConfig
    init: InitConfig
    networks: tuple[FileHandle, ...]
    body: FileHandle | None
    folder: Path


@task("case", where="worker")
def make_case(call: MakeCall) -> CaseHandle:
    """Make one case.

    Args:
        call: the case.

    Raises:
        InputError: this case cannot be made.
    """
    spec, number, folder = call.spec, call.number, call.folder / case_name(call.number)
    if isinstance(spec, RealSpec):
        from hfb.datasets.real.real_case import make_numbered_real_case

        make_numbered_real_case(spec, number, folder)
    else:
        from hfb.datasets.synthetic.synthesis import make_case as make

        make(spec, number, call.sources.usable, folder)
    files = sorted(path for path in folder.iterdir() if path.is_file())
    return CaseHandle(number=number, files=tuple(FileHandle.of(path) for path in files))


@task("mattes and starts", where="cluster")
def see_case(call: SeeCall) -> ReadyHandle:
    """Estimate the mattes, and the static bodies unless they are simulated.

    Args:
        call: the case.

    Raises:
        InputError: nothing differs from the background, or no person is found.
    """
    from hfb.datasets.truth import load_truth_of
    from hfb.evaluation.judge import judge_start
    from hfb.motion.static_pose import load_first_body
    from hfb.tasks.core.scene import load_chosen_body, load_observation

    if call.start == "estimated":
        check_networks(call.init, call.networks)
    case, folder = call.case.open(), call.folder / case_name(call.case.number)
    # What a user has, and no more: pictures, plate, clip.toml.
    clip = prepare.fn(
        frames=tuple(FileHandle.of(path) for path in case.frame_paths()),
        background=FileHandle.of(case.background),
        clip=read_clip(case.clip),
        camera=CameraConfig(),
        exposure=ExposureConfig(),
    )
    folder.mkdir(parents=True, exist_ok=True)
    mattes = tuple(
        matte.fn(
            clip=clip,
            index=index,
            config=call.matting,
            landmarks=call.init.landmarks,
            pose_networks=shade_networks(call.init, call.networks),
            # as of `hfb fit`; methods that do not refine it lose nothing
            quick=call.start == "simulated" or bool(shade_networks(call.init, call.networks)),
            folder=folder,
        )
        for index in range(case.frames)
    )
    starts = _starts(call, case, clip, mattes, folder=folder)
    scores = judge_start(
        [load_first_body(one.path) for one in starts],
        load_observation(clip, mattes),
        load_truth_of(case.truth),
        load_chosen_body(call.body),
    )
    path = folder / "initial.json"
    write_bytes_atomic(path, json.dumps(scores, allow_nan=False).encode())
    return ReadyHandle(case=call.case, clip=clip, mattes=mattes, starts=starts, initial=FileHandle.of(path))


def _starts(
    call: SeeCall, case: Case, clip: ClipHandle, mattes: tuple[FileHandle, ...], *, folder: Path
) -> tuple[FileHandle, ...]:
    if call.start == "simulated":
        missing = [path.name for path in case.start_paths() if not path.exists()]
        if missing:
            raise InputError(f"{case.folder} has no {missing[0]}: real video is started with --start estimated")
        return tuple(FileHandle.of(path) for path in case.start_paths())
    from hfb.tasks.chains.image_chain import estimate_bodies

    with without_prefect():
        found = estimate_bodies(clip, mattes, body=call.body, config=call.init, networks=call.networks, folder=folder)
    return tuple(FileHandle(path=one.path, sha256=one.sha256) for one in found)
