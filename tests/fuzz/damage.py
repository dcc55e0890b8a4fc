"""Damage done to whole files: blind (bits, cuts, splices) and knowing (headers, members, numbers, hostile pickles).

A case is a function of the campaign's seed and its own number: nothing else decides what is damaged, or how.
"""

import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tests.fuzz.hostile import archive, hostile
from tests.fuzz.seeds import Seed

Random = np.random.Generator

_TEXTS = {"clip", "options", "chains", "recipe", "ledger", "own result", "case", "facts", "curves"}
_TEXT_SUFFIXES = (".toml", ".json", ".csv", ".yaml", ".xml", ".bvh", ".trc")
_EDGES = (
    0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1,
)  # fmt: skip
_ABSURD = (
    np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 5e-324, 0, -1, 1, 1e4, 1e5, 3333, 1e9, -1e9, 2**31, 2**62, 1e18,
)  # fmt: skip
_NUMBERS = (
    b"nan",
    b"inf",
    b"-inf",
    b"1e999",
    b"-1",
    b"0",
    b"99999999999999999999",
    b"1e300",
    b"''",
    b"9" * 5000,
    b"1" * 400,
)
_WORDS = (
    b"../../../etc/passwd",
    b"/etc/passwd",
    b"a\\u0000b",
    b"",
    b"x" * 5000,
    b"\xff\xfe",
    b"http://127.0.0.1:9/x",
    b"__import__('os')",
    b"\xf0\x9f\x92\xa3",
)


@dataclass(frozen=True)
class Case:
    """One damaged file. Attributes: how: which damage, for the report."""

    kind: str
    name: str
    how: str
    data: bytes


def make_case(seeds: Sequence[Seed], campaign: int, number: int) -> Case:
    """The damaged file of a number."""
    rng = np.random.default_rng([campaign, number])
    seed = seeds[rng.integers(len(seeds))]
    ways = _ways(seed, seeds)
    done = []
    data = seed.data
    for _ in range(1 if rng.random() < 0.7 else 2):
        how = list(ways)[rng.integers(len(ways))]
        data = ways[how](data, rng)
        done.append(how)
    return Case(seed.kind, seed.name, "+".join(done), data)


def _ways(seed: Seed, seeds: Sequence[Seed]) -> dict[str, Callable[[bytes, Random], bytes]]:
    alike = [other.data for other in seeds if other.kind == seed.kind]
    ways: dict[str, Callable[[bytes, Random], bytes]] = {
        "bits": _flip,
        "bytes": _overwrite,
        "truncated": _truncate,
        "cut": _cut,
        "doubled": _double,
        "inserted": _insert,
        "header": _header,
        "spliced": lambda data, rng: _splice(data, alike[rng.integers(len(alike))], rng),
        "another": lambda data, rng: _splice(data, seeds[rng.integers(len(seeds))].data, rng),
        "hostile": lambda _, rng: hostile(seed.name, rng),
    }
    if seed.data[:2] == b"PK":
        ways |= {"member": _member, "member again": _member, "zip sizes": _zip_sizes}
    if seed.name.endswith(_TEXT_SUFFIXES) or seed.kind in _TEXTS:
        ways |= {"number": _number, "word": _word, "line": _line, "deep": _deep}
    if seed.name.endswith(".png"):
        ways |= {"png chunk": _png_chunk}
    if seed.name.endswith(".safetensors"):
        ways |= {"tensor header": _tensor_header}
    return ways


def _flip(data: bytes, rng: Random) -> bytes:
    content = bytearray(data)
    for place in rng.integers(0, max(len(content), 1), rng.integers(1, 17)):
        if content:
            content[place] ^= 1 << rng.integers(8)
    return bytes(content)


def _overwrite(data: bytes, rng: Random) -> bytes:
    content = bytearray(data)
    for place in rng.integers(0, max(len(content), 1), rng.integers(1, 65)):
        if content:
            content[place] = (0, 0xFF, 0x7F, 0x80, int(rng.integers(256)))[rng.integers(5)]
    return bytes(content)


def _truncate(data: bytes, rng: Random) -> bytes:
    return data[: rng.integers(0, len(data) + 1)]


