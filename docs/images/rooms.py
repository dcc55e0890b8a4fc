"""Draw the rooms of the code as docs/images/rooms.svg, from the import contracts of pyproject.toml.

    python docs/images/rooms.py

A row imports only rows below it. tests/architecture compares the committed image with what this draws.
"""

import tomllib
from pathlib import Path
from typing import Any

_HERE = Path(__file__).parent
_TOP = {"flows": "flows: a chain per command, its servers, the command line", "tasks": "tasks: cached, retried steps"}
_WIDTH, _ROW, _GAP, _MARGIN, _LABEL = 860, 34, 8, 12, 74
_FILL = {"flows": "#cfe3f5", "tasks": "#d9ecd3", "hfb": "#f6e7c8"}


def draw_rooms(project: dict[str, Any]) -> str:
    """Return the SVG of all rooms.

    Args:
        project: pyproject.toml as a dictionary.
    """
    rows = [("flows", [_TOP["flows"]]), ("tasks", [_TOP["tasks"]])]
    rows += [("hfb", [f"hfb.{room}" for room in row]) for row in room_rows(project)]
    height = 2 * _MARGIN + len(rows) * (_ROW + _GAP) - _GAP
    drawn = [box for number, (kind, rooms) in enumerate(rows) for box in _row(number, kind, rooms)]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" width="{_WIDTH}" '
            f'height="{height}" font-family="sans-serif" font-size="13" role="img" '
            'aria-label="Rooms of the code, importing downwards">',
            f'<rect width="{_WIDTH}" height="{height}" fill="#ffffff"/>',
            *_arrow(height),
            *drawn,
            "</svg>",
            "",
        ]
    )


def room_rows(project: dict[str, Any]) -> list[list[str]]:
    """Return the rooms of hfb, row by row, from the top.

    Args:
        project: pyproject.toml as a dictionary.
    """
    contracts = project["tool"]["importlinter"]["contracts"]
    layers = next(one["layers"] for one in contracts if one["type"] == "layers" and one.get("containers") == ["hfb"])
    rows = [[room.strip("() ") for room in row.replace(":", "|").split("|")] for row in layers]
    return [row for row in rows if not set(row) & set(_TOP)]


def _row(number: int, kind: str, rooms: list[str]) -> list[str]:
    top = _MARGIN + number * (_ROW + _GAP)
    left, room_px = _LABEL, _WIDTH - _LABEL - _MARGIN
    each = (room_px - _GAP * (len(rooms) - 1)) / len(rooms)
    boxes = []
    for place, room in enumerate(rooms):
        x = left + place * (each + _GAP)
        boxes += [
            f'<rect x="{x:.0f}" y="{top}" width="{each:.0f}" height="{_ROW}" rx="5" fill="{_FILL[kind]}" '
            'stroke="#555555"/>',
            f'<text x="{x + each / 2:.0f}" y="{top + _ROW / 2 + 5:.0f}" text-anchor="middle" fill="#111111">'
            f"{room}</text>",
        ]
    return boxes


def _arrow(height: int) -> list[str]:
    x, end = _LABEL / 2, height - _MARGIN
    return [
        f'<path d="M{x:.0f} {_MARGIN} V{end} m-5 -9 l5 9 l5 -9" fill="none" stroke="#555555" stroke-width="2"/>',
        f'<text transform="translate({x - 8:.0f} {height / 2:.0f}) rotate(-90)" text-anchor="middle" fill="#111111">'
        "imports</text>",
    ]


if __name__ == "__main__":
    (_HERE / "rooms.svg").write_text(draw_rooms(tomllib.loads((_HERE.parents[1] / "pyproject.toml").read_text())))
