"""The motion in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

from hfb.config import ExportConfig, Record
from hfb.errors import InputError
from hfb.interop.writers.names import FILE_NAMES, NEEDS_BODY
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.core.task import task
from hfb.tasks.telemetry import progress
from hfb.tasks.workers.workers import compute

if TYPE_CHECKING:
    from hfb.body.model import BetasSpace


class ExportsHandle(Record):
    """Files for other programs and for people, each under the name that it is published by.

    Attributes:
        left_out: why a format has no file, one sentence each.
    """

    files: tuple[FileHandle, ...]
    left_out: tuple[str, ...] = ()

    def by_name(self) -> dict[str, FileHandle]:
        return {file.path.name: file for file in self.files}


@task("motion files")
def export_files(
    motion: FileHandle, texture: FileHandle | None, body: FileHandle | None, config: ExportConfig, folder: Path
) -> ExportsHandle:
    """Write the asked-for formats (`hfb.interop.writers`); one that cannot hold the motion is left out, and told.

    Args:
        texture: the person's texture as a picture. body: the user's body model; None for the embedded one.
    """
    written: ExportsHandle = compute(_export_files, motion, texture, body, config, folder)
    for reason in written.left_out:
        progress.say(f"hfb: {reason}")
    return written


def _export_files(
    motion: FileHandle, texture: FileHandle | None, body: FileHandle | None, config: ExportConfig, folder: Path
) -> ExportsHandle:
    from hfb.interop.writers.files import Exported, write_motion_file
    from hfb.motion.motion_file import load_motion
    from hfb.tasks.core.scene import load_chosen_body

    moving, space = load_motion(motion.path)
    exported = Exported(
        moving,
        cast("BetasSpace", space),
        load_chosen_body(body) if set(config.formats) & set(NEEDS_BODY) else None,
        texture.path.read_bytes() if texture else None,
        config.amass_rate,
    )
    files, left_out = [], []
    for form in dict.fromkeys(config.formats):
        try:
            files.append(FileHandle.of(write_motion_file(folder, form, exported)))
        except InputError as error:  # the motion is found: a format that cannot hold it does not keep it back
            left_out.append(f"there is no {FILE_NAMES[form]}: {error}")
    return ExportsHandle(files=tuple(files), left_out=tuple(left_out))
