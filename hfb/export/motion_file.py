"""motion.npz: the lossless result, readable by numpy alone."""

import io
import zipfile
from pathlib import Path

import numpy as np

from hfb.errors import InputError
from hfb.media.atomic import write_bytes_atomic
from hfb.motion.sampled import SampledMotion
from hfb.shapes import Array

_ARRAYS = ("poses", "trans", "betas", "joints", "times_s", "frame_index", "K")
_OPTIONAL = ("joint_radius_mm",)
_LIMIT_BYTES = 1 << 30


def motion_arrays(motion: SampledMotion, betas_space: str) -> dict[str, Array]:
    """The members of a motion file, by name."""
    known = {name: getattr(motion, name) for name in (*_ARRAYS, *_OPTIONAL) if getattr(motion, name) is not None}
    return known | {"betas_space": np.array(betas_space)}


def save_motion(path: Path, motion: SampledMotion, betas_space: str) -> None:
    """Write the motion whole or not at all; no pickled member.

    Args:
        betas_space: whose shape coefficients these are: ``"smpl"`` or ``"hfb"`` (the embedded body's own).
    """
    write_arrays(path, motion_arrays(motion, betas_space))


def write_arrays(path: Path, arrays: dict[str, Array]) -> None:
    """A compressed .npz of plain arrays, whole or not at all."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]  # its stub confuses them with allow_pickle
    write_bytes_atomic(path, buffer.getvalue())


def load_motion(path: Path) -> tuple[SampledMotion, str]:
    """Read a motion file; returns the motion and whose betas it holds.

    Raises:
        InputError: not a motion file, or a damaged one.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > _LIMIT_BYTES:
                raise ValueError("unpacked it would be larger than 1 GiB")
        with np.load(path, allow_pickle=False) as file:
            names = (*_ARRAYS, *(name for name in _OPTIONAL if name in file.files))
            return SampledMotion(**{name: file[name] for name in names}), str(file["betas_space"])
    except FileNotFoundError:
        raise InputError(f"there is no motion file at {path}") from None
    except (KeyError, ValueError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is not a motion file of hfb ({error}); make one with `hfb fit`") from None
