"""Numbers, intervals and names as the tables of a benchmark write them, in GitHub's markdown."""

from collections.abc import Collection, Sequence

UNKNOWN = "–"
TIED = "\u00a0"
"""A space at which no browser breaks the line."""


def number(value: float | None, digits: int) -> str:
    """Format a number; an unknown one is a dash.

    Args:
        value: or None where it is unknown.
        digits: number of decimals.
    """
    return UNKNOWN if value is None else f"{value:.{digits}f}"


def interval(bounds: Sequence[float] | None, digits: int, cases: int) -> str:
    """Format `` [low, high; n 12]`` with a space before it, or nothing; a line breaks before the bracket only.

    Args:
        bounds: low and high, or None.
        digits: number of decimals.
        cases: n.
    """
    if bounds is None:
        return ""
    return f" [{bounds[0]:.{digits}f},{TIED}{bounds[1]:.{digits}f};{TIED}n{TIED}{cases}]"


def blur_label(blur: Sequence[float]) -> str:
    """Format an interval of blur rates.

    Args:
        blur: low and high.
    """
    return f"< {blur[1]:g}" if blur[0] <= 0 else f"{blur[0]:g}–{blur[1]:g}"


def grid(header: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return a markdown table; the first `left` columns are aligned left, the others right.

    Args:
        header: a text per column.
        rows: a text per column each.
        left: number of columns aligned left.
    """
    rule = [":---"] * left + ["---:"] * (len(header) - left)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [header, rule, *rows])


def method_name(method: str, oracles: Collection[str]) -> str:
    """Write an oracle in italics.

    Args:
        method: its name.
        oracles: methods that use the truth.
    """
    return f"*{method}*" if method in oracles else method


def percent(share: float | None) -> str:
    """Format a share in percent; an unknown one is a dash.

    Args:
        share: or None where it is unknown.
    """
    return UNKNOWN if share is None else f"{100 * share:.0f}{TIED}%"
