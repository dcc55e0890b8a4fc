"""The ledger of a batch: each clip once, failures later and later, hopeless ones set aside."""

import os
import time
from pathlib import Path

from hfb.tasks.batch.batch_ledger import Ledger, stamp_of


def test_failures_wait_longer_each_time_and_end_aside(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path / "batch.json")
    assert ledger.entry("a", "s") is None
    waits = []
    for _ in range(3):
        entry = ledger.failed("a", "s", "the disk is full", attempts=4, wait_s=10.0, hopeless=False)
        waits.append(entry.due - time.time())
        assert entry.status == "failed"
    assert [round(wait / 10) for wait in waits] == [1, 2, 4]
    assert ledger.failed("a", "s", "the disk is full", attempts=4, wait_s=10.0, hopeless=False).status == "set aside"
    assert ledger.failed("b", "s", "no video", attempts=4, wait_s=10.0, hopeless=True).status == "set aside"

    read = Ledger(tmp_path / "batch.json")  # another process
    entry = read.entry("a", "s")
    assert entry is not None
    assert (entry.status, entry.attempts, entry.reason) == ("set aside", 4, "the disk is full")
    assert read.entry("a", "changed") is None
    read.again()
    assert read.entry("a", "s") is None
    read.finished("a", "s", "http://link")
    read.again()
    assert read.entry("a", "s") is not None


def test_a_damaged_ledger_is_begun_anew(tmp_path: Path) -> None:
    for content in (b"", b"[]", b'{"a": 3}', b"\xff\xfe"):
        (tmp_path / "batch.json").write_bytes(content)
        assert Ledger(tmp_path / "batch.json").entry("a", "s") is None


def test_a_stamp_follows_files_and_options(tmp_path: Path) -> None:
    clip = tmp_path / "a.mp4"
    clip.write_bytes(b"1")
    os.utime(clip, (1000, 1000))
    stamp, written = stamp_of([clip], {"seed": 0})
    assert written == 1000
    assert stamp_of([clip], {"seed": 0})[0] == stamp
    assert stamp_of([clip], {"seed": 1})[0] != stamp
    os.utime(clip, (1001, 1001))
    assert stamp_of([clip], {"seed": 0})[0] != stamp


def test_a_linked_record_is_not_read(tmp_path: Path) -> None:
    """It would be another batch's, or no batch's at all."""
    (tmp_path / "out").mkdir()
    (tmp_path / "mine").write_text('{"walk": {"stamp": "a", "status": "done"}}')
    (tmp_path / "out" / "batch.json").symlink_to(tmp_path / "mine")
    ledger = Ledger(tmp_path / "out" / "batch.json")
    assert "symbolic link" in ledger.damage
    assert ledger.entry("walk", "a") is None
