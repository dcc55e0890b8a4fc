"""Where and with whom a clip's flows work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from flows.trouble import told_plainly
from flows.workplace import workplace
from tasks.engine import Engine
from tasks.result_records import records_in
from tasks.workers import workers


@contextmanager
def clip_place(out: Path, engine: Engine | int) -> Iterator[Path]:
    """The folder for intermediate files, held for this process alone, with the engine's workers at hand.

    Raises:
        InputError: see `flows.workplace.workplace` and `tasks.workers.workers`.
        Unavailable: see `flows.trouble.told_plainly`.
    """
    with (
        told_plainly(out),
        workplace(out) as folder,
        workers(engine, apart=True),
        records_in(folder),
    ):
        yield folder
