"""Markdown documents of the repository, their links, code blocks and commands, for the tests that read them."""

import re
import shlex
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).parents[1]
_FOREIGN = {".venv", "build", "runs", ".pytest_cache", "node_modules"}
_MARKDOWN = MarkdownIt("commonmark").enable("table")


def documents() -> list[Path]:
    """Return every Markdown document of the repository."""
    return [path for path in sorted(ROOT.rglob("*.md")) if not set(path.relative_to(ROOT).parts[:-1]) & _FOREIGN]


def code_blocks(path: Path, *languages: str) -> list[tuple[str, str]]:
    """Return (language, code) of a document's fenced blocks.

    Args:
        path: the document.
        languages: which languages; all where none is given.
    """
    fences = [token for token in _MARKDOWN.parse(path.read_text()) if token.type == "fence"]
    return [(one.info.strip(), one.content) for one in fences if not languages or one.info.strip() in languages]


def prose(path: Path) -> Iterator[str]:
    """Yield the text of every paragraph, list item, heading and table cell, without code blocks."""
    for token in _MARKDOWN.parse(path.read_text()):
        if token.type == "inline":
            yield " ".join(_words(token).split())


def links(path: Path) -> Iterator[str]:
    """Yield the targets of a document's links and images."""
    for token in _MARKDOWN.parse(path.read_text()):
        for child in token.children or ():
            target = child.attrs.get("href") or child.attrs.get("src")
            if target:
                yield str(target)


@cache
def anchors(path: Path) -> set[str]:
    """Return the anchors of a document's headings, as forges and MyST write them."""
    tokens = _MARKDOWN.parse(path.read_text())
    headings = [_words(after) for token, after in pairwise(tokens) if token.type == "heading_open"]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def hfb_commands(path: Path) -> Iterator[list[str]]:
    """Yield the words after `hfb` of every command in a document's shell blocks."""
    for _, code in code_blocks(path, "bash", "sh", "text", ""):
        for line in code.replace("\\\n", " ").splitlines():
            for part in re.split(r"&&|\|\||;", line):
                words = shlex.split(part, comments=True) if _is_closed(part) else []
                while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
                    words.pop(0)
                if words and (words[0] == "hfb" or words[0].endswith("bin/hfb")):
                    yield words[1:]


def _is_closed(part: str) -> bool:
    try:
        shlex.split(part, comments=True)
    except ValueError:
        return False
    return True


def _words(token: Token) -> str:
    return "".join(" " if child.type in ("softbreak", "hardbreak") else child.content for child in token.children or ())
