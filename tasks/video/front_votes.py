"""Votes of a clip's windows on which way the person faces."""

from collections.abc import Sequence

from hfb.fitting.front_choice import front_probability
from hfb.tasks.core.handles import FrontRecord
from hfb.tasks.core.video_handles import WindowHandle


def weigh_segments(fits: Sequence[WindowHandle]) -> dict[int, FrontRecord]:
    """Return which way the person faces, per segment of a clip.

    People do not turn around unseen within a segment, and its first bodies agree: what its windows say adds up.

    Args:
        fits: windows that were fitted without a person; a segment whose windows were sure is left out.
    """
    fronts = {}
    for segment in sorted({one.segment for one in fits if one.front_log_odds}):
        of_segment = [one for one in fits if one.segment == segment]
        log_odds = sum(one.front_log_odds for one in of_segment)
        fronts[segment] = FrontRecord(
            probability=round(front_probability(log_odds), 4),
            mirrored=log_odds < 0,
            turn_deg=round(max(one.front_turn_deg for one in of_segment), 1),
        )
    return fronts