def _span(data: bytes, rng: Random) -> tuple[int, int]:
    start = int(rng.integers(0, len(data) + 1))
    return start, min(len(data), start + int(rng.integers(1, max(2, min(4096, len(data))))))


def _cut(data: bytes, rng: Random) -> bytes:
    start, stop = _span(data, rng)
    return data[:start] + data[stop:]


def _double(data: bytes, rng: Random) -> bytes:
    start, stop = _span(data, rng)
    return data[:stop] + data[start:stop] * int(rng.integers(1, 9)) + data[stop:]


def _insert(data: bytes, rng: Random) -> bytes:
    start, _ = _span(data, rng)
    return data[:start] + rng.bytes(int(rng.integers(1, 257))) + data[start:]


def _splice(data: bytes, other: bytes, rng: Random) -> bytes:
    return data[: rng.integers(0, len(data) + 1)] + other[rng.integers(0, len(other) + 1) :]


def _header(data: bytes, rng: Random) -> bytes:
    """A number near the beginning or the end, where sizes stand, becomes an extreme one."""
    width, order = int(rng.choice([1, 2, 4, 8])), "<>"[rng.integers(2)]
    near = min(len(data), 512)
    place = int(rng.integers(0, near + 1)) if rng.random() < 0.7 else len(data) - int(rng.integers(0, near + 1))
    value = _EDGES[rng.integers(len(_EDGES))] & ((1 << 8 * width) - 1)
    field = struct.pack(order + {1: "B", 2: "H", 4: "I", 8: "Q"}[width], value)
    return data[:place] + field + data[place + width :]


