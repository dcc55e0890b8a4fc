"""Numbers, intervals and names as the tables of a benchmark write them, in GitHub's markdown."""

from collections.abc import Collection, Sequence

UNKNOWN = "–"
TIED = "\u00a0"
"""A space at which no browser breaks the line."""


def number(value: float | None, digits: int) -> str:
    """A number, or the dash for an unknown one."""
    return UNKNOWN if value is None else f"{value:.{digits}f}"


def interval(bounds: Sequence[float] | None, digits: int, cases: int) -> str:
    """`` [low, high; n 12]`` with a space before it, or nothing; a line breaks before the bracket only."""
    if bounds is None:
        return ""
    return f" [{bounds[0]:.{digits}f},{TIED}{bounds[1]:.{digits}f};{TIED}n{TIED}{cases}]"


def blur_label(blur: Sequence[float]) -> str:
    """An interval of blur rates."""
    return f"< {blur[1]:g}" if blur[0] <= 0 else f"{blur[0]:g}–{blur[1]:g}"


def grid(header: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """A markdown table; the first `left` columns are set left, the others right."""
    rule = [":---"] * left + ["---:"] * (len(header) - left)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [header, rule, *rows])


def method_name(method: str, oracles: Collection[str]) -> str:
    """In italics where it is an oracle."""
    return f"*{method}*" if method in oracles else method


def percent(share: float | None) -> str:
    """A share in percent, or the dash."""
    return UNKNOWN if share is None else f"{100 * share:.0f}{TIED}%"
