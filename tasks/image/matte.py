"""The person's share of each pixel."""

from pathlib import Path

from hfb.config import MattingConfig
from hfb.io.media.pictures import write_matte
from hfb.matting.methods import make_matting
from hfb.tasks.core.handles import ClipHandle, FileHandle
from hfb.tasks.core.scene import load_picture
from hfb.tasks.core.task import task
from hfb.tasks.inputs.given_networks import with_matting_network


@task("matte")
def matte(
    clip: ClipHandle, index: int, config: MattingConfig, folder: Path, network: FileHandle | None = None
) -> FileHandle:
    """The matte of one frame, as a 16-bit picture.

    Args:
        network: the user's own, for methods that need one.

    Raises:
        InputError: nothing differs from the background.
    """
    frame, plate = load_picture(clip.frames[index], clip), load_picture(clip.background, clip)
    alpha = make_matting(with_matting_network(config, network))(frame.numpy(), plate.numpy())
    path = folder / f"matte_{index}.png"
    write_matte(path, alpha)
    return FileHandle.of(path)
