"""Convert the tables of a benchmark from Markdown to HTML.

HTML inside the text is escaped: names of methods and folders come from users.
"""

from functools import cache

from markdown_it import MarkdownIt
from markupsafe import Markup


def markdown(text: str) -> Markup:
    """Render GitHub's Markdown without links and images; a leading ``# title`` is dropped, since the page has its own.

    Args:
        text: Markdown.
    """
    lines = text.lstrip().split("\n", 1)
    body = lines[1] if lines[0].startswith("# ") and len(lines) > 1 else text
    reader = _reader()
    tokens = reader.parse(body)
    for token in tokens:
        if token.type in ("heading_open", "heading_close"):  # the page's own sections are above them
            token.tag = f"h{int(token.tag[1]) + 1}"
    return Markup(reader.renderer.render(tokens, reader.options, {}))


@cache
def _reader() -> MarkdownIt:
    reader = MarkdownIt("commonmark", {"html": False}).enable("table").disable(["link", "image", "autolink"])
    # tables wider than the page scroll by themselves
    reader.add_render_rule("table_open", lambda *_: '<div class="wide"><table class="figures">')
    reader.add_render_rule("table_close", lambda *_: "</table></div>")
    return reader
