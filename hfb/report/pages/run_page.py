"""A comparison of recorded runs as one self-contained HTML file.

It lists the differences in options and scores, and shows the motions of all runs with one time slider.
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
        rows: name, a value per run, and for numbers what follows them, such as a difference.
        empty: text of a table without rows.
    """

    title: str
    rows: tuple[tuple[str, ...], ...]
    empty: str = "nothing"


@dataclass(frozen=True)
class RunLook:
    """Viewer and image of a run.

    Attributes:
        viewer: see `hfb.report.pages.viewer`.
        picture: the run's own image of its result, PNG or JPEG.
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
    """Render the page.

    Args:
        sentences: how far the runs' motions are apart.
        tables: options, environment and scores.
        looks: one per run.
        overlay: an image of all motions, PNG.
        scripts: those of the viewers.
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
