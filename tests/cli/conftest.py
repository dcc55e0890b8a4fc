"""Fixtures of the command line tests."""

import logging
import signal
from collections.abc import Iterator

import prefect.main  # noqa: F401
import pytest
from prefect.logging.handlers import PrefectConsoleHandler


@pytest.fixture(autouse=True)
def _own_logging() -> Iterator[None]:
    """`main` adds handlers and catches SIGTERM; put back what was there.

    It does so before anything of Prefect's is imported, which then adds none to the root; here it has been already.
    """
    root, before = logging.getLogger(), signal.getsignal(signal.SIGTERM)
    for handler in [one for one in root.handlers if isinstance(one, PrefectConsoleHandler)]:
        root.removeHandler(handler)
    handlers, level = list(root.handlers), root.level
    yield
    for handler in set(root.handlers) - set(handlers):
        root.removeHandler(handler)
        handler.close()
    root.setLevel(level)
    logging.captureWarnings(False)
    signal.signal(signal.SIGTERM, before)
