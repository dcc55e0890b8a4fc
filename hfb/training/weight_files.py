"""Files of weights: read as trained or as shipped, written with their story beside them."""

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
    """Weights in single precision, of a .safetensors file or a checkpoint (.pt).

    Raises:
        InputError: the file is missing or something else.
    """
    try:
        found = load_file(path) if path.suffix == ".safetensors" else torch.load(path, weights_only=True)
        return {name: values.float() if values.is_floating_point() else values for name, values in found.items()}
    except Exception as error:
        raise InputError(f"{path} holds no weights ({error}); give the .pt or .safetensors of a training") from error


def half(state: State) -> dict[str, torch.Tensor]:
    """Weights in half precision, by name."""
    return {name: values.half().contiguous() for name, values in sorted(state.items())}


def read_story(path: Path) -> dict[str, Any]:
    """The facts that a training or an earlier export left.

    Raises:
        InputError: they are missing or damaged.
    """
    try:
        story: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}); give the folder of a finished training") from error
    return story


def count_parameters(network: nn.Module) -> int:
    """How many numbers a network learns."""
    return sum(weights.numel() for weights in network.parameters())


def publish(folder: Path, name: str, state: State, parameters: int, about: Mapping[str, Any]) -> None:
    """Write NAME.safetensors and NAME.json: first what identifies the weights, then ``about``.

    Args:
        folder: made where missing.
        name: of both files, without ending.
        state: written as it is.
        parameters: how many numbers were learned.
        about: what made the weights, and what they can.
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
    """Write a checkpoint whole or not at all."""
    part = path.with_suffix(".part")
    torch.save(dict(state), part)
    part.replace(path)
