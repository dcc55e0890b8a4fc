"""The file of a motion prior: D's and G's weights (safetensors, half precision) with the sizes of the networks."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from pydantic import ValidationError
from safetensors import safe_open
from safetensors.torch import save

from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.priors.motion_networks import Corrector, Discriminator
from hfb.priors.network_sizes import NetworkSizes

_KEY = "hfb.motion-prior"
_AGAIN = "give a file that `hfb train-prior` made, or nothing for the shipped prior"


def make_networks(sizes: NetworkSizes, dropout: float = 0.0) -> tuple[Discriminator, Corrector]:
    """Build networks of these sizes with new weights from torch's generator.

    Args:
        sizes: widths and layers.
        dropout: share of values.
    """
    return (
        Discriminator(sizes.discriminator_width, sizes.discriminator_depth, dropout),
        Corrector(sizes.corrector_width, sizes.corrector_depth, dropout),
    )


def write_networks(path: Path, discriminator: Discriminator, corrector: Corrector, sizes: NetworkSizes) -> None:
    """Write both, whole or not at all; the same weights make the same bytes.

    Args:
        path: the file.
        discriminator: trained.
        corrector: trained.
        sizes: widths and layers.
    """
    parts = {"discriminator": discriminator, "corrector": corrector}
    tensors = {
        f"{part}.{name}": value.detach().to(torch.float16).contiguous()
        for part, network in parts.items()
        for name, value in network.state_dict().items()
    }
    write_bytes_atomic(path, save(tensors, {_KEY: json.dumps(sizes.model_dump(), sort_keys=True)}))


def read_networks(path: Path) -> tuple[Discriminator, Corrector]:
    """Read what `write_networks` wrote; runs no code of the file.

    Args:
        path: the file.

    Raises:
        InputError: the file is missing, damaged, or holds something else.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file with a motion prior; {_AGAIN}")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118 (no mapping)
    except Exception as error:  # damaged files make this reader raise nearly anything
        raise InputError(f"{path}: this file is damaged, or no safetensors file; {_AGAIN}") from error
    sizes = _sizes(metadata, path)
    with torch.device("meta"):  # sizes that a file merely announces take no memory
        announced = sum(one.numel() for network in make_networks(sizes) for one in network.state_dict().values())
    if announced != sum(one.numel() for one in tensors.values()):
        raise InputError(f"{path}: this motion prior's weights do not fit its sizes; {_AGAIN}")
    networks = make_networks(sizes)
    for part, network in zip(("discriminator", "corrector"), networks, strict=True):
        state = {name.removeprefix(f"{part}."): one for name, one in tensors.items() if name.startswith(f"{part}.")}
        if not all(torch.isfinite(one).all() for one in state.values()):
            raise InputError(f"{path}: this motion prior has weights that are not finite; {_AGAIN}")
        try:
            network.load_state_dict(state)
        except RuntimeError as error:
            raise InputError(f"{path}: this motion prior's weights do not fit its sizes; {_AGAIN}") from error
    return networks


def _sizes(metadata: Mapping[str, Any], path: Path) -> NetworkSizes:
    try:
        return NetworkSizes.model_validate_json(metadata[_KEY])
    except (KeyError, ValidationError) as error:
        raise InputError(f"{path}: this file holds no motion prior; {_AGAIN}") from error
