"""The static body that the fit of a frame starts from."""

from pathlib import Path

from hfb.config import InitConfig
from hfb.initialization.fronts import front_doubts
from hfb.initialization.initializer import make_initializer
from hfb.motion.static_pose import load_first_body, save_first_body
from hfb.tasks.core.caller_parts import caller_parts
from hfb.tasks.core.handles import ClipHandle, FileHandle, FirstBodyHandle
from hfb.tasks.core.scene import load_chosen_body, load_observation
from hfb.tasks.inputs.given_networks import with_pose_network
from hfb.tasks.task import task


@task("first body")
def first_body(
    *,
    clip: ClipHandle,
    index: int,
    mattes: tuple[FileHandle, ...],
    body: FileHandle | None,
    config: InitConfig,
    networks: tuple[FileHandle, ...],
    folder: Path,
) -> FirstBodyHandle:
    """Estimate the body of one frame; of several frames, also the certainty of its front, which must be consistent.

    Args:
        clip: all frames.
        index: of the frame.
        mattes: of all frames.
        body: the user's body model; None for the embedded one.
        config: options of the first body.
        networks: the installed pose networks, or the user's own; others give a new estimate.
        folder: where the body goes.

    Raises:
        InputError: no person was found.
    """
    seen, model = load_observation(clip.only(index), (mattes[index],)), load_chosen_body(body)
    initializer = caller_parts().initializer or make_initializer(with_pose_network(config, networks))
    found = initializer(seen.frames_linear[0], seen.plate_linear, seen.mattes[0], seen.camera, model)
    doubt = float(front_doubts(seen, [found], model)[0]) if len(clip.frames) > 1 else 0.0
    path = folder / f"first_body_{index}.npz"
    save_first_body(path, found)
    return FirstBodyHandle.of(path, source=found.source, doubt=doubt)


def given_body(file: FileHandle) -> FirstBodyHandle:
    """Return the handle of a first body that the caller provides.

    Args:
        file: the first body.
    """
    return FirstBodyHandle(**file.model_dump(), source=load_first_body(file.path).source)
