"""A result to look at: in the live viewer, or as a page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from socket import socket

from hfb.body.model import Body
from hfb.flows.report import model_or_none
from hfb.interop.writers.export_names import PLATE, RESULT
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.images.image_io import read_picture_srgb, stored_png
from hfb.motion.motion_file import load_motion
from hfb.report.live_view import LiveView
from hfb.report.pages.result_unknown import alternative_motions
from hfb.report.pages.viewer import ViewedMotion, viewer_page
from hfb.tasks.results.resolve_result import TEXTURE, find_named_body, resolve_result
from hfb.tasks.results.result_report import PAGE_FILES, alternatives_of
from hfb.tasks.results.workspace import beside_result, check_writable
from hfb.typing import Array, Float

VIEW = "view.html"


@dataclass(frozen=True)
class Viewed:
    """What is shown of a result.

    Attributes:
        name: of the result.
        folder: where its page goes.
        motions: as fitted, then the alternatives.
        body: the model; None where it is not available.
        texture_png: the body's texture.
        plate_srgb: the background.
    """

    name: str
    folder: Path
    motions: tuple[ViewedMotion, ...]
    body: Body | None
    texture_png: bytes | None
    plate_srgb: Float[Array, "H W 3"] | None


def load_viewed(source: str, body: Path | None = None) -> Viewed:
    """Read a result, which may be a stranger's.

    Args:
        source: a result's folder, a motion file, or a recorded run's id.
        body: the model that was fitted; None for the one that the result names, or the embedded one.

    Raises:
        InputError: there is no such result, or it is damaged.
    """
    others = PAGE_FILES["alternatives"]
    with resolve_result(source, (TEXTURE, PLATE, RESULT, others)) as place:
        files = place.files
        motion, space = load_motion(place.motion)
        motions = [ViewedMotion("as fitted", motion)]
        if (files / others).exists():
            motions += alternative_motions(motion, alternatives_of(motion, files / others))
        return Viewed(
            place.name,
            place.new_folder("view", place.folder),
            tuple(motions),
            model_or_none(motion, space, body or find_named_body(files / RESULT)),
            stored_png(files / TEXTURE) if (files / TEXTURE).exists() else None,
            read_picture_srgb(files / PLATE) if (files / PLATE).exists() else None,
        )


def write_view(viewed: Viewed, folder: Path) -> Path:
    """Write a page with the viewer; return its path.

    Args:
        viewed: the result.
        folder: where it goes.

    Raises:
        InputError: the folder cannot be written, or a file that hfb did not write is in the way.
    """
    check_writable(folder)
    text = viewer_page(viewed.motions, viewed.body, viewed.texture_png, viewed.name)
    with beside_result(folder, [VIEW]) as target:
        write_bytes_atomic(target / VIEW, text.encode())
    return (folder / VIEW).resolve()


def view_live(viewed: Viewed, listening: socket) -> LiveView:
    """Start the live viewer.

    Args:
        viewed: the result.
        listening: see `LiveView`.
    """
    return LiveView(listening, viewed.motions, viewed.body, viewed.texture_png, viewed.plate_srgb)
