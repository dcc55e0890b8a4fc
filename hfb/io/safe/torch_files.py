"""Files of torch.save, zipped or of the older kind, read without torch and without running their pickles."""

import io
import zipfile
from typing import Any

from hfb.errors import InputError
from hfb.io.array_files import UNPACKED_LIMIT
from hfb.io.safe.pickle_stream import Bytes, Steps
from hfb.io.safe.pickles import load_from
from hfb.io.safe.placeholders import TorchStorage

_MAGIC = 0x1950A86A20F9469CFC6C
_ITEM_BYTES = {"bf2": 2}


def load_torch(data: bytes, steps: Steps | None = None) -> Any:
    """Read a file of torch.save, with placeholders for tensors (see `hfb.io.safe.pickled_arrays.to_array`).

    Args:
        data: content of the file.
        steps: limit of the work, shared where it is a part of a file.

    Raises:
        InputError: no such file, a damaged one, or one whose pickle names anything but tensors; the text continues
            "FILE cannot be used: ".
    """
    steps = Steps(len(data)) if steps is None else steps
    return _zipped(data, steps) if data[:2] == b"PK" else _older(data, steps)


def looks_like_torch(data: bytes) -> bool:
    """Return whether a file that is no archive begins like torch.save's older files.

    Args:
        data: content of the file.
    """
    return data[:14] in (b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19", b"\x80\x03\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19")


def _zipped(data: bytes, steps: Steps) -> Any:
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        members = {info.filename: info for info in archive.infolist()}
        program = next(name for name in members if name.endswith("/data.pkl") or name == "data.pkl")
    except Exception as error:  # a broken archive makes zipfile raise nearly anything
        raise InputError("it is not a readable file of torch") from error
    if sum(info.file_size for info in members.values()) > UNPACKED_LIMIT:
        raise InputError(f"unpacked it would be larger than {UNPACKED_LIMIT >> 20} MB")
    folder = program.removesuffix("data.pkl")

    def read(name: str) -> bytes:
        try:
            with archive.open(members[name]) as member:
                return member.read(members[name].file_size)
        except KeyError as error:
            raise InputError("it is damaged: numbers of a tensor are missing") from error
        except Exception as error:  # a broken stream makes the unpackers raise their own kinds
            raise InputError(f"it is damaged ({type(error).__name__})") from error

    storages: dict[str, TorchStorage] = {}

    def outside(reference: Any) -> TorchStorage:
        kind, key, count = _reference(reference)
        if key not in storages:
            storages[key] = _filled(kind, read(f"{folder}data/{key}"), count)
        return storages[key]

    return load_from(Bytes(read(program), steps), load_torch, outside)


def _older(data: bytes, steps: Steps) -> Any:
    """Read four pickles (a number, a version, a machine, the content), the storages' names, and their numbers."""
    stream = Bytes(data, steps)
    if load_from(stream, load_torch) != _MAGIC:
        raise InputError("it is not a readable file of torch")
    load_from(stream, load_torch)
    machine = load_from(stream, load_torch)
    if isinstance(machine, dict) and machine.get("little_endian") is False:
        raise InputError("it was written on a machine of the other byte order")
    storages: dict[str, tuple[TorchStorage, int]] = {}

    def outside(reference: Any) -> TorchStorage:
        kind, key, count = _reference(reference)
        storages.setdefault(key, (kind(), count))
        return storages[key][0]

    content = load_from(stream, load_torch, outside)
    names = load_from(stream, load_torch)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or set(names) != set(storages):
        raise InputError("it is damaged: its list of tensors is not that of its content")
    for name in names:
        storage, count = storages[name]
        if int.from_bytes(stream.read(8), "little") != count:
            raise InputError("it is damaged: a tensor has another size than it says")
        storage.data = stream.view(count * _item_bytes(storage.code))
    return content


def _reference(reference: Any) -> tuple[type[TorchStorage], str, int]:
    """Resolve ("storage", class, key, device, entries ...)."""
    if not isinstance(reference, tuple) or len(reference) < 5 or reference[0] not in ("storage", b"storage"):
        raise InputError("its pickle refers to something outside the file")
    kind, key, count = reference[1], reference[2], reference[4]
    if not isinstance(key, str):  # str() of a list may be endless
        raise InputError("it holds a tensor without a name")
    if not (isinstance(kind, type) and issubclass(kind, TorchStorage)) or not isinstance(count, int) or count < 0:
        raise InputError("it holds a tensor of things that are not numbers")
    return kind, key, count


def _filled(kind: type[TorchStorage], data: bytes, count: int) -> TorchStorage:
    if len(data) != count * _item_bytes(kind.code):
        raise InputError("it is damaged: a tensor has another size than it says")
    storage = kind()
    storage.data = data
    return storage


def _item_bytes(code: str) -> int:
    return _ITEM_BYTES.get(code) or int(code[1:])
