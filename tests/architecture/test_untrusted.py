"""No file that somebody hands over runs: what could run one is called nowhere, or where this list says why it may."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_RUNS_A_FILE = {
    "pickle.load",
    "pickle.loads",
    "pickle.Unpickler",
    "pickle._Unpickler",
    "joblib.load",
    "dill.load",
    "dill.loads",
    "cloudpickle.load",
    "cloudpickle.loads",
    "marshal.load",
    "marshal.loads",
    "shelve.open",
    "pandas.read_pickle",
    "pd.read_pickle",
    "yaml.load",
    "yaml.unsafe_load",
    "yaml.full_load",
    "torch.jit.load",
    "torch.package",
    "numpy.lib.format.read_array",
    "np.lib.format.read_array",
    "os.system",
    "os.popen",
    "eval",
    "exec",
    "compile",
    "importlib.reload",
    "runpy.run_path",
    "tempfile.mktemp",
}
_TAKES_A_WORD = {  # function -> the argument that must be written out, and what it must be
    "torch.load": ("weights_only", True),
    "np.load": ("allow_pickle", False),
    "numpy.load": ("allow_pickle", False),
}
_UNPACKS = {"extractall", "extract", "unpack_archive"}
_NEVER_IMPORTED = {"xml", "lxml", "tarfile", "marshal", "shelve", "dill", "cloudpickle", "telnetlib", "ftplib"}
_MAY = {
    # the machine that reads pickles without running them is built on Python's own
    ("hfb/io/safe/pickles.py", "pickle._Unpickler"),
    # a network is a program: the user names it, and hfb/networks/runtimes.py refuses what is more than one
    ("hfb/networks/runtimes.py", "torch.jit.load"),
    # a method is a function in a file that the user names on the command line; a deployment takes it from HFB_ALLOWED
    ("hfb/evaluation/baselines/own_function.py", "runpy.run_path"),
    # its folder is the root of the file system
    ("flows/cli/start.py", "sys.executable"),
    # our own arrays of numbers, mapped and not read, on the machine of whoever trains
    ("hfb/training/joints/joint_batches.py", "np.load"),
    ("hfb/training/matting/matte_measures.py", "np.load"),
    ("hfb/training/matting/matte_training.py", "np.load"),
    ("hfb/training/matting/pairs.py", "np.load"),
}


def sources() -> list[Path]:
    return sorted(path for room in ("hfb", "tasks", "flows", "infra") for path in (ROOT / room).rglob("*.py"))


def name_of(node: ast.expr) -> str:
    """``torch.load`` for a call of it; empty for a call of something without a name."""
    parts = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    return ".".join(reversed([*parts, node.id])) if isinstance(node, ast.Name) else ""


def dangers(code: str) -> Iterator[str]:
    """What a module does that could run, or unpack, somebody's file."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            named = [one.name for one in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            yield from (f"import {one}" for one in named if one.partition(".")[0] in _NEVER_IMPORTED)
        if isinstance(node, ast.Attribute) and name_of(node) in _RUNS_A_FILE:
            yield name_of(node)
        if isinstance(node, ast.List) and node.elts and name_of(node.elts[0]) == "sys.executable":
            option = node.elts[1] if len(node.elts) > 1 else None
            if not (isinstance(option, ast.Constant) and option.value == "-P"):
                yield "sys.executable"  # it would import what lies in the folder
        if not isinstance(node, ast.Call):
            continue
        name = name_of(node.func)
        words = {word.arg: word.value.value for word in node.keywords if isinstance(word.value, ast.Constant)}
        if isinstance(node.func, ast.Name) and name in _RUNS_A_FILE:
            yield name
        if name in _TAKES_A_WORD and words.get(_TAKES_A_WORD[name][0]) is not _TAKES_A_WORD[name][1]:
            yield name
        if name.rpartition(".")[2] in _UNPACKS or words.get("shell") is True or words.get("allow_pickle") is True:
            yield name


def test_nothing_runs_a_file() -> None:
    found = {(str(path.relative_to(ROOT)), one) for path in sources() for one in dangers(path.read_text())}
    assert found - _MAY == set()
    assert set(_MAY) - found == set(), "an exception that nothing needs any more"


@pytest.mark.parametrize(
    "code",
    [
        "import pickle\npickle.loads(data)",
        "from xml.etree import ElementTree",
        "read = pickle.load",
        "eval(text)",
        "torch.load(path)",
        "torch.load(path, weights_only=False)",
        "np.load(path)",
        "np.load(p, allow_pickle=flag)",
        "archive.extractall(folder)",
        "subprocess.run(words, shell=True)",
        "np.savez(p, allow_pickle=True)",
        "os.system(line)",
        "subprocess.run([sys.executable, '-m', 'pip'])",
    ],
)
def test_it_would_be_seen(code: str) -> None:
    assert list(dangers(code))


def test_what_is_safe_is_left_alone() -> None:
    safe = "torch.load(p, weights_only=True)\nnp.load(p, allow_pickle=False)\nnetwork.eval()\nnp.savez(p, a=a)\n"
    safe += "subprocess.run([sys.executable, '-P', '-m', 'pip'])"
    assert not list(dangers(safe))
