"""The rate at which a video was captured, where it differs from that of its time stamps: slow motion, time lapse."""

import re
import struct
from collections.abc import Mapping
from pathlib import Path

from hfb.io.media.mp4_boxes import boxes_of

Rate = tuple[float, str]
"""(frames per second, where it stands)."""

_KEYS = ("com.android.capture.fps", "capture_fps", "capturefps", "captureframerate")
_APPLE_INTENT = "com.apple.quicktime.full-frame-rate-playback-intent"
_LEAST_FPS, _MOST_FPS = 0.01, 1_000_000.0
_SAME_SHARE = 0.03
_UNIT = 0x10000  # 1.0 in fixed point 16.16


def stated_capture_rate(path: Path, metadata: Mapping[str, str]) -> Rate | None:
    """Read a file's capture rate: Android's entry, Sony's XML or GoPro's settings; None where there is none.

    Args:
        path: the video file.
        metadata: the container's and the stream's.
    """
    for name, text in sorted(metadata.items()):
        if name.lower() in _KEYS and (fps := _rate(text)):
            return fps, f"its entry {name}"
    for kind, content in boxes_of(path, (b"meta", b"xml "), (b"moov", b"meta", b"xml "), (b"moov", b"udta", b"GPMF")):
        fps = _gopro_rate(content) if kind == b"GPMF" else _sony_rate(content)
        if fps:
            return fps, "GoPro's settings in it" if kind == b"GPMF" else "its entry captureFps"
    return None


def differs(capture: Rate | None, stored_fps: float) -> bool:
    """Return whether the capture rate differs from that of the time stamps; cameras round theirs.

    Args:
        capture: the capture rate and its source.
        stored_fps: rate of the time stamps.
    """
    return capture is not None and abs(capture[0] / stored_fps - 1) > _SAME_SHARE


def capture_remark(name: str, capture: Rate, stored_fps: float) -> str:
    """Return the remark that a file's capture rate is used instead of its time stamps' rate.

    Args:
        name: name of the video.
        capture: the capture rate and its source.
        stored_fps: rate of the time stamps.
    """
    return (
        f"{name} was captured at {capture[0]:.6g} frames per second, by {capture[1]}, and plays at {stored_fps:.6g}: "
        "the capture's rate counts (fps in clip.toml or --exposure.fps, if that is not right)"
    )


def is_time_mapped(path: Path) -> bool:
    """Return whether an MP4's or MOV's edit list changes the speed of parts of it, as a telephone's slow motion does.

    FFmpeg treats every edit as one at full speed and repeats frames; the tracks' own time stamps are the camera's.

    Args:
        path: the video file.
    """
    for _, content in boxes_of(path, (b"moov", b"trak", b"edts", b"elst")):
        size, at = (20, 16) if content[:1] == b"\x01" else (12, 8)  # version, of 64 or 32 bits
        for start in range(8, len(content) - size + 1, size):
            speed = struct.unpack_from(">i", content, start + at)[0]
            if speed > 0 and abs(speed - _UNIT) > _UNIT * _SAME_SHARE:
                return True
    return False


def is_apple_slow_motion(metadata: Mapping[str, str]) -> bool:
    """Return whether an Apple telephone recorded it as slow motion; its time stamps are the camera's own.

    Args:
        metadata: the container's and the stream's.
    """
    return metadata.get(_APPLE_INTENT, "").strip() == "0"


def _rate(text: str) -> float | None:
    told = re.fullmatch(r"\s*(\d{1,9}(?:\.\d{1,9})?)(?:/(\d{1,9}))?\s*[pi]?\s*", text)
    if not told or (told[2] and not int(told[2])):
        return None
    fps = float(told[1]) / float(told[2] or 1)
    return fps if _LEAST_FPS <= fps <= _MOST_FPS else None


def _sony_rate(xml: bytes) -> float | None:
    told = re.search(rb"captureFps\s*=\s*[\"']([0-9./]{1,20}[pi]?)[\"']", xml)
    return _rate(told[1].decode("ascii")) if told else None


def _gopro_rate(settings: bytes) -> float | None:
    """Read VFPS of GoPro's key-length-value records: numerator and denominator."""
    at = settings.find(b"VFPS")
    if at < 0 or len(settings) < at + 8:
        return None
    kind, size, count = struct.unpack_from(">cBH", settings, at + 4)
    data = settings[at + 8 : at + 8 + size * count]
    letter = {b"L": "I", b"l": "i", b"S": "H", b"s": "h"}.get(kind)
    if letter is None or len(data) != size * count or len(data) != 2 * struct.calcsize(letter):
        return None
    numerator, denominator = struct.unpack(f">2{letter}", data)
    return _rate(f"{numerator}/{denominator}") if numerator > 0 and denominator > 0 else None
