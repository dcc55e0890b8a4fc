"""Whose run is it: a living process keeps it, a dead one does not, and other machines are left alone."""

import os
import signal
import subprocess
import sys

import pytest

from hfb.tasks.tracking.ownership import is_abandoned, owner

pytestmark = pytest.mark.integration

SLEEPER = "from hfb.tasks.tracking.ownership import owner; import time; print(owner(), flush=True); time.sleep(60)"


def test_this_process_is_there() -> None:
    assert not is_abandoned(owner())
    assert owner() == owner()


def test_a_killed_process_is_gone_and_its_number_proves_nothing() -> None:
    victim = subprocess.Popen([sys.executable, "-c", SLEEPER], stdout=subprocess.PIPE, text=True)
    assert victim.stdout is not None
    mark = victim.stdout.readline().strip()
    assert not is_abandoned(mark)
    victim.send_signal(signal.SIGKILL)
    victim.wait()
    assert is_abandoned(mark)
    host, _, _ = mark.split("/")
    assert is_abandoned(f"{host}/{os.getpid()}/{mark.split('/')[2]}")  # the number was given to this process since


def test_what_cannot_be_known_is_left_alone() -> None:
    host, process, began = owner().split("/")
    for mark in ("", "nonsense", f"elsewhere/{process}/{began}", f"{host}/none/{began}", f"{host}/{process}/-"):
        assert not is_abandoned(mark)
