"""Colours of a video by its frames' tags, its container's, or the convention of players."""

from collections.abc import Iterator

import av

from hfb.errors import InputError

Stated = tuple[int, int, int, int]
"""(matrix, range, transfer, primaries) as the container states them, by ITU-T H.273 and FFmpeg's `AVColorRange`."""

NOT_STATED: Stated = (2, 0, 2, 2)
_BT709, _BT601 = 1, 5  # ITU-T H.273, matrix coefficients
_UNTAGGED = (0, 2)  # 0 is RGB's, which is no statement about luma and chroma
_MOST_LINES_OF_SD = 576
_HDR = {16: "PQ", 18: "HLG"}  # ITU-T H.273, transfer characteristics
_LINEAR = 8
_WIDE = {9: "BT.2020", 11: "DCI-P3", 12: "Display P3"}  # ITU-T H.273, colour primaries


def stated_colours(stream: av.VideoStream) -> Stated:
    """Return the container's own statement (`colr` of MP4, `Colour` of Matroska), which decoders do not pass on.

    Call it before the first frame is decoded, which overwrites it.

    Args:
        stream: stream of the video.
    """
    codec = stream.codec_context
    return int(codec.colorspace), int(codec.color_range), int(codec.color_trc), int(codec.color_primaries)


def source_colours(frame: av.VideoFrame, stated: Stated) -> tuple[int | None, int | None]:
    """Return the (matrix, range) to decode a frame with; None where the frame states it, or has no such thing.

    Players treat untagged video as BT.709 above 576 lines and as BT.601 below; swscale alone treats all as BT.601.

    Args:
        frame: decoded.
        stated: the container's statement, by `stated_colours`.
    """
    matrix = color_range = None
    if is_yuv(frame) and int(frame.colorspace) in _UNTAGGED:
        usual = _BT709 if frame.height > _MOST_LINES_OF_SD else _BT601
        matrix = usual if stated[0] in _UNTAGGED else stated[0]
    if int(frame.color_range) == 0 and stated[1]:
        color_range = stated[1]
    return matrix, color_range


def is_yuv(frame: av.VideoFrame) -> bool:
    """Return whether a frame's planes are luma and chroma.

    Args:
        frame: decoded.
    """
    return not frame.format.is_rgb and len(frame.format.components) >= 3 and frame.format.name != "pal8"


def refuse_hdr(frame: av.VideoFrame, stated: Stated, name: str) -> None:
    """Refuse high dynamic range, whether the frames or only the container state it.

    Args:
        frame: decoded.
        stated: the container's statement, by `stated_colours`.
        name: name of the video.

    Raises:
        InputError: the video is of high dynamic range.
    """
    transfers = {int(frame.color_trc), stated[2]}
    kinds = [kind for code, kind in _HDR.items() if code in transfers]
    if not kinds and "DOVI_METADATA" in frame.side_data:
        kinds = ["Dolby Vision"]
    if kinds:
        raise InputError(f"{name}: is high dynamic range video ({kinds[0]}); convert it to BT.709 first.")


def colour_remarks(frame: av.VideoFrame, stated: Stated, name: str) -> Iterator[str]:
    """Yield remarks on how the colours are interpreted.

    Args:
        frame: decoded.
        stated: the container's statement, by `stated_colours`.
        name: name of the video.
    """
    tags = int(frame.colorspace), stated[0]
    if is_yuv(frame) and all(tag in _UNTAGGED for tag in tags) and frame.height > _MOST_LINES_OF_SD:
        yield f"{name} does not say how its colours are stored: decoded as BT.709, as players do above 576 lines"
    if _LINEAR in (int(frame.color_trc), stated[2]):
        yield f'{name} says that it stores linear light: give transfer = "linear" in clip.toml if that is so'
    wide = _WIDE.get(int(frame.color_primaries)) or _WIDE.get(stated[3])
    if wide:
        yield f"{name} has the colours of {wide}: they are taken as sRGB's, so a plate from a file must be stored alike"
