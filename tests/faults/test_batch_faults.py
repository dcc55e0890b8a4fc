"""A batch whose clips or schedule misbehave; `python -m tests.faults.team_faults` takes its servers away, by hand."""

import json
import os
import shutil
from pathlib import Path
from uuid import UUID

import pytest

from hfb.config import CameraConfig, ExposureConfig
from hfb.tasks.core.handles import StaleFile
from hfb.tasks.inputs.video_inputs import take_video_inputs
from hfb.tasks.video.video_clip import look_at_clip, reading
from tests.faults.team_faults import COMPARED, Batch, unfinished
from tests.orchestration import prefect_api
from tests.small_clips import LONGER, run_clip, small_clip, small_config

_FRAMES = 3


def undisturbed(clip: Path, out: Path) -> dict[str, bytes]:
    """The results of a clip, by the names that `Batch.bytes` gives them."""
    run_clip(clip, out, *LONGER, workers=1)
    return {f"clip0/{name}": (out / name).read_bytes() for name in COMPARED}


def replace_pictures(clip: Path) -> None:
    """The pictures in the opposite order: somebody copies another clip over one that is worked on."""
    pictures = sorted((clip / "frames").iterdir())
    contents = [path.read_bytes() for path in pictures]
    for path, content in zip(pictures, reversed(contents), strict=True):
        path.with_suffix(".new").write_bytes(content)
        path.with_suffix(".new").replace(path)


def test_a_clip_that_is_replaced_while_a_second_schedule_starts(store: Path, tmp_path: Path) -> None:
    batch = Batch(tmp_path / "batch", 1, _FRAMES, prefect_api())
    shutil.copytree(batch.folder / "clips" / "clip0", tmp_path / "replaced")
    replace_pictures(tmp_path / "replaced")
    expected = undisturbed(tmp_path / "replaced", tmp_path / "undisturbed")

    process = batch.start()
    batch.until("frame_*.png", process)
    replace_pictures(batch.folder / "clips" / "clip0")
    second = batch.start()
    told, _ = second.communicate(timeout=120)
    assert second.returncode == 2
    assert "another hfb is working in" in json.loads(told.splitlines()[-1])["error"]

    ended = batch.finish(process)
    assert (ended["done"], ended["starts"]) == (1, 1)
    assert batch.bytes() == expected
    states = [status for _, status in batch.runs()]
    assert states.count("FINISHED") in (1, 2), "the clip as it was may have been finished, and is another one"
    assert set(states) <= {"FINISHED", "FAILED"}
    assert unfinished(prefect_api()) == []


def test_no_result_is_kept_of_a_clip_that_changed(tmp_path: Path) -> None:
    clip = tmp_path / "clip"
    shutil.copytree(small_clip(_FRAMES).truth.parent, clip)
    inputs = take_video_inputs(clip, small_config())
    seen = look_at_clip.fn(inputs=inputs, average=1, camera=CameraConfig(), exposure=ExposureConfig(), folder=tmp_path)
    with reading(seen) as footage:
        assert len(list(footage.frames())) == _FRAMES
    with reading(seen, 0, 1):  # only its own pictures matter to a step
        os.utime(inputs.video[2].path, (1, 1))
    with pytest.raises(StaleFile, match="no longer what it was"), reading(seen) as footage:  # noqa: PT012
        next(footage.frames())
        replace_pictures(clip)
    with pytest.raises(StaleFile, match="no longer what it was"), reading(seen):
        pytest.fail("these are another clip's pictures")


def test_a_flow_run_whose_end_could_not_be_told(store: Path) -> None:
    """What Prefect's server leaves Running when its database is away at the wrong moment."""
    from prefect import flow, get_client
    from prefect.runtime import flow_run
    from prefect.states import Running

    from hfb.flows.runtime.reaper import end_abandoned_flow_runs, mark_owner

    def whole() -> str:
        return str(flow_run.id)

    def around() -> tuple[str, int]:
        ended = flow(name="ended", persist_result=False, on_running=[mark_owner])(whole)()
        with get_client(sync_client=True) as client:
            client.set_flow_run_state(UUID(ended), Running(), force=True)
        assert len(unfinished(prefect_api())) == 2
        return ended, end_abandoned_flow_runs()

    lost, count = flow(name="around", persist_result=False, on_running=[mark_owner])(around)()
    assert count == 1
    with get_client(sync_client=True) as client:
        state = client.read_flow_run(UUID(lost)).state
    assert state is not None
    assert (state.name, state.message) == ("Crashed", "its end could not be told")
    assert unfinished(prefect_api()) == []
