"""Where and with whom a clip's flows work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hfb.flows.runtime.trouble import told_plainly
from hfb.flows.runtime.workplace import workplace
from hfb.tasks.core.result_records import records_in
from hfb.tasks.workers.engine import Engine
from hfb.tasks.workers.workers import workers


@contextmanager
def clip_place(out: Path, engine: Engine | int) -> Iterator[Path]:
    """The folder for intermediate files, held for this process alone, with the engine's workers at hand.

    Raises:
        InputError: see `hfb.flows.runtime.workplace.workplace` and `hfb.tasks.workers.workers.workers`.
        Unavailable: see `hfb.flows.runtime.trouble.told_plainly`.
    """
    with (
        told_plainly(out),
        workplace(out) as folder,
        workers(engine, apart=True),
        records_in(folder),
    ):
        yield folder
