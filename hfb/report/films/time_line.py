"""The time line below a film's image: open shutters and the current instant."""

import cv2
import numpy as np

from hfb.motion.sampled import SampledMotion
from hfb.typing import Array, Float

_HEIGHT_PX, _MARGIN_PX, _TEXT_PX = 30, 6, 250
_INK, _OPEN, _MARK = (40, 40, 40), (150, 150, 150), (217, 95, 2)
_SHOWN_FRAMES = 6
"""Exposures in view; of longer motions those around the instant."""


def draw_time_line(
    motion: SampledMotion, time_s: float, width: int, slow: float | None = None
) -> Float[Array, "30 X 3"]:
    """Draw open shutters as boxes, the current instant as a mark, and the sub-frame's number as text.

    Args:
        motion: fitted motion; its times and frame indices count.
        time_s: the current instant.
        width: width of the bar [px].
        slow: slow-motion factor to state; None to leave it out.
    """
    bar = np.full((_HEIGHT_PX, width, 3), 255, np.uint8)
    starts = np.flatnonzero(np.diff(motion.frame_index, prepend=-1))
    ends = np.append(starts[1:], len(motion.times_s)) - 1
    opens, closes = motion.times_s[starts], motion.times_s[ends]
    current = max(0, int(np.searchsorted(opens, time_s + 1e-9, side="right")) - 1)
    left = int(np.clip(current - _SHOWN_FRAMES // 2, 0, max(0, len(opens) - _SHOWN_FRAMES)))
    right = min(left + _SHOWN_FRAMES, len(opens)) - 1
    first, last = float(opens[left]), float(max(closes[right], time_s))
    room = width - _TEXT_PX - 2 * _MARGIN_PX

    def at(seconds: float) -> int:
        return _TEXT_PX + _MARGIN_PX + round(float((seconds - first) / max(last - first, 1e-9)) * max(room, 1))

    middle = _HEIGHT_PX // 2
    cv2.line(bar, (at(first), middle), (at(last), middle), _OPEN, 1)
    for number in range(left, right + 1):
        cv2.rectangle(
            bar, (at(float(opens[number])) + 1, middle - 5), (at(float(closes[number])) - 1, middle + 5), _OPEN, -1
        )
    cv2.rectangle(bar, (at(time_s) - 1, middle - 9), (at(time_s) + 1, middle + 9), _MARK, -1)
    rows = motion.times_s[starts[current] : ends[current] + 1]
    place = float(np.interp(time_s, rows, np.arange(1, len(rows) + 1)))
    text = f"sub-frame {place:.1f} of {len(rows)}" + (f", {slow:.0f}x slower" if slow else "")
    cv2.putText(bar, text, (4, middle + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _INK, 1, cv2.LINE_AA)
    return bar / np.float32(255)