def _zip_sizes(data: bytes, rng: Random) -> bytes:
    """The directory of an archive lies about a member."""
    content, places = bytearray(data), [found.start() for found in re.finditer(b"PK\x01\x02", data)]
    if places:
        place = places[rng.integers(len(places))]
        field, width = ((8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (30, 2), (42, 4))[rng.integers(8)]
        value = _EDGES[rng.integers(len(_EDGES))] & ((1 << 8 * width) - 1)
        content[place + field : place + field + width] = value.to_bytes(width, "little")
    return bytes(content)


def _member(data: bytes, rng: Random) -> bytes:
    """A whole archive again with one member damaged: its checksum is right."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            members = {info.filename: packed.read(info) for info in packed.infolist()}
    except Exception:  # damaged before
        return _flip(data, rng)
    names = sorted(members)
    name = names[rng.integers(len(names))]
    ways = (_flip, _truncate, _header, _array_header, _array_header, _double, _absurd, _absurd, _absurd)
    members[name] = ways[rng.integers(len(ways))](members[name], rng)
    return archive(members.items())


def _array_header(data: bytes, rng: Random) -> bytes:
    """Another shape, type or order in the header of a .npy file, whose length stays right."""
    if data[:6] != b"\x93NUMPY" or len(data) < 12:
        return _flip(data, rng)
    length = int.from_bytes(data[8:10], "little")
    text, body = data[10 : 10 + length], data[10 + length :]
    shapes = (
        b"(1000000000000,)",
        b"(-1,)",
        b"(0, 99999999999)",
        b"()",
        b"(1000000, 1000000)",
        b"(3, 24, 3)",
        b"(True,)",
    )
    kinds = (
        b"'<f8'",
        b"'|O'",
        b"'<U100000000'",
        b"'|V0'",
        b"'<c16'",
        b"'<M8[s]'",
        b"[('a', '<f8')]",
        b"'>i2'",
        b"'|S0'",
    )
    what = rng.integers(4)
    if what == 0:
        text = re.sub(rb"\([^)]*\)", shapes[rng.integers(len(shapes))], text, count=1)
    elif what == 1:
        text = re.sub(rb"'descr': '[^']*'", b"'descr': " + kinds[rng.integers(len(kinds))], text, count=1)
    elif what == 2:
        text = text.replace(b"False", b"True")
    else:
        text = b"{" * 200 + text if rng.random() < 0.5 else text[: rng.integers(0, len(text) + 1)]
    text = text.rstrip() + b"\n"
    return data[:8] + len(text).to_bytes(2, "little") + text + body


def _absurd(data: bytes, rng: Random) -> bytes:
    """Numbers that nothing can be, or a leap from some row on, in a .npy file that is otherwise whole."""
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
        flat = array.copy().reshape(-1)
        value = _ABSURD[rng.integers(len(_ABSURD))]
        first = int(rng.integers(0, len(flat)))
        with np.errstate(all="ignore"):
            value = np.array(value).astype(array.dtype)
            what = rng.integers(4)
            if what == 0:
                flat[:] = value
            elif what == 1:
                flat[first] = value
            elif what == 2:
                flat[first:] += value
            else:
                flat = flat[rng.permutation(len(flat))]
    except Exception:  # damaged before, or texts
        return _flip(data, rng)
    stream = io.BytesIO()
    np.save(stream, flat.reshape(array.shape), allow_pickle=False)
    return stream.getvalue()


def _number(data: bytes, rng: Random) -> bytes:
    places = [found.span() for found in re.finditer(rb"-?\d+\.?\d*", data)]
    return _replaced(data, places, _NUMBERS, rng)


def _word(data: bytes, rng: Random) -> bytes:
    places = [found.span(1) for found in re.finditer(rb'"([^"\n]*)"', data)] or [
        found.span() for found in re.finditer(rb"[A-Za-z_]+", data)
    ]
    return _replaced(data, places, _WORDS, rng)


def _replaced(data: bytes, places: Sequence[tuple[int, int]], by: Sequence[bytes], rng: Random) -> bytes:
    if not places:
        return _flip(data, rng)
    start, stop = places[rng.integers(len(places))]
    return data[:start] + by[rng.integers(len(by))] + data[stop:]


def _line(data: bytes, rng: Random) -> bytes:
    """Lines change places, are doubled or lost."""
    lines = data.split(b"\n")
    first, second = rng.integers(0, len(lines), 2)
    what = rng.integers(3)
    if what == 0:
        lines[first], lines[second] = lines[second], lines[first]
    elif what == 1:
        lines.insert(first, lines[second])
    else:
        del lines[first]
    return b"\n".join(lines)


def _deep(data: bytes, rng: Random) -> bytes:
    """Brackets within brackets."""
    depth, pair = (
        int(rng.choice([50, 2000, 100_000])),
        ((b"[", b"]"), (b'{"a":', b"}"), (b"{a=", b"}"))[rng.integers(3)],
    )
    nested = pair[0] * depth + b"1" + pair[1] * depth
    places = [found.span() for found in re.finditer(rb"-?\d+\.?\d*", data)]
    if not places or rng.random() < 0.3:
        return b"a = " + nested if rng.random() < 0.5 else nested
    start, stop = places[rng.integers(len(places))]
    return data[:start] + nested + data[stop:]


def _png_chunk(data: bytes, rng: Random) -> bytes:
    """One number of the picture's header, or bytes of another chunk; the checksum is right."""
    chunks, place = [], 8
    while place + 12 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += 12 + length
    if not chunks:
        return _flip(data, rng)
    number = int(rng.integers(len(chunks))) if rng.random() < 0.5 else 0
    kind, body = chunks[number]
    chunks[number] = (kind, (_header, _flip, _truncate)[rng.integers(3)](body, rng))
    return data[:8] + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )


def _tensor_header(data: bytes, rng: Random) -> bytes:
    """Another shape, type or place of a tensor in the header of a .safetensors file, whose length stays right."""
    length = int.from_bytes(data[:8], "little")
    try:
        head = json.loads(data[8 : 8 + length])
        names = [name for name in head if name != "__metadata__"]
        one = head[names[rng.integers(len(names))]]
    except (ValueError, IndexError, TypeError):
        return _flip(data, rng)
    changes: tuple[tuple[str, object], ...] = (
        ("shape", [1 << 40]),
        ("shape", [-1]),
        ("shape", []),
        ("shape", [0, 1 << 62]),
        ("dtype", "F64"),
        ("data_offsets", [0, 1 << 50]),
        ("data_offsets", [10, 2]),
        ("data_offsets", [0]),
        ("dtype", "BOOL"),
        ("dtype", "X9"),
    )
    key, value = changes[rng.integers(len(changes))]
    if isinstance(one, dict):
        one[key] = value
    text = json.dumps(head).encode()
    return len(text).to_bytes(8, "little") + text + data[8 + length :]
