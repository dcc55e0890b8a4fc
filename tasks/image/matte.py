"""The person's share of each pixel."""

from pathlib import Path

from hfb.config import MattingConfig
from hfb.io.media.images.image_io import write_matte
from hfb.networks.mediapipe_files import LandmarkChoice
from hfb.tasks.core.caller_parts import caller_parts
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.tasks.core.scene import load_image
from hfb.tasks.inputs.given_networks import person_matting
from hfb.tasks.task import task


@task("matte")
def matte(
    *,
    clip: ClipHandle,
    index: int,
    config: MattingConfig,
    landmarks: LandmarkChoice,
    pose_networks: tuple[FileHandle, ...],
    quick: bool,
    folder: Path,
    network: FileHandle | None = None,
) -> FileHandle:
    """Estimate the matte of one frame, as a 16-bit image.

    Args:
        clip: all frames.
        index: of the frame.
        config: options of the matte.
        landmarks: choice among the landmark networks.
        pose_networks: those that tell the person from shade on the floor, by `shade_networks`.
        quick: see `hfb.matting.methods.make_matting`.
        folder: where the matte goes.
        network: the user's own, for methods that need one.

    Raises:
        InputError: nothing differs from the background, or this machine has other pose networks.
    """
    frame, plate = load_image(clip.frames[index], clip), load_image(clip.background, clip)
    matting = caller_parts().matting or person_matting(config, network, landmarks, pose_networks, quick=quick)
    path = folder / f"matte_{index}.png"
    write_matte(path, matting(frame.numpy(), plate.numpy()))
    return FileHandle.of(path)
