"""Parts of table.md: pixels, depth, front and motion by method, camera and blur rate; errors by recording and K."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from hfb.evaluation.cells import Cell, is_start
from hfb.evaluation.table_text import TIED, UNKNOWN, blur_label, grid, interval, method_name, number, percent

_MOVEMENT = ("in_plane_px", "ray_depth_mm", "lean_deg", "motion_ratio")
_EXPLAINED = (
    "In plane: distance in the picture, nothing aligned. Depth: error along the ray, roots in one place. Lean: angle "
    "between both trunks in the plane of the vertical and the depth. Front wrong: share of exposures whose body faces "
    "over 90 degrees away from the true one. Spin: largest turn between neighbouring exposures that the truth does not "
    "make. Motion: mean distance of both paths about their own means; its ratio to a still body's, with the 95 % "
    "interval, is 1 where nothing is told of the motion. One exposure cannot tell the direction of time: the ratio in "
    "the better one stands beside it. Path: length of the joints' paths about the root, share of the true one."
)


def movement_tables(summary: Mapping[str, Any], oracles: Collection[str]) -> list[str]:
    """The parts of the page; none where no method knows a place in front of the camera.

    Args:
        summary: what `summarize` returns.
        oracles: methods that see the truth: in italics.
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

    parts = ["## In the picture, in depth and in motion", _EXPLAINED, table({"": every}, None)]
    if cameras:
        parts += ["## The same by camera", table(cameras, "camera")]
    return [*parts, "## The same by blur rate", table(bins, "blur rate")]


def recording_tables(summary: Mapping[str, Any], oracles: Collection[str]) -> list[str]:
    """MPJPE and PA-MPJPE: a row per recording and method, a column per K; none where no recording is named."""
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
    """The name of a group stands in its first row alone."""
    before = [None, *(row[0] for row in rows)]
    return [["" if row[0] == last else row[0], *row[1:]] for row, last in zip(rows, before, strict=False)]


def _mean(cell: Cell, entry: str, bounds: str, count: str) -> str:
    if cell[entry] is None:
        return UNKNOWN
    return number(cell[entry], 1) + (interval(cell[bounds], 0, cell[count]) or f" (n{TIED}{cell[count]})")


def _shown(name: str, starts: Collection[str], oracles: Collection[str]) -> str:
    return f"start ({name})" if name in starts else method_name(name, oracles)


def _columns(spins: bool) -> Sequence[str]:
    return [
        "n",
        "MPJPE / PA [mm]",
        "in plane [px]",
        "depth [mm]",
        "lean [deg]",
        "front wrong",
        *(["spin [deg]"] if spins else []),
        "motion [mm]",
        "still body's [mm]",
        "motion ratio",
        "better way of time",
        "path",
        "matte IoU",
    ]


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
