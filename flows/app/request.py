"""What a visitor of the page asks for, checked: files by role and size, options, and the command that they become.

No path or name from the browser names a file: stored names are made here, of a file's name only a known ending counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import Field

from hfb.config import Record
from hfb.errors import InputError
from hfb.io.clip import read_clip
from hfb.io.media.footage_names import PICTURE_SUFFIXES
from hfb.io.names import shown_name
from hfb.io.run_options import check_options
from hfb.io.toml_file import to_record
from hfb.tasks.inputs.out_place import CLIP_FILE, VIDEOS

MOST_BYTES = 2 << 30
MOST_PICTURES = 16
MOST_PIXELS = 40_000_000
_CLIP_BYTES = 1 << 16
_LONGEST_NAME = 300

OPTIONS = (
    "preset",
    "seed",
    "fit.height_m",
    "camera.focal_px",
    "camera.tilt_deg",
    "exposure.seconds",
    "video.average",
)
"""Options that the page offers; none of them names a file."""

INPUTS, RESULTS = "input", "result"
"""Folders of a job."""


class UploadedFile(Record):
    """One file of an upload.

    Attributes:
        name: as the visitor's machine calls it; shown, never opened.
    """

    role: Literal["recording", "plate", "clip"]
    name: Annotated[str, Field(min_length=1, max_length=_LONGEST_NAME)]
    size: Annotated[int, Field(ge=0, le=1 << 53)]

    @property
    def suffix(self) -> str:
        """The ending of its name, in small letters."""
        return PurePosixPath(self.name).suffix.lower()


class JobRequest(Record):
    """A fit that somebody asks for.

    Attributes:
        files: in the order in which their bytes follow.
        background: of a video without a plate: what clip.toml says, else the median; or the longest still stretch.
        options: by their dotted names.
    """

    files: tuple[UploadedFile, ...]
    background: Literal["auto", "still"] = "auto"
    options: dict[str, str | int | float] = Field(default_factory=dict)

    @property
    def is_video(self) -> bool:
        """Whether the recording is a video."""
        return any(one.role == "recording" and one.suffix in VIDEOS for one in self.files)

    @property
    def title(self) -> str:
        """The recording's name, as text."""
        names = [shown_name(one.name) for one in self.files if one.role == "recording"]
        return names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "")

    def stored_names(self) -> tuple[str, ...]:
        """Return the name under which each file is stored."""
        names, frames = [], 0
        for one in self.files:
            if one.role == "clip":
                names.append(CLIP_FILE)
            elif one.role == "plate":
                names.append(f"background{one.suffix}")
            else:
                names.append(f"clip{one.suffix}" if self.is_video else f"frame_{frames}{one.suffix}")
                frames += 1
        return tuple(names)

    def words(self, folder: Path) -> list[str]:
        """Return the words of the command.

        Args:
            folder: the job's.
        """
        named: dict[str, list[str]] = {"recording": [], "plate": [], "clip": []}
        for one, name in zip(self.files, self.stored_names(), strict=True):
            named[one.role].append(str(folder / INPUTS / name))
        plate = named["plate"] or ([self.background] if self.background != "auto" else [])
        words = ["video" if self.is_video else "fit", *named["recording"]]
        words += [f"--background={one}" for one in plate] + [f"--clip={one}" for one in named["clip"]]
        words += [f"--{name.replace('_', '-')}={value}" for name, value in self.options.items()]
        return [*words, f"--out={folder / RESULTS}", "--json"]


def check_request(content: Any) -> JobRequest:
    """Check what a browser, or a record of an earlier job, asks for.

    Args:
        content: of the JSON.

    Raises:
        InputError: it cannot be done; the sentence is for the page.
    """
    if not isinstance(content, dict):
        raise InputError("the request holds no files: load the page again")
    request = to_record(JobRequest, content, "the request")
    recording = [one for one in request.files if one.role == "recording"]
    if not recording:
        raise InputError("no picture and no video was given: drop a blurred picture or a video")
    for one in request.files:
        known = {"recording": PICTURE_SUFFIXES | VIDEOS, "plate": PICTURE_SUFFIXES, "clip": {".toml"}}[one.role]
        if one.suffix not in known:
            raise InputError(f"{shown_name(one.name)} is {_kinds(one.role)}")
        if one.size == 0:
            raise InputError(f"{shown_name(one.name)} is empty: give another file")
        if one.role == "clip" and one.size > _CLIP_BYTES:
            raise InputError(f"{shown_name(one.name)} is too large for a clip.toml: give another file")
    if sum(one.size for one in request.files) > MOST_BYTES:
        raise InputError(f"the files are larger than {MOST_BYTES >> 30} GB together: cut the video, or use `hfb video`")
    if len(recording) > (1 if request.is_video else MOST_PICTURES):
        raise InputError(f"{len(recording)} recordings were given: give one video, or at most {MOST_PICTURES} pictures")
    for role, what in (("plate", "pictures of the empty scene"), ("clip", "clip.toml")):
        if (count := sum(one.role == role for one in request.files)) > 1:
            raise InputError(f"{count} {what} were given: give one")
    if not request.is_video and not any(one.role == "plate" for one in request.files):
        raise InputError("a picture of the empty scene is missing: the same view without the person")
    return request.model_copy(update={"options": _checked_options(request.options)})


def check_clip_file(folder: Path) -> None:
    """Check a job's clip.toml, if any: it stands alone, and means one person.

    Args:
        folder: of the job's inputs.

    Raises:
        InputError: it cannot be used here.
    """
    if not (folder / CLIP_FILE).exists():
        return
    try:
        clip = read_clip(folder / CLIP_FILE)
    except InputError as error:
        raise InputError(str(error).replace(f"{folder}/", "")) from None
    named = [("camera.calibration", clip.camera.calibration), ("person.track", clip.person.track)]
    if name := next((name for name, path in named if path is not None), None):
        raise InputError(f"{CLIP_FILE}: {name} names another file, which the page does not take: use the command line")
    if clip.person.which == "everyone":
        raise InputError(f"{CLIP_FILE}: everyone is meant, and the page shows one person: use `hfb video --everyone`")


def _checked_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options as the command takes them. Raises InputError for one that is unknown or impossible."""
    checked: dict[str, Any] = {}
    for name, value in given.items():
        if name not in OPTIONS:
            raise InputError(f"{name[:80]!r} is no option of the page: use the command line")
        section, _, key = name.rpartition(".")
        found = check_options({section: {key: value}} if section else {key: value}, "options")
        checked[name] = found[section][key] if section else found[key]
    return checked


def _kinds(role: str) -> str:
    if role == "clip":
        return "no clip.toml: give a file whose name ends in .toml"
    pictures = ", ".join(sorted(one[1:] for one in PICTURE_SUFFIXES))
    if role == "plate":
        return f"no picture that can be read ({pictures}): give a picture of the empty scene"
    return f"neither a picture ({pictures}) nor a video (mp4, mov, mkv ...): convert it, or give another file"
