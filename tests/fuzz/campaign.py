"""Damaged files by the thousand: processes that open them, and what must never happen.

    python -m tests.fuzz.campaign --count 10000 [--seed 0] [--workers 2] [--only NUMBER] [--kinds KIND,...]

Every file is either read or refused by one sentence (`hfb.errors.InputError`), within 10 s of processor time and 2 GB,
without a crash, a file written or code of the file run. Prints one JSON object; the exit code is 1 where one is not.
"""

import argparse
import json
import pickle
import selectors
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.fuzz.seeds import make_seeds

SECONDS, PEAK_MB = 10.0, 2048.0
_PATIENCE_S = 60.0  # until a process that does not answer is taken for hung: the machine may be busy
_ROOT = Path(__file__).parents[2]


@dataclass
class Report:
    """What became of a campaign.

    Attributes:
        failures: every case that was neither read nor refused as it should be.
        slowest: processor time [s] and number of the case. largest: peak memory [MB] and number of the case.
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    kinds: Counter[str] = field(default_factory=Counter)
    failures: list[dict[str, Any]] = field(default_factory=list)
    slowest: tuple[float, int] = (0.0, -1)
    largest: tuple[float, int] = (0.0, -1)

    def add(self, told: dict[str, Any]) -> None:
        """Count one case."""
        if told["outcome"] != "failed" and told["seconds"] > SECONDS:
            told |= {"outcome": "failed", "said": f"took {told['seconds']:.1f} s"}
        if told["outcome"] != "failed" and told["peak_mb"] > PEAK_MB:
            told |= {"outcome": "failed", "said": f"took {told['peak_mb']:.0f} MB"}
        self.outcomes[told["outcome"]] += 1
        self.kinds[f"{told['kind']}: {told['outcome']}"] += 1
        self.slowest = max(self.slowest, (told["seconds"], told["number"]))
        self.largest = max(self.largest, (told["peak_mb"], told["number"]))
        if told["outcome"] == "failed":
            self.failures.append(told)


class _Worker:
    """A process of `tests.fuzz.worker`, begun again where it ends."""

    def __init__(self, folder: Path, seeds: Path, campaign: int) -> None:
        self._folder, self._command = folder, [sys.executable, "-m", "tests.fuzz.worker", str(seeds), str(campaign)]
        self._folder.mkdir()
        self.number: int | None = None
        self.since = 0.0
        self.begin()

    def begin(self) -> None:
        """A fresh process."""
        home = {"PYTHONPATH": str(_ROOT), "PATH": "/usr/bin:/bin", "HOME": str(self._folder), "OMP_NUM_THREADS": "1"}
        with (self._folder / "stderr").open("wb") as stderr:
            self.process = subprocess.Popen(
                self._command,
                cwd=self._folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                text=True,
                env=home,
            )
        assert json.loads(self.process.stdout.readline() or "{}"), (self._folder / "stderr").read_text()

    def give(self, number: int) -> None:
        """A case to judge."""
        self.number, self.since = number, time.monotonic()
        self.process.stdin.write(f"{number}\n")
        self.process.stdin.flush()

    def end(self) -> str:
        """Why it ended, or that it had to be ended."""
        hung = self.process.poll() is None and time.monotonic() - self.since > _PATIENCE_S
        if hung:
            self.process.kill()
        code = self.process.wait()
        said = (self._folder / "stderr").read_text(errors="replace")
        last = said[max(0, said.find("Fatal Python error")) :][:1500]
        return f"hung for {_PATIENCE_S:.0f} s" if hung else f"crashed with {code}: {last}"


def run(
    numbers: Sequence[int], campaign: int, workers: int, folder: Path, kinds: Collection[str] | None = None
) -> Report:
    """Judge the damaged files of some numbers; of some kinds alone where they are named."""
    report, waiting = Report(), list(reversed(numbers))
    seeds = folder / "seeds"
    seeds.write_bytes(pickle.dumps([seed for seed in make_seeds() if kinds is None or seed.kind in kinds]))
    pool = [_Worker(folder / f"worker-{index}", seeds, campaign) for index in range(workers)]
    try:
        while waiting or any(one.number is not None for one in pool):
            for one in pool:
                if one.number is None and waiting:
                    one.give(waiting.pop())
            _listen(pool, report)
    finally:
        for one in pool:
            one.process.kill()
            one.process.wait()
    return report


def _listen(pool: Sequence[_Worker], report: Report) -> None:
    """Wait for the next answers; a process that ended or hangs is a failure, and a new one takes its place."""
    with selectors.DefaultSelector() as ready:
        for one in pool:
            if one.number is not None:
                ready.register(one.process.stdout, selectors.EVENT_READ, one)
        # twice: somebody who stops this process for a while and lets it go on ends the first wait without a look
        answered = [key.data for key, _ in ready.select(timeout=1.0) or ready.select(timeout=0)]
    for one in pool:
        line = one.process.stdout.readline() if one in answered else ""
        if line:
            report.add(json.loads(line))
            one.number = None
        elif one in answered or (one.number is not None and time.monotonic() - one.since > _PATIENCE_S):
            unknown = {"kind": "?", "name": "?", "how": "?", "outcome": "failed", "seconds": 0.0, "peak_mb": 0.0}
            report.add({"number": one.number, **unknown, "said": one.end()})
            one.number = None
            one.begin()


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", type=int, help="this case alone")
    parser.add_argument("--kinds", type=lambda words: words.split(","), help="files of these kinds alone")
    given = parser.parse_args()
    numbers = [given.only] if given.only is not None else range(given.first, given.first + given.count)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="hfb-fuzz-") as folder:
        report = run(numbers, given.seed, given.workers, Path(folder), given.kinds)
    print(
        json.dumps(
            {
                "cases": len(numbers),
                "outcomes": report.outcomes,
                "slowest (s, case)": report.slowest,
                "largest (MB, case)": report.largest,
                "seconds": round(time.perf_counter() - began),
                "kinds": dict(sorted(report.kinds.items())),
                "failures": report.failures,
            },
            indent=1,
        )
    )
    return 1 if report.failures else 0


if __name__ == "__main__":
    sys.exit(main())
