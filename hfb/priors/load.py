"""Loading of pose priors; no code in a user's file is run."""

import zipfile
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from safetensors.torch import load_file
from torch.serialization import get_unsafe_globals_in_checkpoint, safe_globals

from hfb.errors import InputError
from hfb.io.array_files import UNPACKED_LIMIT, read_arrays, weights_file
from hfb.io.safe.pickle_reader import load_pickle
from hfb.io.safe.pickled_arrays import to_array
from hfb.priors.anatomy import AnatomicalPrior
from hfb.priors.gmm import GmmPrior
from hfb.priors.mixture import LIMITS_KEY, MixturePrior, shipped_mixture
from hfb.priors.pose import PosePrior
from hfb.priors.vposer import VPoserPrior
from hfb.typing import Array, Float

_ACCEPTED = (
    "give SMPLify's gmm_08.pkl, a VPoser v1 or v2 snapshot (.pt, .ckpt, .safetensors or .npz) or a pose mixture of "
    "`hfb train-prior`"
)
# What a torch file from before the zip format begins with: a pickled magic number.
_LEGACY_TORCH = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."


def load_pose_prior(path: Path | None, kind: Literal["anatomy", "mixture"] = "anatomy") -> PosePrior:
    """Load a built-in prior, or a user's file, whose kind is determined by its content.

    Args:
        path: SMPLify's mixture, a VPoser checkpoint, or a mixture of `hfb train-prior`.
        kind: which of the built-in priors, where no file is given.

    Raises:
        InputError: no such file, or neither of these.
    """
    if path is None:
        return shipped_mixture() if kind == "mixture" else AnatomicalPrior()
    if not path.is_file():
        raise InputError(f"{path}: no such file with a pose prior; {_ACCEPTED}, or nothing for the built-in one")
    contents = _read(path)
    covariances = contents.get("covars", contents.get("covariances"))
    if "means" in contents and "weights" in contents and covariances is not None:
        means, weights = _numbers(contents["means"], path), _numbers(contents["weights"], path)
        mixture = MixturePrior if LIMITS_KEY in contents else GmmPrior
        return mixture(means, _numbers(covariances, path), weights, str(path))
    state = {name: torch.from_numpy(_numbers(value, path)) for name, value in contents.items()}
    return VPoserPrior.from_state(state, str(path))


def _numbers(values: object, path: Path) -> Float[Array, "..."]:
    """Return an array, a tensor or what stands for an array in a pickle, as float64."""
    if isinstance(values, torch.Tensor):
        return values.detach().cpu().double().numpy()
    try:
        return np.asarray(values if isinstance(values, np.ndarray) else to_array(values), dtype=np.float64)
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{path}: holds something other than numbers; {_ACCEPTED}") from error


def _read(path: Path) -> Mapping[str, object]:
    """Read a file's arrays by name, whatever its container."""
    if path.stat().st_size > UNPACKED_LIMIT:
        raise InputError(f"{path}: is larger than {UNPACKED_LIMIT >> 20} MB, no pose prior is; {_ACCEPTED}")
    with path.open("rb") as file:
        head = file.read(32)
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                is_torch = any(name.endswith("data.pkl") for name in archive.namelist())
            return _read_torch(path) if is_torch else read_arrays(path)
        if head.startswith(_LEGACY_TORCH):
            return _read_torch(path)
        if head[8:9] == b"{":
            return load_file(path)
    except InputError:
        raise
    except Exception as error:  # damaged files make these readers raise nearly anything
        raise InputError(f"{path}: this file is damaged, or holds more than arrays; {_ACCEPTED}") from error
    return _read_pickle(path)


class _Ignored:
    """Stands for other content of a training run's checkpoint; holds state, runs nothing."""

    def __new__(cls, *_args: object, **_kwargs: object) -> OrderedDict:  # type: ignore[misc]
        return OrderedDict()


def _read_torch(path: Path) -> Mapping[str, object]:
    """Read the tensors of a checkpoint, by torch's own restricted reader.

    VPoser v2 comes as a Lightning checkpoint with objects of its training run in it: their classes are replaced by
    `_Ignored` instead of being imported.
    """
    try:
        file = weights_file(path)
    except ValueError as error:
        raise InputError(f"{path}: {error}; {_ACCEPTED}") from error
    unknown = get_unsafe_globals_in_checkpoint(file) if zipfile.is_zipfile(path) else []
    file.seek(0)
    with safe_globals([(_Ignored, name) for name in unknown]):
        loaded = torch.load(file, map_location="cpu", weights_only=True)
    state = loaded.get("state_dict", loaded) if isinstance(loaded, dict) else {}
    return {str(name): value for name, value in state.items() if isinstance(value, torch.Tensor)}


def _read_pickle(path: Path) -> Mapping[str, object]:
    """Read the named arrays of SMPLify's mixture as placeholders."""
    try:
        fields = load_pickle(path.read_bytes())
    except InputError as error:
        raise InputError(
            f"{path}: {error}; {_ACCEPTED}. A mixture pickled as a scikit-learn object has to be saved where you trust "
            "it as numpy.savez(file, means=g.means_, covars=g.covars_, weights=g.weights_)"
        ) from error
    return {str(name): value for name, value in fields.items()} if isinstance(fields, dict) else {}
