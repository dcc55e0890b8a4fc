"""The plan of the house: few loose modules, a short page that explains it."""

from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_few_modules_lie_outside_a_room() -> None:
    loose = {path.stem for path in (ROOT / "hfb").glob("*.py")} - {"__init__"}
    assert loose == {"config", "errors", "photometry", "typing"}
    assert not [path.name for path in (ROOT / "tasks").glob("*.py") if path.stem not in ("__init__", "train_prior")]


def test_the_page_about_the_house_is_short() -> None:
    assert (ROOT / "ARCHITECTURE.md").stat().st_size <= 12 << 10


def test_paths_in_the_documents_exist() -> None:
    """Files that ARCHITECTURE.md, SECURITY.md and docs/ name in backticks, from the root or from hfb/."""
    pages = [ROOT / "ARCHITECTURE.md", ROOT / "SECURITY.md", ROOT / "CONVENTIONS.md", *(ROOT / "docs").rglob("*.md")]
    named = {(page.name, word) for page in pages for word in page.read_text().split("`")[1::2] if _is_path(word)}
    assert named
    assert not {one for one in named if not any((base / one[1]).exists() for base in (ROOT, ROOT / "hfb"))}


def _is_path(word: str) -> bool:
    return word.endswith(".py") and "/" in word and not set(word) & set(" *{<")
