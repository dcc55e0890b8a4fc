"""The static body that the fit of a frame starts from."""

from pathlib import Path

from hfb.config import InitConfig
from hfb.initialize.first_body import load_first_body, save_first_body
from hfb.initialize.initializer import make_initializer
from tasks.given_networks import with_pose_network
from tasks.handles import ClipHandle, FileHandle, FirstBodyHandle
from tasks.scene import load_chosen_body, load_observation
from tasks.task import task


@task("first body")
def first_body(
    clip: ClipHandle,
    index: int,
    mattes: tuple[FileHandle, ...],
    body: FileHandle | None,
    config: InitConfig,
    networks: tuple[FileHandle, ...],
    folder: Path,
) -> FirstBodyHandle:
    """Estimate the body of one frame.

    Args:
        networks: the pose networks at hand, or METRO's; with other ones the estimate is made again.

    Raises:
        InputError: no person was found.
    """
    seen = load_observation(clip, mattes)
    found = make_initializer(with_pose_network(config, networks))(
        seen.frames_linear[index], seen.plate_linear, seen.mattes[index], seen.camera, load_chosen_body(body)
    )
    path = folder / f"first_body_{index}.npz"
    save_first_body(path, found)
    return FirstBodyHandle.of(path, source=found.source)


def given_body(file: FileHandle) -> FirstBodyHandle:
    """A first body that the caller brought."""
    return FirstBodyHandle(**file.model_dump(), source=load_first_body(file.path).source)
