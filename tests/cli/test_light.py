"""Help and mistakes are answered at once: nothing heavy is imported for them."""

import re
import subprocess
import sys

import pytest

HEAVY = {"torch", "prefect", "mlflow", "numba", "numpy", "cv2", "scipy", "rich"}
PROGRAM = """
import sys
from hfb.flows.cli.cli import main
try:
    code = main(sys.argv[1:])
except SystemExit as end:
    code = end.code
print("MODULES", *{name.partition(".")[0] for name in sys.modules})
sys.exit(code)
"""


def answer(*words: str) -> tuple[int, str, set[str]]:
    """Exit code, output without the last line, and the packages that were imported."""
    done = subprocess.run([sys.executable, "-c", PROGRAM, *words], capture_output=True, text=True, timeout=60)
    *output, modules = done.stdout.splitlines()
    return done.returncode, "\n".join(output) + done.stderr, set(modules.split()[1:])


COMMANDS = (
    "",
    "fit",
    "video",
    "batch",
    "demo",
    "models",
    "synth",
    "benchmark",
    "reproduce",
    "rerun",
    "compare",
    "record",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_light(command: str) -> None:
    code, text, modules = answer(*command.split(), "--help")
    assert code == 0
    assert "usage: hfb" in text
    assert not modules & HEAVY


def test_help_names_what_there_is() -> None:
    _, text, _ = answer("fit", "--help")
    for flag in ("--background", "--clip", "--preset", "--out", "--seed", "--config", "--json", "--fit.height-m"):
        assert flag in text
    _, everything, modules = answer("fit", "--help-all")
    for flag in ("--background", "--fit.subframes", "--fit.weights.image", "--verbose"):
        assert flag in everything
    assert not modules & HEAVY


@pytest.mark.parametrize("command", ["fit", "demo", "video", "batch", "synth", "benchmark", "reproduce", "export"])
def test_help_shows_some_fifteen_options_and_an_example(command: str) -> None:
    _, text, _ = answer(command, "--help")
    options = [line for line in text.splitlines() if re.match(r"  -{1,2}[a-z]", line)]
    assert 11 <= len(options) <= 22
    assert f"\n  hfb {command} " in text.partition("examples:")[2]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "COMMAND"),
        (("fitt",), "fitt"),
        (("fit", "a.png"), "--background"),
        (("fit", "a.png", "--background", "b.png", "--fit.subframe", "3"), "--fit.subframe"),
        (("fit", "none.png", "--background", "b.png"), "none.png does not exist"),
        (("fit", "none.png", "--background", "b.png", "--fit.subframes", "0"), "fit.subframes"),
        (("video", "none.mp4"), "none.mp4 does not exist"),
        (("video", "none.mp4", "--window", "1"), "video.window"),
        (("batch", "none"), "none is no folder"),
        (("batch", "none", "--attempts", "0"), "--attempts"),
        (("benchmark", "bt-mass"), "bt-mass"),
        (("benchmark", "bt-amass", "--methods", "best,worst"), "worst"),
        (("benchmark", "bt-amass", "--count", "0"), "--count"),
        (("benchmark", "bt-amass", "--frames", "0"), "frames"),
        (("benchmark", "b-aist"), "--videos"),
        (("benchmark", "bt-amass", "--config", "a.toml"), "--config"),
        (("synth", "bt-amass", "--workers", "two"), "--workers"),
        (("reproduce", "table9"), "table1"),
        (("rerun",), "RUN_ID"),
        (("rerun", "0123", "--workers", "0"), "--workers"),
        (("compare", "0123"), "RUN_B"),
    ],
)
def test_mistakes_are_light(words: tuple[str, ...], says: str) -> None:
    code, text, modules = answer(*words)
    assert code == 2
    assert text.startswith("hfb: ")
    assert says in text
    assert len(text.splitlines()) == 1
    assert not modules & (HEAVY - {"rich"})
