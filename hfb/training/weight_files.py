"""Files of weights: read as trained or as shipped, written with their provenance."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save
from torch import nn

from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic

State = Mapping[str, torch.Tensor]


def read_weights(path: Path) -> dict[str, torch.Tensor]:
    """Read weights in single precision from a .safetensors file or a checkpoint (.pt).

    Args:
        path: the file.

    Raises:
        InputError: the file is missing or holds no weights.
    """
    try:
        found = load_file(path) if path.suffix == ".safetensors" else torch.load(path, weights_only=True)
        return {name: values.float() if values.is_floating_point() else values for name, values in found.items()}
    except Exception as error:
        raise InputError(f"{path} holds no weights ({error}); give the .pt or .safetensors of a training") from error


def half(state: State) -> dict[str, torch.Tensor]:
    """Return weights in half precision, sorted by name.

    Args:
        state: weights by name.
    """
    return {name: values.half().contiguous() for name, values in sorted(state.items())}


def read_story(path: Path) -> dict[str, Any]:
    """Read the facts that a training or an earlier export left.

    Args:
        path: a JSON file.

    Raises:
        InputError: they are missing or damaged.
    """
    try:
        story: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}); give the folder of a finished training") from error
    return story


def count_parameters(network: nn.Module) -> int:
    """Return the number of trainable parameters.

    Args:
        network: any module.
    """
    return sum(weights.numel() for weights in network.parameters())


def publish(folder: Path, name: str, state: State, parameters: int, about: Mapping[str, Any]) -> None:
    """Write NAME.safetensors and NAME.json: first what identifies the weights, then ``about``.

    Args:
        folder: made where missing.
        name: of both files, without ending.
        state: written as it is.
        parameters: number of trained parameters.
        about: provenance and measurements.
    """
    content = save(dict(state))
    folder.mkdir(parents=True, exist_ok=True)
    facts = {
        "weights": f"{name}.safetensors",
        "sha256": hashlib.sha256(content).hexdigest(),
        "parameters": parameters,
    }
    write_bytes_atomic(folder / f"{name}.safetensors", content)
    write_bytes_atomic(folder / f"{name}.json", json.dumps(facts | dict(about), indent=1).encode() + b"\n")


def write_checkpoint(path: Path, state: State) -> None:
    """Write a checkpoint atomically.

    Args:
        path: the file.
        state: weights by name.
    """
    part = path.with_suffix(".part")
    torch.save(dict(state), part)
    part.replace(path)
