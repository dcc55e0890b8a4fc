"""What a person sees: a line per step, how far a long one is, nothing on a silent display."""

import io
import time

import pytest
from rich.console import Console

from tasks import progress


def test_plain_lines() -> None:
    stream = io.StringIO()
    with progress.showing(progress.Plain(stream, first_s=0.05)):
        with progress.step("matte"):
            pass
        with progress.step("fit") as shown:
            progress.advance(3, 9, "loss 0.5")
            time.sleep(0.3)
            shown.reused = True
        with pytest.raises(RuntimeError), progress.step("strip"):
            raise RuntimeError
    lines = stream.getvalue().splitlines()
    assert lines[0] == "matte: 0.0 s"
    assert lines[1] == "fit 3/9, loss 0.5 (0 s) ..."
    assert lines[-1] == "fit: reused"
    assert len(lines) < 9  # it grows quieter


def test_live_display_keeps_lines_that_are_said() -> None:
    stream = io.StringIO()
    with progress.showing(progress.Live(Console(file=stream, force_terminal=True, width=80))), progress.step("fit"):
        progress.advance(1, 2, "loss [0.5]")
        progress.say("warning: [made] again")
    text = stream.getvalue()
    assert "warning: [made] again" in text
    assert "fit" in text


def test_nobody_watches() -> None:
    with progress.step("fit"):
        progress.advance(1, 2)
        progress.say("nothing")
    progress.advance(1, 2)


def test_display_for_a_pipe() -> None:
    assert isinstance(progress.display_for(io.StringIO()), progress.Plain)
    assert isinstance(progress.display_for(io.StringIO(), quiet=True), progress.Silent)
