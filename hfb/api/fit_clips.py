"""`hfb.fit_clip`: the command `hfb video` as a function, without a server."""

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path

from hfb.api.call_options import config_of
from hfb.api.given_images import Image, image_file, image_files, is_one_image, path_of
from hfb.api.own_parts import TermFunction, own_parts
from hfb.api.private_call import Progress, in_memory, options_of, private_call
from hfb.api.result import Result, result_of
from hfb.errors import InputError
from hfb.initialization.initializer import Initializer
from hfb.matting.matting_protocol import Matting
from hfb.priors.pose import PosePrior
from hfb.tasks.chains.clip_chain import fit_clip as run_chain
from hfb.tasks.inputs.inputs import with_height
from hfb.tasks.inputs.video_inputs import take_video_inputs


def fit_clip(
    video: Image | Sequence[Image],
    /,
    background: Image | None = None,
    *,
    init: str | Path | Initializer | None = None,
    matting: str | Matting | None = None,
    prior: str | Path | PosePrior | None = None,
    extra_terms: Mapping[str, TermFunction | tuple[TermFunction, float]] | None = None,
    clip: str | Path | None = None,
    config: str | Path | None = None,
    on_progress: Progress | None = None,
    **options: object,
) -> Result:
    """Recover one motion of a whole clip of a static camera, as the command ``hfb video`` does, with the same numbers.

    Neither Prefect nor MLflow is imported; nothing is recorded or cached, and one processor computes. Frames without a
    pose are no rows of the result: `Result.gaps` has them, `Result.missed` why.

    Args:
        video: a video, a folder of frames or with a clip.toml; or the frames in their order: paths, PIL images, or
            arrays (H, W, 3) as of `hfb.fit`.
        background: the same view without the person; or ``"median"`` over time, or ``"still"``, the longest stretch in
            which nobody moves. None: what clip.toml says, else a plate beside the video or folder, else the median.
        init: as of `hfb.fit`; a function is asked for the key frames, one every ``key_every``.
        matting: as of `hfb.fit`; a function sees the surroundings of the person alone where others are in the clip.
        prior: as of `hfb.fit`.
        extra_terms: as of `hfb.fit`; they are part of every window's loss.
        clip: a clip.toml with calibration, exposure, time range and person; a folder's own is found.
        config: a TOML file of options.
        on_progress: called with a step's name, how much of it is done, and of how much (None where that is not known).
        **options: those of the command line by the same names, as of `hfb.fit`; those of clips, too: ``average=3``,
            ``video={"settle": 0}``.

    Raises:
        InputError: an input cannot be used; the sentence names the fix.
    """
    options = {**options, **options_of(init=init, matting=matting, prior=prior)}
    own = own_parts(matting, init, prior, extra_terms)
    with private_call(on_progress, own=own, keep=True) as folder:
        chosen = config_of(options, config, clip=True)
        if isinstance(video, str | PathLike):
            source: Path | tuple[Path, ...] = path_of(video)
        elif is_one_image(video):
            raise InputError("one image is no clip: give its frames in a list in their order, or the image to hfb.fit")
        else:
            source = tuple(image_files(video, folder))
        plate = None if background is None else str(image_file(background, "background", folder))
        inputs = take_video_inputs(source, chosen, path_of(clip) if clip is not None else None, plate)
        if inputs.clip.person.which == "everyone":
            raise InputError("clip.toml means everyone, and hfb.fit_clip follows one person: say there which")
        lacks = in_memory(inputs, folder)
        return result_of(run_chain(inputs, with_height(chosen, inputs.clip), folder), folder, lacks)
