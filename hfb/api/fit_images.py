"""`hfb.fit`, `hfb.matte` and `hfb.first_body`: the steps of the command `hfb fit` as functions, without a server."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from hfb.api.call_options import config_of
from hfb.api.given_images import Image, image_file, image_files, path_of
from hfb.api.own_parts import TermFunction, own_parts
from hfb.api.private_call import Progress, in_memory, options_of, private_call
from hfb.api.result import Result, result_of
from hfb.config import RunConfig
from hfb.initialization.initializer import Initializer
from hfb.io.media.images.image_io import read_matte
from hfb.matting.matting_protocol import Matting
from hfb.motion.static_pose import FirstBody, load_first_body
from hfb.priors.pose import PosePrior
from hfb.tasks.chains.image_chain import find_first_bodies, see_images
from hfb.tasks.chains.image_chain import fit_images as run_chain
from hfb.tasks.inputs.inputs import Inputs, take_inputs, with_height
from hfb.typing import Array, Float


def fit(
    frames: Image | Sequence[Image],
    background: Image,
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
    """Recover how a person moved while the shutter was open, as the command ``hfb fit`` does, with the same numbers.

    Images are paths, PIL images, or arrays (H, W, 3): uint8 is sRGB, floating point is linear light in [0, 1]. Neither
    Prefect nor MLflow is imported; nothing is recorded or cached.

    Args:
        frames: one blurred image, or several of one static camera in their order, which are one problem.
        background: the same view without the person.
        init: how to find the first body (``"auto"``, ``"mediapipe"``, ``"matte"`` ...), another system's result as a
            file, or an `hfb.Initializer`.
        matting: a method's name, or an `hfb.Matting`.
        prior: ``"anatomy"`` or ``"mixture"``, a file, or an `hfb.PosePrior`.
        extra_terms: name -> a function of `hfb.TermInputs` that returns a scalar tensor, or (function, weight); the
            weight is 1 where none is given.
        clip: a clip.toml with calibration and exposure.
        config: a TOML file of options.
        on_progress: called with a step's name, how much of it is done, and of how much (None where that is not known).
        **options: those of the command line by the same names: ``preset="paper"``, ``seed=1``, ``height_m=1.82``,
            ``subframes=4``, ``focal_px=1180``, ``fit={"weights": {"joints": 0}}``.

    Raises:
        InputError: an input cannot be used; the sentence names the fix.
    """
    options = {**options, **options_of(init=init, matting=matting, prior=prior)}
    own = own_parts(matting, init, prior, extra_terms)
    with private_call(on_progress, own=own, keep=True) as folder:
        inputs, chosen, lacks = _take(frames, background, options, folder, clip=clip, config=config)
        return result_of(run_chain(inputs, chosen, folder), folder, lacks)


def matte(
    frame: Image,
    background: Image,
    *,
    matting: str | None = None,
    clip: str | Path | None = None,
    config: str | Path | None = None,
    **options: object,
) -> Float[Array, "H W"]:
    """Estimate the person's share of each pixel.

    Args:
        frame: as of `fit`.
        background: as of `fit`.
        matting: a method's name.
        clip: as of `fit`.
        config: as of `fit`.
        **options: as of `fit`.

    Raises:
        InputError: frame and plate do not match, or no person is found.
    """
    options = {"matte_again": False, **options, **options_of(matting=matting)}  # no fit refines it
    with private_call() as folder:
        inputs, chosen, _ = _take(frame, background, options, folder, clip=clip, config=config)
        _, (found,) = see_images(inputs, chosen, folder)
        return read_matte(found.path)


def first_body(
    frame: Image,
    background: Image,
    *,
    init: str | Path | None = None,
    matting: str | Matting | None = None,
    clip: str | Path | None = None,
    config: str | Path | None = None,
    **options: object,
) -> FirstBody:
    """Estimate the static body that a fit of one frame starts from.

    Args:
        frame: as of `fit`.
        background: as of `fit`.
        init: as of `fit`.
        matting: as of `fit`.
        clip: as of `fit`.
        config: as of `fit`.
        **options: as of `fit`.

    Raises:
        InputError: no person is found.
    """
    options = {**options, **options_of(init=init, matting=matting)}
    with private_call(own=own_parts(matting, None, None, None)) as folder:
        inputs, chosen, _ = _take(frame, background, options, folder, clip=clip, config=config)
        scene, mattes = see_images(inputs, chosen, folder)
        (found,) = find_first_bodies(scene, mattes, inputs=inputs, config=chosen, folder=folder)
        return load_first_body(found.path)


def _take(
    frames: Image | Sequence[Image],
    background: Image,
    options: Mapping[str, object],
    folder: Path,
    *,
    clip: str | Path | None,
    config: str | Path | None,
) -> tuple[Inputs, RunConfig, tuple[str, ...]]:
    """Return inputs and options, and what of the inputs is no file."""
    chosen = config_of(options, config)
    paths, plate = image_files(frames, folder), image_file(background, "background", folder)
    inputs = take_inputs(paths, plate, chosen, path_of(clip) if clip is not None else None)
    return inputs, with_height(chosen, inputs.clip), in_memory(inputs, folder)
