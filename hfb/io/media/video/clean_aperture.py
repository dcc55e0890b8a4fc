"""The clean aperture of an MP4 or MOV (`clap`, ISO/IEC 14496-12): the part of each stored frame that players show.

FFmpeg's decoders give whole frames, and PyAV does not pass on the crop that its demuxer reads.
"""

import struct
from fractions import Fraction
from io import BytesIO
from math import floor
from pathlib import Path

import av

from hfb.io.media.mp4_boxes import boxes_of, descend

Crop = tuple[int, int, int, int]
"""Rows at the top and bottom, columns at the left and right of a stored frame that are not shown."""

WHOLE: Crop = (0, 0, 0, 0)
_ENTRIES = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd")
_FIRST, _SIZE, _INNER = 8, 40, 94  # bytes of `stsd` up to its first entry, to that one's width and height, to its boxes


def clean_aperture(path: Path, stream: av.VideoStream) -> Crop:
    """Return the crop of a stream's frames; `WHOLE` where the file states none, or one that reaches outside the frame.

    Where the sample entry has another size than the decoder's frames, these are cropped already.

    Args:
        path: the video file.
        stream: stream of the video.
    """
    width, height = stream.codec_context.width, stream.codec_context.height
    for _, entries in boxes_of(path, _ENTRIES):
        if len(entries) >= _INNER and struct.unpack_from(">2H", entries, _SIZE) == (width, height):
            end = min(_FIRST + struct.unpack_from(">I", entries, _FIRST)[0], len(entries))
            try:
                for box in descend(BytesIO(entries), _INNER, end, (b"clap",), iter(range(len(entries)))):
                    numbers = struct.unpack(">4IiIiI", box[:32])
                    return (*_edges(height, *numbers[2:4], *numbers[6:]), *_edges(width, *numbers[:2], *numbers[4:6]))
            except (struct.error, ArithmeticError):
                continue
    return WHOLE


def _edges(size: int, shown: int, shown_over: int, offset: int, offset_over: int) -> tuple[int, int]:
    """Return the pixels before and after the shown part, rounded as FFmpeg does; raises ArithmeticError."""
    inside, middle = Fraction(shown, shown_over), Fraction(size, 2) + Fraction(offset, offset_over)
    first, last = middle - inside / 2, middle + inside / 2 - 1
    if not 0 <= first <= last <= size - 1:
        raise ArithmeticError("no part of the frame")
    return floor(first), size - 1 - floor(last)
