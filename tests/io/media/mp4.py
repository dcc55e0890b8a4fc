"""MP4 files changed as cameras and telephones write them: matrices, edit lists, colours, entries of makers."""

import struct
from pathlib import Path

ONE = 0x10000


def with_matrix(path: Path, source: Path, matrix: tuple[int, int, int, int]) -> Path:
    """The first track shown by the matrix (a, b, c, d)."""
    data, (a, b, c, d) = bytearray(source.read_bytes()), (ONE * one for one in matrix)
    struct.pack_into(">9i", data, data.index(b"tkhd") + 44, a, b, 0, c, d, 0, 0, 0, 0x40000000)
    path.write_bytes(data)
    return path


def with_box(path: Path, source: Path, parents: list[bytes], kind: bytes, content: bytes) -> Path:
    """A box put at the end of the innermost of `parents`, which lie in each other, after the file's pixels."""
    data = bytearray(source.read_bytes())
    assert data.index(b"moov") > data.index(b"mdat"), "offsets of what lies behind would move"
    box = struct.pack(">I4s", len(content) + 8, kind) + content
    places, at = [], 0
    for parent in parents:
        at = data.index(parent, at) - 4
        places.append(at)
    if places:
        end = places[-1] + struct.unpack_from(">I", data, places[-1])[0]
        for place in places:
            struct.pack_into(">I", data, place, struct.unpack_from(">I", data, place)[0] + len(box))
    else:
        end = len(data)
    data[end:end] = box
    path.write_bytes(data)
    return path


def with_colours(path: Path, source: Path, entry: bytes, tags: tuple[int, int, int], full: bool = False) -> Path:
    """A `colr` box of primaries, transfer and matrix in the sample entry of this kind."""
    content = b"nclx" + struct.pack(">3HB", *tags, 0x80 * full)
    return with_box(path, source, [b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", entry], b"colr", content)


def with_edits(path: Path, source: Path, edits: list[tuple[int, int, float]]) -> Path:
    """The track's list of edits: (duration in milliseconds, media time in ticks, speed)."""
    data = source.read_bytes()
    at = data.index(b"edts") - 4
    size = struct.unpack_from(">I", data, at)[0]
    entries = b"".join(struct.pack(">Iii", *edit[:2], round(edit[2] * ONE)) for edit in edits)
    elst = struct.pack(">I4sII", 16 + len(entries), b"elst", 0, len(edits)) + entries
    edts = struct.pack(">I4s", 8 + len(elst), b"edts") + elst
    changed = bytearray(data[:at] + edts + data[at + size :])
    for parent in (b"moov", b"trak"):
        place = changed.index(parent) - 4
        struct.pack_into(">I", changed, place, struct.unpack_from(">I", changed, place)[0] + len(edts) - size)
    path.write_bytes(changed)
    return path
