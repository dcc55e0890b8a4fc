"""Sections of table.md: pixels, depth, front and motion by method, camera and blur rate; errors by recording and K."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from hfb.evaluation.cells import Cell, is_start
from hfb.evaluation.table_text import TIED, UNKNOWN, blur_label, grid, interval, method_name, number, percent

_MOVEMENT = ("in_plane_px", "ray_depth_mm", "lean_deg", "motion_ratio")
_EXPLAINED = (
    "In plane: distance in the image without alignment. Depth: error along the ray after the roots are aligned. Lean: "
    "angle between the trunks in the vertical-depth plane. Front wrong: share of exposures whose heading is more than "
    "90 degrees off. Spin: largest error of the change of heading between neighbouring exposures. Motion: mean "
    "distance of both paths about their means. Motion ratio: that over a still body's, with its 95 % interval; 1 is "
    "no better than a still body. Better direction: the ratio in the better direction of time, which one exposure "
    "does not show. Path: length of the joints' paths relative to the root, over the true length."
)


def movement_tables(summary: Mapping[str, Any], oracles: Collection[str]) -> list[str]:
    """Return the sections on position, front and motion; none where no method has these errors.

    Args:
        summary: what `summarize` returns.
        oracles: methods that use the truth.
    """
    every = {name: both["all"] for name, both in summary["methods"].items()}
    if not any(cell.get(entry) is not None for cell in every.values() for entry in _MOVEMENT):
        return []
    spins = any(cell["spin_deg"] is not None for cell in every.values())
    starts = {name for name, cell in every.items() if is_start(cell)}
    bins = {
        blur_label(cell["blur"]): {name: both["bins"][index] for name, both in summary["methods"].items()}
        for index, cell in enumerate(summary["start"]["bins"])
        if cell["n"]
    }
    cameras = {one["camera"]: one["methods"] for one in summary.get("cameras", ())}

    def table(groups: Mapping[str, Mapping[str, Cell]], label: str | None) -> str:
        head, first = _columns(spins), [] if label is None else [label]
        rows = [
            [group, _shown(name, starts, oracles), *_figures(cell, spins)]
            for group, cells in groups.items()
            for name, cell in cells.items()
            if cell["n"]
        ]
        rows = [row[1:] for row in rows] if label is None else _said_once(rows)
        return grid([*first, "method", *head], rows, left=1 + len(first))

    parts = ["## Position, front and motion", _EXPLAINED, table({"": every}, None)]
    if cameras:
        parts += ["## The same by camera", table(cameras, "camera")]
    return [*parts, "## The same by blur rate", table(bins, "blur rate")]


def recording_tables(summary: Mapping[str, Any], oracles: Collection[str]) -> list[str]:
    """Return the sections with MPJPE and PA-MPJPE by recording, method and K; none without recordings.

    Args:
        summary: what `summarize` returns.
        oracles: methods that use the truth.
    """
    cells = summary.get("recordings", ())
    if not cells:
        return []
    averages = list(dict.fromkeys(one["average"] for one in cells))
    recordings = list(dict.fromkeys(one["recording"] for one in cells))
    starts = {name for name, both in summary["methods"].items() if is_start(both["all"])}
    header = ["recording", "method", *("all K" if one is None else f"K = {one}" for one in averages)]
    parts = ["## By recording and K", "Mean over cases [95 % interval; n]; no interval below 6 cases."]
    for title, entry, bounds, count in (
        ("MPJPE [mm] ↓", "mpjpe_mm", "mpjpe_ci95", "n_pose"),
        ("PA-MPJPE [mm] ↓", "pa_mpjpe_mm", "pa_mpjpe_ci95", "n_pa"),
    ):
        rows = []
        for recording in recordings:
            own = [one for one in cells if one["recording"] == recording]
            told = {"start": [one["start"] for one in own]} if not starts else {}
            told |= {name: [one["methods"][name] for one in own] for name in summary["methods"]}
            rows += [
                ["all" if recording is None else recording, _shown(name, starts, oracles)]
                + [_mean(cell, entry, bounds, count) for cell in row]
                for name, row in told.items()
            ]
        parts += [f"### {title}", grid(header, _said_once(rows), left=2)]
    return parts


def _said_once(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Leave a group's name in its first row only."""
    before = [None, *(row[0] for row in rows)]
    return [["" if row[0] == last else row[0], *row[1:]] for row, last in zip(rows, before, strict=False)]


def _mean(cell: Cell, entry: str, bounds: str, count: str) -> str:
    if cell[entry] is None:
        return UNKNOWN
    return number(cell[entry], 1) + (interval(cell[bounds], 0, cell[count]) or f" (n{TIED}{cell[count]})")


def _shown(name: str, starts: Collection[str], oracles: Collection[str]) -> str:
    return f"start ({name})" if name in starts else method_name(name, oracles)


def _columns(spins: bool) -> Sequence[str]:
    before = ["n", "MPJPE / PA [mm]", "in plane [px]", "depth [mm]", "lean [deg]", "front wrong"]
    after = ["motion [mm]", "still body's [mm]", "motion ratio", "better direction", "path", "matte IoU"]
    return [*before, *(["spin [deg]"] if spins else []), *after]


def _figures(cell: Cell, spins: bool) -> list[str]:
    ratio = number(cell["motion_ratio"], 2) + interval(cell["motion_ratio_ci95"], 2, cell["n_motion"])
    return [
        str(cell["n"]),
        f"{TIED}/{TIED}".join(number(cell[one], 1) for one in ("mpjpe_mm", "pa_mpjpe_mm")),
        number(cell["in_plane_px"], 1),
        number(cell["ray_depth_mm"], 0),
        number(cell["lean_deg"], 1),
        percent(cell["front_wrong"]),
        *([number(cell["spin_deg"], 0)] if spins else []),
        number(cell["motion_mm"], 1),
        number(cell["still_motion_mm"], 1),
        ratio,
        number(cell["better_motion_ratio"], 2),
        number(cell["path_share"], 2),
        number(cell["matte_iou"], 3),
    ]
