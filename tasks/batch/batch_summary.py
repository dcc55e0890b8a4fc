"""summary.html of a batch: rows and thumbnails are cached, and only changed pages are written."""

from __future__ import annotations

import hashlib
import logging
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hfb.errors import InputError
from hfb.interop.writers.export_names import REPORT, RESULT
from hfb.io.atomic import write_bytes_atomic
from hfb.io.names import shown_name
from hfb.io.safe_folder import read_file
from hfb.report.pages.result_facts import read_facts
from hfb.tasks.batch.batch_ledger import set_aside
from hfb.tasks.telemetry import progress

if TYPE_CHECKING:
    from hfb.report.pages.batch_page import BatchClip, BatchCounts

PAGE = "summary.html"
_STRIP = "strip.png"
_STRIP_BYTES = 512 << 20
_OTHER_PAGE = re.compile(r"summary-(\d+)\.html")
_MARK = b"<title>Clips of "
_MOST_PEOPLE = 100
_THUMBNAIL_BYTES, _THUMBNAIL_PX = 1 << 18, 1000
_log = logging.getLogger(__name__)


class BatchSummary:
    """All clips of a batch, as its pages show them."""

    def __init__(self, title: str, out: Path, thumbnails: Path) -> None:
        """Begin without clips.

        Args:
            title: of the pages.
            out: their folder.
            thumbnails: folder of small images, which no clip's result can be in.
        """
        self._title, self._out, self._thumbnails = title, out, thumbnails
        self._names: list[str] = []
        self._places: dict[str, int] = {}
        self._clips: dict[str, BatchClip] = {}
        self._found: dict[str, tuple[object, BatchClip]] = {}  # what a row was made of, and the row
        self._written: dict[int, list[object]] = {}  # what each page was made of as it lies there
        self._told: set[str] = set()

    def counts(self) -> BatchCounts:
        """Return the number of clips in each state."""
        from hfb.report.pages.batch_page import BatchCounts

        states = [clip.status for clip in self._clips.values()]
        warned_of = sum(clip.is_warned_of for clip in self._clips.values())
        return BatchCounts(len(states), states.count("done"), states.count("set aside"), warned_of)

    def show_all(self, states: Sequence[tuple[str, str, str, str | None]]) -> None:
        """Show these clips and no others.

        Args:
            states: (name, status, reason, link) in the order of the pages.
        """
        from hfb.report.pages.batch_page import page_count

        self._names = [name for name, *_ in states]
        self._places = {name: place for place, name in enumerate(self._names)}
        self._clips = {name: self._row(name, status, reason, link) for name, status, reason, link in states}
        self._found = {name: found for name, found in self._found.items() if name in self._clips}
        pages = page_count(len(self._names))
        self._write(range(pages))
        self._remove_from(pages)

    def show(self, name: str, status: str, reason: str = "", link: str | None = None) -> None:
        """Update one clip: its page, and the first page, which counts.

        Args:
            name: of the clip.
            status: its state.
            reason: why it failed; empty otherwise.
            link: its page in MLflow.
        """
        from hfb.report.pages.batch_page import CLIPS_PER_PAGE

        self._clips[name] = self._row(name, status, reason, link)
        self._write(sorted({0, self._places[name] // CLIPS_PER_PAGE}))

    def _row(self, name: str, status: str, reason: str, link: str | None) -> BatchClip:
        """Return a clip's row, cached where nothing has changed; an unreadable result becomes that clip's failure."""
        folder = self._out / name
        signature = (status, reason, link, _stamps(folder))
        known = self._found.get(name)
        if known is not None and known[0] == signature:
            return known[1]
        row = self._made(name, status, reason, link)
        self._found[name] = signature, row
        return row

    def _made(self, name: str, status: str, reason: str, link: str | None) -> BatchClip:
        from hfb.report.pages.batch_page import BatchClip

        shown, folder = shown_name(name), self._out / name
        if status != "done" or not os.path.lexists(folder / RESULT):
            return BatchClip(shown, status, reason, link=link)
        facts: Mapping[str, Any] = {}
        try:
            facts = read_facts(folder / RESULT, self._out)  # the folder may be from somebody else
            people = tuple(self._people(name, facts))
            return BatchClip(
                shown, status, reason, facts, self._thumbnail(name, folder), link, self._report_in(folder), people
            )
        except Exception as error:  # whatever is wrong with one clip's files, the page tells of all
            if not isinstance(error, InputError | OSError):
                _log.exception("%s", shown)
            told = f"its result is damaged: {error}; move {folder} away to have it made again"
            return BatchClip(shown, "set aside", told, facts, link=link)

    def _people(self, name: str, facts: Mapping[str, Any]) -> Iterator[BatchClip]:
        """Yield the people of a clip, from their folders within the clip's, whatever result.json says."""
        from hfb.report.pages.batch_page import BatchClip

        for number, one in enumerate((facts.get("people") or ())[:_MOST_PEOPLE], 1):
            person = f"{name}/person-{number}"
            if one["error"]:
                yield BatchClip(one["name"], "no motion", one["error"], one)
                continue
            folder = self._out / person
            yield BatchClip(
                one["name"], "done", "", one, self._thumbnail(person, folder), report=self._report_in(folder)
            )

    def _report_in(self, folder: Path) -> Path | None:
        """Return a result's page, relative to the folder of the summary."""
        whole, here = folder.resolve() / REPORT, self._out.resolve()
        return whole.relative_to(here) if whole.is_file() and whole.is_relative_to(here) else None

    def _thumbnail(self, name: str, folder: Path) -> Path | None:
        """Return the thumbnail of a result's strip, made where it is missing or outdated.

        Raises:
            InputError: the strip is no image.
        """
        from hfb.report.pages.batch_page import strip_thumbnail

        strip = folder / _STRIP
        if not os.path.lexists(strip):
            return None
        whose = hashlib.sha256(os.fsencode(name)).hexdigest()[:16]
        when = hashlib.sha256(repr(_stamp(strip)).encode()).hexdigest()[:16]
        place = self._thumbnails / f"{whose}-{when}.jpg"
        if not _is_thumbnail(place):
            content = strip_thumbnail(strip, read_file(self._out, *Path(name).parts, _STRIP, limit=_STRIP_BYTES))
            for older in self._thumbnails.glob(f"{whose}-*.jpg"):
                older.unlink(missing_ok=True)
            write_bytes_atomic(place, content)
        return place

    def _write(self, pages: Sequence[int]) -> None:
        """Write changed pages; an obstacle to one does not end the batch."""
        from hfb.report.pages.batch_page import CLIPS_PER_PAGE, batch_page, page_name

        counts, every = self.counts(), [self._clips[name] for name in self._names]
        aside = [(place, clip) for place, clip in enumerate(every) if clip.status == "set aside"]
        for number in pages:
            clips = every[number * CLIPS_PER_PAGE : (number + 1) * CLIPS_PER_PAGE]
            made_of = [counts, *map(id, clips), *((place, id(clip)) for place, clip in aside if not number)]
            place = self._out / page_name(number)
            if self._written.get(number) == made_of and place.is_file():
                continue
            try:
                if place.is_dir():
                    self._say(f"{place} is a folder where the batch's page belongs: it is now {set_aside(place).name}")
                write_bytes_atomic(place, batch_page(self._title, clips, number, counts, aside).encode())
                self._written[number] = made_of
            except OSError as error:
                self._say(f"the batch's page {place} cannot be written: {error.strerror}")

    def _remove_from(self, pages: int) -> None:
        """Remove pages of an earlier, longer batch."""
        for path in self._out.glob("summary-*.html"):
            found = _OTHER_PAGE.fullmatch(path.name)
            if found is None or int(found[1][:9]) <= pages or path.is_symlink() or not path.is_file():
                continue
            with suppress(OSError), path.open("rb") as file:
                if _MARK in file.read(1 << 14):
                    path.unlink()

    def _say(self, sentence: str) -> None:
        if sentence not in self._told:
            self._told.add(sentence)
            _log.warning("%s", sentence)
            progress.say(f"hfb: {sentence}")


def _stamps(folder: Path) -> tuple[object, ...]:
    """Return what changes when the files shown in a result's row do, including those of several people."""
    people = (folder / f"person-{number}" for number in range(1, _MOST_PEOPLE + 1))
    there = [folder, *takewhile(os.path.lexists, people)]
    return tuple(_stamp(one / name) for one in there for name in (RESULT, _STRIP, REPORT))


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        facts = path.lstat()
    except OSError:
        return None
    return facts.st_size, facts.st_mtime_ns, facts.st_ino


def _is_thumbnail(path: Path) -> bool:
    """Return whether a file is a small JPEG: the folder may be of foreign origin."""
    from hfb.io.media.images.image_io import picture_size

    try:
        if path.is_symlink() or path.stat().st_size > _THUMBNAIL_BYTES:
            return False
        return max(picture_size(path)[:2]) <= _THUMBNAIL_PX
    except (OSError, InputError):
        return False
