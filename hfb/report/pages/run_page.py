"""Recorded runs beside each other as one HTML file that needs nothing else: where they differ, what each found, and the
same instant of all of them under one slider.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from hfb.report.pages.page import page

RUN_CLASSES = ("one", "two", "three", "four")


@dataclass(frozen=True)
class PageTable:
    """A table of some runs.

    Attributes:
        rows: name, a value per run, and where they are numbers what else is to be said, such as a difference.
        empty: what to say when there are no rows.
    """

    title: str
    rows: tuple[tuple[str, ...], ...]
    empty: str = "nothing"


@dataclass(frozen=True)
class RunLook:
    """What there is to see of a run.

    Attributes:
        viewer: see `hfb.report.pages.viewer`. picture: its own picture of what it found, PNG or JPEG.
    """

    name: str
    viewer: Markup | None = None
    picture: bytes | None = None


def run_page(
    sentences: Sequence[str],
    tables: Sequence[PageTable],
    looks: Sequence[RunLook],
    overlay: bytes | None,
    scripts: Sequence[str] = (),
) -> str:
    """The page.

    Args:
        sentences: how far the runs are from each other.
        looks: one per run. overlay: a picture of all motions over each other.
        scripts: what the viewers need.
    """
    names = [look.name for look in looks]
    viewers = [look.viewer for look in looks if look.viewer is not None]
    return page(
        "runs.html",
        " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}",
        sentences=sentences,
        tables=tables,
        looks=looks,
        viewers=viewers,
        overlay=overlay,
        colours=RUN_CLASSES,
        scripts=scripts if viewers else (),
    )
