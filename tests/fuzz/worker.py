"""A process that opens damaged files, within bounded memory; one line of JSON for each number it is given.

    python -m tests.fuzz.worker SEEDS CAMPAIGN

SEEDS: the pickle of `tests.fuzz.campaign`, our own. It works in the current folder.
"""

import faulthandler
import json
import os
import pickle
import resource
import shutil
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import torch

from hfb.errors import InputError
from tests.fuzz.damage import Case, make_case
from tests.fuzz.hostile import CANARY
from tests.fuzz.readers import READERS

ADDRESS_SPACE = 5 << 28
"""What a file may take beside the libraries, whose code is most of a process's addresses; 2 GB of memory in all."""

LONGEST_SENTENCE = 700
_FILE_BYTES = 256 << 20


def main(arguments: Sequence[str]) -> None:
    """Answer numbers until there are no more."""
    faulthandler.enable(sys.stderr)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    seeds = pickle.loads(Path(arguments[0]).read_bytes())
    campaign = int(arguments[1])
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_BYTES, _FILE_BYTES))
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what libraries print is no answer
    print(json.dumps({"ready": True}), file=answers)
    for line in sys.stdin:
        print(json.dumps(judge(make_case(seeds, campaign, int(line)), int(line))), file=answers)


def judge(case: Case, number: int) -> dict[str, Any]:
    """Open a damaged file in every way there is, and say what became of it."""
    place = Path("place")
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    path = place / case.name
    path.write_bytes(case.data)
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory begins anew
    told = {"number": number, "kind": case.kind, "name": case.name, "how": case.how, "outcome": "read", "said": ""}
    began = time.process_time()
    with _within(ADDRESS_SPACE):
        for read in READERS[case.kind]:
            outcome, said = _tried(read, path)
            if outcome != "read":
                told |= {"outcome": outcome, "said": said}
            if outcome == "failed":
                break
    told |= {"seconds": time.process_time() - began, "peak_mb": _status_kb("VmHWM") / 1024}
    left = sorted(one.name for one in place.rglob("*") if one != path)
    if left or Path(CANARY).exists() or list(Path.cwd().glob(f"**/{CANARY}*")):
        told |= {"outcome": "failed", "said": f"left {left or CANARY} behind"}
    return told


@contextmanager
def _within(most: int) -> Iterator[None]:
    """No more address space than so much more, inside."""
    _, ceiling = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (_status_kb("VmSize") * 1024 + most, ceiling))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (ceiling, ceiling))


def _tried(read: Any, path: Path) -> tuple[str, str]:
    try:
        read(path)
    except InputError as error:
        text = str(error)
        if not text or "\n" in text or len(text) > LONGEST_SENTENCE:
            return "failed", f"not one sentence: {text[:LONGEST_SENTENCE]!r}"
        return "refused", text
    except BaseException:
        return "failed", "".join(traceback.format_exc().splitlines(keepends=True)[-8:])
    return "read", ""


def _status_kb(name: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1])
    return 0


if __name__ == "__main__":
    main(sys.argv[1:])
