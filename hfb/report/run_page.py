"""Two runs beside each other as one HTML file that needs nothing else: no network, no scripts, the picture inside."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 76rem; padding: 0 1rem; color: #222 }
h1 { font-size: 1.4rem } h2 { font-size: 1.1rem; margin-top: 2rem }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
th, td { text-align: left; padding: .25rem .9rem .25rem 0; border-bottom: 1px solid #ddd; vertical-align: top }
td { overflow-wrap: anywhere } td.name { color: #555; overflow-wrap: normal }
th.one { color: #0072B2 } th.other { color: #D55E00 }
.picture { overflow-x: auto; border: 1px solid #ddd } .none { color: #777 }
"""


@dataclass(frozen=True)
class PageTable:
    """A table of two runs.

    Attributes:
        rows: name, the first run's value, the other's, and where it is a number the difference.
        empty: what to say when there are no rows.
        folded: shown only when asked for.
    """

    title: str
    rows: tuple[tuple[str, str, str, str], ...]
    empty: str = "nothing"
    folded: bool = False


def run_page(
    names: tuple[str, str], sentence: str, tables: Sequence[PageTable], picture_png: bytes | None, caption: str
) -> str:
    """The page.

    Args:
        names: the runs' titles.
        sentence: how far they are from each other.
        picture_png: what to show of both.
        caption: what the picture shows.
    """
    one, other = (escape(name) for name in names)
    parts = [
        "<!doctype html>", '<html lang="en"><head><meta charset="utf-8">',
        f"<title>{one} and {other}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{one} and {other}</h1>", f"<p>{escape(sentence)}</p>",
        *(_table(table, one, other) for table in tables),
    ]  # fmt: skip
    if picture_png is not None:
        data = base64.b64encode(picture_png).decode()
        parts += [
            f"<h2>{escape(caption)}</h2>",
            f'<div class="picture"><img alt="{escape(caption)}" src="data:image/png;base64,{data}"></div>',
        ]
    return "\n".join([*parts, "</body></html>"]) + "\n"


def _table(table: PageTable, one: str, other: str) -> str:
    title = f"<h2>{escape(table.title)}</h2>"
    if not table.rows:
        return f'{title}<p class="none">{escape(table.empty)}</p>'
    last = "<th></th>" if any(row[3] for row in table.rows) else ""
    lines = [f'<table><tr><th></th><th class="one">{one}</th><th class="other">{other}</th>{last}</tr>']
    for name, mine, theirs, difference in table.rows:
        cells = "".join(
            f"<td>{escape(value)}</td>" for value in ((mine, theirs, difference) if last else (mine, theirs))
        )
        lines.append(f'<tr><td class="name">{escape(name)}</td>{cells}</tr>')
    lines.append("</table>")
    body = "\n".join(lines)
    if table.folded:
        return f"<details><summary>{escape(table.title)}</summary>{body}</details>"
    return title + body
