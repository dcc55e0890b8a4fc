"""What `hfb --print-completion SHELL` prints makes that shell complete commands and options."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CHECKS = {"bash": ["-n"], "zsh": ["-n"], "fish": ["--no-execute"]}


def script(shell: str) -> str:
    words = [sys.executable, "-m", "hfb.flows.cli.cli", "--print-completion", shell]
    return subprocess.run(words, capture_output=True, text=True, timeout=60, check=True).stdout


@pytest.mark.parametrize("shell", CHECKS)
def test_the_script_is_one_of_that_shell(shell: str, tmp_path: Path) -> None:
    text = script(shell)
    assert "height-m" in text
    assert "benchmark" in text
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed: its script was not read by it")
    path = tmp_path / "hfb.completion"
    path.write_text(text)
    subprocess.run([shell, *CHECKS[shell], path], check=True, timeout=60)


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("ex",), ["export"]),
        (("fit", "--fit.hei"), ["--fit.height-m"]),
        (("benchmark", "--start", "sim"), ["simulated"]),
        (("train", "landmarks-"), ["landmarks-bank"]),
    ],
)
def test_bash_completes(words: tuple[str, ...], wanted: list[str], tmp_path: Path) -> None:
    path = tmp_path / "hfb.bash"
    path.write_text(script("bash"))
    typed = f"COMP_WORDS=(hfb {' '.join(words)}); COMP_CWORD={len(words)}"
    ask = f'source {path}; {typed}; _shtab_hfb; printf "%s\\n" "${{COMPREPLY[@]}}"'
    done = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == wanted


def test_another_shell_is_refused_with_the_known_ones() -> None:
    words = [sys.executable, "-m", "hfb.flows.cli.cli", "--print-completion", "cmd"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "'bash', 'zsh', 'fish'" in done.stderr
