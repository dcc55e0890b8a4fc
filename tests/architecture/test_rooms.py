"""The plan of the house: few loose modules, a short page that explains it."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("flows", "tasks", "hfb")


def test_few_modules_lie_outside_a_room() -> None:
    loose = {path.stem for path in (ROOT / "hfb").glob("*.py")} - {"__init__"}
    assert loose == {"config", "errors", "photometry", "typing"}
    loose = {path.stem for path in (ROOT / "tasks").glob("*.py")} - {"__init__"}
    assert loose <= {"task", "map_task", "prior_training"}, "what a task is, and tasks that are no part of a chain"


def test_calls_name_their_arguments() -> None:
    """Between flows and tasks travel records: no tuple of anything, and at most four arguments by position."""
    sources = {path: path.read_text() for folder in ROOMS for path in (ROOT / folder).rglob("*.py")}
    assert not [path for path, text in sources.items() if "tuple[Any" in text]
    long = {
        f"{path.relative_to(ROOT)}: {function.name}"
        for path, text in sources.items()
        if path.relative_to(ROOT).parts[0] in ("tasks", "flows") and path.stem not in ("train_prior", "prior_training")
        for function in ast.walk(ast.parse(text))
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        and len([one for one in function.args.posonlyargs + function.args.args if one.arg not in ("self", "cls")]) > 4
    }
    assert long == {"tasks/batch/notifications.py: redirect_request"}, "it is urllib's"


def test_paths_in_the_documents_exist() -> None:
    """Files that documents name in backticks, from the root or from hfb/; experiments name those of their day."""
    pages = [*ROOT.glob("*.md"), *(path for path in (ROOT / "docs").rglob("*.md") if path.parent.name != "experiments")]
    named = {(page.name, word) for page in pages for word in page.read_text().split("`")[1::2] if _is_path(word)}
    assert named
    assert not {one for one in named if not any((base / one[1]).exists() for base in (ROOT, ROOT / "hfb"))}


def _is_path(word: str) -> bool:
    return word.endswith(".py") and "/" in word and not set(word) & set(" *{<")
