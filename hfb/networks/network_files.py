"""Recognition of a network file by its first bytes and its archive's contents, without torch."""

import zipfile
from pathlib import Path

from hfb.errors import InputError

MOST_CODE_BYTES = 64 << 20
_OLDER_TORCH = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19"
_ONNX = b"\x08"  # the version of the format, an ONNX file's first field


def is_onnx(path: Path) -> bool:
    """Return whether a file is named like an ONNX network.

    Args:
        path: the network's file.
    """
    return path.suffix.lower() == ".onnx"


def check_network_file(path: Path, weights_too: bool = False) -> None:
    """Refuse what is certainly no network, without reading all of it.

    Args:
        path: the network's file.
        weights_too: plain weights will do, since we know the network that they belong to.

    Raises:
        InputError: it is not there, or neither ONNX nor TorchScript nor, where they will do, weights.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a TorchScript or ONNX network")
    if is_onnx(path):
        with path.open("rb") as file:
            if file.read(1) != _ONNX:
                raise InputError(f"{path} is no ONNX network: its first byte is not one's; export it again")
    elif not (weights_too and holds_weights(path)):
        check_torchscript(path)


def holds_weights(path: Path) -> bool:
    """Return whether a file of torch.save is no executable network: weights, or a pickled model.

    Args:
        path: the network's file.
    """
    if not path.is_file() or is_onnx(path):
        return False
    try:
        members = _members(path)
    except Exception:  # no archive, or a broken one
        with path.open("rb") as file:
            return file.read(len(_OLDER_TORCH)) == _OLDER_TORCH
    return "data.pkl" in members and not any(name.startswith("code/") for name in members)


def check_torchscript(path: Path) -> None:
    """Check that a file is TorchScript: an archive with code, which a state dict or a pickled model lacks.

    Args:
        path: the network's file.

    Raises:
        InputError: something else, or one that unpacks to more than it has: torch packs the code alone.
    """
    advice = "export it with torch.jit.trace(model, example).save(FILE), or as ONNX"
    try:
        members, packed = _members(path), _packed(path)
    except Exception:  # see `holds_weights`
        raise InputError(f"{path} is a plain pickle or no network; for safety none is opened: {advice}") from None
    if "constants.pkl" not in members or not any(name.startswith("code/") for name in members):
        raise InputError(f"{path} holds weights or a pickled model but no network that runs by itself: {advice}")
    if any(not name.startswith("code/") for name in packed) or sum(packed.values()) > MOST_CODE_BYTES:
        raise InputError(f"{path} cannot be used: its contents are compressed, as torch never does: {advice}")


def _packed(path: Path) -> dict[str, int]:
    """Return the compressed members of an archive, and what they unpack to [bytes]."""
    with zipfile.ZipFile(path) as archive:
        found = [info for info in archive.infolist() if info.compress_type != zipfile.ZIP_STORED]
    return {info.filename.partition("/")[2]: info.file_size for info in found}


def _members(path: Path) -> set[str]:
    with zipfile.ZipFile(path) as archive:
        return {name.partition("/")[2] for name in archive.namelist()}
