"""Recorded runs beside each other as one HTML file that needs nothing else: where they differ, what each found, and the
same instant of all of them under one slider.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from hfb.report.page import Html, element, page, picture, section

RUN_CLASSES = ("one", "two", "three", "four")
_TWO = 2


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
        viewer: see `hfb.report.viewer`. picture: its own picture of what it found, PNG or JPEG.
    """

    name: str
    viewer: Html | None = None
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
    moving = "Any slider moves all of them: the same instant of the recording, from the same side."
    return page(
        " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}",
        *(element("p", sentence) for sentence in sentences),
        section(
            "The same instant", element("p", moving, class_="muted"), element("div", *viewers, class_=_columns(viewers))
        )
        if viewers
        else None,
        *(_table(table, names) for table in tables),
        section("What each found", *(_found(look, place) for place, look in enumerate(looks) if look.picture))
        if any(look.picture for look in looks)
        else None,
        section(
            "All of them over each other", picture(overlay, "skeletons of all runs, and their distances", wide=True)
        )
        if overlay is not None
        else None,
        scripts=scripts if viewers else (),
    )


def _found(look: RunLook, place: int) -> Html:
    assert look.picture is not None
    caption = element("figcaption", element("b", look.name, class_=_colour(place)))
    return element("figure", caption, picture(look.picture, f"what {look.name} found", wide=True))


def _table(table: PageTable, names: Sequence[str]) -> Html:
    if not table.rows:
        return section(table.title, element("p", table.empty, class_="muted"))
    extra = len(table.rows[0]) - 1 - len(names)
    heads = [element("th", name, class_=_colour(place)) for place, name in enumerate(names)]
    head = element("tr", element("th"), *heads, *(element("th") for _ in range(extra)))
    rows = [
        element("tr", element("td", row[0], class_="name"), *(element("td", value) for value in row[1:]))
        for row in table.rows
    ]
    drawn = element("table", element("thead", head), element("tbody", *rows), class_="long")
    return section(table.title, element("div", drawn, class_="wide"))


def _columns(viewers: Sequence[Html]) -> str:
    return "columns close" if len(viewers) > _TWO else "columns"


def _colour(place: int) -> str | None:
    return RUN_CLASSES[place] if place < len(RUN_CLASSES) else None
