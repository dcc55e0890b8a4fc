"""A running `hfb app` for tests, and requests as its page sends them."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx

from hfb.flows.app.upload import KIND

PATIENCE_S = 240.0
FAST = ("--init.method", "matte", "--fit.subframes", "2", "--fit.texture-px", "16", "--export.films", "none")
SHORT = (*FAST, "--fit.stages", '[{"size_px": 32, "iterations": 3}]')
ENDLESS = (*FAST, "--fit.stages", '[{"size_px": 32, "iterations": 10000000}]')


@dataclass(frozen=True)
class Served:
    """The app, and its process."""

    url: str
    process: subprocess.Popen[str]

    @property
    def origin(self) -> str:
        parts = urlsplit(self.url)
        return f"{parts.scheme}://{parts.netloc}"

    def get(self, path: str, **headers: str) -> httpx.Response:
        return httpx.get(self.url + path, headers=headers, timeout=60)

    def post(self, path: str, content: bytes = b"", **headers: str) -> httpx.Response:
        sent = {"Origin": self.origin, "Content-Type": KIND, **headers}
        return httpx.post(self.url + path, content=content, headers=sent, timeout=60)

    def jobs(self) -> list[dict[str, Any]]:
        return self.get("jobs").json()

    def wait(self, name: str, *states: str, step: str | None = None) -> dict[str, Any]:
        """The job, once it is in one of these states, and a step of this label has begun."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            job = self.get(f"jobs/{name}").json()
            if job["state"] in states and (step is None or step in [one["label"] for one in job["steps"]]):
                return job
            assert time.monotonic() < deadline, job
            assert job["state"] in ("waiting", "running", "cancelling"), job
            time.sleep(0.2)


@contextmanager
def served(out: Path, *options: str) -> Iterator[Served]:
    """`hfb app` in a process of its own, on a free port."""
    words = ["app", "--port", "0", "--out", str(out), "--json", *options]
    command = [sys.executable, "-m", "hfb.flows.cli.cli", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield Served(json.loads(process.stdout.readline())["url"], process)
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait(90)


def body(
    files: list[tuple[str, str, bytes]], options: Mapping[str, Any] | None = None, background: str = "auto"
) -> bytes:
    """An upload of (role, name, content)."""
    told = [{"role": role, "name": name, "size": len(content)} for role, name, content in files]
    request = {"files": told, "background": background, "options": options or {}}
    return json.dumps(request).encode() + b"\n" + b"".join(content for _, _, content in files)
