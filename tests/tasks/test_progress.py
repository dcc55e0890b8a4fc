"""What a person sees: a line per step, how far a long one is, nothing on a silent display; what Prefect keeps of it."""

import io
import logging
import threading
import time
from pathlib import Path

import pytest
from rich.console import Console

from hfb.tasks.telemetry import displays, progress
from hfb.tasks.telemetry.progress_artifacts import Artifacts
from hfb.tasks.workers.workers import run_local, workers


def live(width: int = 80) -> tuple[io.StringIO, displays.Live]:
    stream = io.StringIO()
    return stream, displays.Live(Console(file=stream, force_terminal=True, width=width))


def test_plain_lines() -> None:
    stream = io.StringIO()
    with progress.showing(displays.lines_on(stream, first_s=0.25)):
        with progress.step("matte"):
            pass
        with progress.step("fit") as shown:
            progress.advance(3, 9, "loss 0.5")
            time.sleep(0.8)
            shown.reused = True
        with pytest.raises(RuntimeError), progress.step("strip"):
            raise RuntimeError
    lines = stream.getvalue().splitlines()
    assert lines[0] == "matte: 0.0 s"
    assert lines[1] == "fit 3/9, loss 0.5 (0 s) ..."
    assert lines[-1] == "fit: reused"
    assert len(lines) < 9  # it grows quieter


def test_the_outer_step_is_watched_again_when_the_inner_one_ends() -> None:
    stream = io.StringIO()
    with progress.showing(displays.lines_on(stream, first_s=0.05)), progress.step("clip"):
        with progress.step("frames"):
            time.sleep(0.1)
        ended = len(stream.getvalue().splitlines())

        def outer() -> bool:
            return any(line.startswith("clip (") for line in stream.getvalue().splitlines()[ended:])

        deadline = time.monotonic() + 20
        while not outer() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert outer()


def test_live_display_keeps_lines_that_are_said() -> None:
    stream, display = live()
    with progress.showing(display), progress.step("fit [bold]"):
        progress.advance(1, 2, "loss [0.5] of [red]clip")
        display._bar.refresh()
        progress.say("warning: [made] again :dog: \x1b[2J")
    text = stream.getvalue()
    assert "warning: [made] again :dog: \N{REPLACEMENT CHARACTER}[2J" in text
    assert "loss [0.5] of [red]clip" in text
    assert "fit [bold]" in text


def test_a_full_bar_goes_on_while_its_step_does() -> None:
    """What comes after the last iteration is work too."""
    _, display = live()
    with progress.showing(display), progress.step("fit"):
        progress.advance(9, 9)
        assert not display._bar.finished


def test_every_thread_is_heard() -> None:
    """Libraries log from threads of their own, which know nothing of the flow's context."""
    stream = io.StringIO()
    with progress.showing(displays.lines_on(stream)):
        thread = threading.Thread(target=progress.say, args=("from elsewhere",))
        thread.start()
        thread.join()
    assert stream.getvalue() == "from elsewhere\n"


def _warns() -> None:
    logging.getLogger("hfb.somewhere").warning("this frame is dark")


def test_workers_log_through_this_process(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import hfb.tasks.task  # noqa: F401  (workers import it too, and with it Prefect, which adds a console handler)

    monkeypatch.setattr(logging.getLogger(), "handlers", [caplog.handler])
    with workers(1, apart=True):
        run_local(_warns)
    assert [record.getMessage() for record in caplog.records if record.name == "hfb.somewhere"] == [
        "this frame is dark"
    ]
    assert "dark" not in capfd.readouterr().err  # a raw line would break a bar


def test_nobody_watches() -> None:
    with progress.step("fit"):
        progress.advance(1, 2)
        progress.say("nothing")
    progress.advance(1, 2)
    assert not progress.shown_to_somebody()


def test_display_for_a_pipe() -> None:
    assert [type(one) for one in displays.displays_for(io.StringIO())] == [displays.Plain, Artifacts]
    assert [type(one) for one in displays.displays_for(io.StringIO(), quiet=True)] == [progress.Display]


def test_long_steps_of_a_flow_run_have_progress_artifacts(store: Path) -> None:
    from prefect import flow
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import ArtifactFilter, ArtifactFilterFlowRunId

    seen: list = []

    def artifacts() -> list:
        with get_client(sync_client=True) as client:
            mine = ArtifactFilter(flow_run_id=ArtifactFilterFlowRunId(any_=[seen[0]]))
            return client.read_artifacts(artifact_filter=mine)

    @flow(name="watched")
    def watched() -> None:
        from prefect.runtime import flow_run

        seen.append(flow_run.id)
        with progress.step("short"):
            progress.advance(1, 2)
        with progress.step("mattes & starts"):
            progress.advance(1, 4, "2.0 s each")
            deadline = time.monotonic() + 20
            while not artifacts() and time.monotonic() < deadline:
                time.sleep(0.1)
            progress.advance(4, 4)

    with progress.showing(Artifacts(first_s=0.3, every_s=0.1)):
        watched()
    (artifact,) = artifacts()
    assert (artifact.key, artifact.type, float(artifact.data)) == ("progress-mattes-starts", "progress", 100.0)
    assert artifact.description == "mattes & starts: 4 of 4"


def test_a_run_that_a_server_started_says_how_far_it_is(store: Path, caplog: pytest.LogCaptureFixture) -> None:
    from prefect import flow

    @flow(name="deployed")
    def deployed() -> None:
        with displays.show_progress(), progress.step("frames"):
            progress.say("hfb: one clip")

    with caplog.at_level(logging.INFO):
        deployed()
    said = [record.getMessage() for record in caplog.records if record.name == "prefect.flow_runs"]
    assert "hfb: one clip" in said
    assert "frames: 0.0 s" in said

    stream = io.StringIO()
    with progress.showing(displays.lines_on(stream)):
        deployed()
    assert "hfb: one clip" in stream.getvalue()  # whoever started it by hand has a display already


def test_a_server_that_is_gone_does_not_hold_the_work_up(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from prefect import flow

    def lost(*_: object) -> None:
        raise OSError("the server is gone")

    monkeypatch.setattr("hfb.tasks.telemetry.progress_artifacts._tell", lost)
    display = Artifacts(first_s=0.0, every_s=0.05)

    @flow(name="unwatched")
    def unwatched() -> None:
        with progress.step("fit"):
            progress.advance(1, 2)
            time.sleep(0.3)

    began = time.monotonic()
    with progress.showing(display):
        unwatched()
    assert display._gone
    assert time.monotonic() - began < 10
