"""The size and shape of the code, counted: a count may fall to its goal and never rises above today's value."""

import ast
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("hfb", "tasks", "flows")

LOOSE_MODULES = 4
FILES_OF_A_ROOM = 20
TUPLES_OF_ANY = 0
LINES = {"product": 45_461, "training": 4_584}
"""Of code, without docstrings, comments and blank lines; the product is all but `hfb.training`.

The product's goal is 30,183, nine tenths of what adb3d25 had.
"""

SAME_NAME = {
    "amass": "a reader and a writer of one format are called by the format",
    "bvh": "as above",
}
"""Names of several modules, and why."""


def sources(*rooms: str) -> list[Path]:
    return sorted(path for room in rooms for path in (ROOT / room).rglob("*.py") if not _linked(path))


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def _linked(path: Path) -> bool:
    return any(parent.is_symlink() for parent in path.parents)


def test_few_modules_lie_outside_a_room() -> None:
    assert len([path for path in (ROOT / "hfb").glob("*.py") if path.stem != "__init__"]) <= LOOSE_MODULES


def test_no_room_is_crowded() -> None:
    files = Counter(path.parent.relative_to(ROOT).as_posix() for path in sources(*ROOMS) if path.stem != "__init__")
    assert {room: count for room, count in files.items() if count > FILES_OF_A_ROOM} == {}


def test_a_module_is_found_by_its_name() -> None:
    names = Counter(path.stem for path in sources(*ROOMS) if path.stem != "__init__")
    assert {name for name, count in names.items() if count > 1} == set(SAME_NAME)


def test_the_formatter_formats() -> None:
    assert [(path, line) for path in sources(*ROOMS) for line in _by_hand(path)] == []


def _by_hand(path: Path) -> Iterator[int]:
    """Lines with ``# fmt: skip`` behind a statement that is no table of numbers."""
    text = path.read_text()
    with path.open("rb") as file:
        skipped = {
            token.start[0] for token in tokenize.tokenize(file.readline) if token.string.startswith("# fmt: skip")
        }
    statements = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.stmt)] if skipped else []
    for line in skipped:
        ending = [node for node in statements if node.end_lineno == line or node.lineno <= line <= _head_end(node)]
        if not any(_is_table(node) for node in ending):
            yield line


def _head_end(node: ast.stmt) -> int:
    body = getattr(node, "body", None)
    return body[0].lineno if isinstance(body, list) and body else node.end_lineno or node.lineno


def _is_table(statement: ast.stmt) -> bool:
    """Whether at least eight numbers stand in it, and more of them than of anything else."""
    leaves = [node for node in ast.walk(statement) if isinstance(node, ast.Constant | ast.Name | ast.Attribute)]
    numbers = [one for one in leaves if isinstance(one, ast.Constant) and isinstance(one.value, int | float)]
    return len(numbers) >= 8 and 2 * len(numbers) > len(leaves)


def test_calls_are_typed() -> None:
    assert sum(path.read_text().count("tuple[Any") for path in sources(*ROOMS)) <= TUPLES_OF_ANY


def test_public_functions_describe_their_parameters() -> None:
    functions = [node for path in sources(*ROOMS) for node in _public_functions(_tree(path))]
    assert [node.name for node in functions if not _is_described(node, bound=False)] == []


def test_public_methods_describe_their_parameters() -> None:
    nodes = [node for path in sources(*ROOMS) for node in _tree(path).body]
    classes = [node for node in nodes if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]
    methods = [(one.name, node) for one in classes for node in _public_functions(one)]
    assert [f"{name}.{node.name}" for name, node in methods if not _is_described(node, bound=True)] == []


def _public_functions(parent: ast.Module | ast.ClassDef) -> Iterator[ast.FunctionDef]:
    for node in parent.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not _is_overload(node):
            yield node


def _is_described(function: ast.FunctionDef, bound: bool) -> bool:
    """Whether the docstring has an entry for each parameter; `bound`: but for self or the class."""
    parameters = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    static = any(isinstance(one, ast.Name) and one.id == "staticmethod" for one in function.decorator_list)
    names = {one.arg for one in parameters[1 if bound and not static else 0 :]}
    return names <= _told(ast.get_docstring(function) or "")


def _is_overload(function: ast.FunctionDef) -> bool:
    """Whether it is one of a function's signatures for the type checker, which have no docstring."""
    return any(isinstance(one, ast.Name) and one.id == "overload" for one in function.decorator_list)


def _told(docstring: str) -> set[str]:
    section = re.search(r"Args:\n(.*?)(\n\n|\Z)", docstring, re.DOTALL)
    if section is None:
        return set()
    return {
        name for names in re.findall(r"^\s+\*{0,2}([\w, ]+):", section[1], re.MULTILINE) for name in names.split(", ")
    }


def test_the_code_does_not_grow() -> None:
    training = ROOT / "hfb" / "training"
    lines = {"product": 0, "training": 0}
    for path in sources(*ROOMS):
        lines["training" if path.is_relative_to(training) else "product"] += _code_lines(path)
    assert {part: count for part, count in lines.items() if count > LINES[part]} == {}


def _code_lines(path: Path) -> int:
    """Lines of a module that are neither blank nor comment nor part of a docstring."""
    texts = [node for node in ast.walk(_tree(path)) if isinstance(node, ast.Expr) and _is_text(node.value)]
    told = {line for node in texts for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    stripped = ((number, line.strip()) for number, line in enumerate(path.read_text().splitlines(), 1))
    return sum(1 for number, line in stripped if line and not line.startswith("#") and number not in told)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)
