"""The plan of the house: few loose modules, a short page that explains it."""

from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_few_modules_lie_outside_a_room() -> None:
    loose = {path.stem for path in (ROOT / "hfb").glob("*.py")} - {"__init__"}
    assert loose == {"config", "errors", "photometry", "typing"}
    assert not [path.name for path in (ROOT / "tasks").glob("*.py") if path.stem not in ("__init__", "train_prior")]


def test_paths_in_the_documents_exist() -> None:
    """Files that documents name in backticks, from the root or from hfb/; experiments name those of their day."""
    pages = [*ROOT.glob("*.md"), *(path for path in (ROOT / "docs").rglob("*.md") if path.parent.name != "experiments")]
    named = {(page.name, word) for page in pages for word in page.read_text().split("`")[1::2] if _is_path(word)}
    assert named
    assert not {one for one in named if not any((base / one[1]).exists() for base in (ROOT, ROOT / "hfb"))}


def _is_path(word: str) -> bool:
    return word.endswith(".py") and "/" in word and not set(word) & set(" *{<")
