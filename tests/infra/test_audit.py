"""`make audit`: a package that the index does not know is named at the end, after all others were looked up."""

import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

_ROOT = Path(__file__).parents[2]
_SCRIPT = _ROOT / "infra" / "audit" / "audit.py"


def _audit(program: str | Path, requirements: Path, *more: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(_SCRIPT), str(program), str(requirements), *more]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def _said(tmp_path: Path, packages: list[dict[str, Any]]) -> subprocess.CompletedProcess[str]:
    """Of a report such as pip-audit 2.9 writes."""
    program = tmp_path / "pip-audit"
    program.write_text(f"#!/bin/sh\ncat << 'END'\n{json.dumps({'dependencies': packages, 'fixes': []})}\nEND\n")
    program.chmod(0o755)
    return _audit(program, tmp_path / "constraints.txt")


_GOOD = {"name": "good", "version": "1.0", "vulns": []}
_UNKNOWN = {"name": "unknown", "skip_reason": "Dependency not found on PyPI and could not be audited: unknown (1.0)"}
_HOLE = {
    "name": "holey",
    "version": "2.0",
    "vulns": [{"id": "PYSEC-1", "fix_versions": ["2.1"], "aliases": [], "description": ""}],
}


def test_an_unknown_package_is_named_at_the_end(tmp_path: Path) -> None:
    done = _said(tmp_path, [_UNKNOWN, _GOOD, _HOLE])
    assert done.returncode == 1
    assert done.stdout.splitlines() == [
        "holey 2.0: PYSEC-1, mended in 2.1",
        "make audit: 2 of 3 packages looked up, 1 known holes",
        "make audit: not known to the index, look them up yourself: unknown",
    ]
    assert _said(tmp_path, [_UNKNOWN, _GOOD]).returncode == 1  # nobody looked: no pass
    assert _said(tmp_path, [_GOOD]).returncode == 0
    assert _said(tmp_path, []).returncode == 1


def test_an_index_that_does_not_answer_is_one_sentence(tmp_path: Path) -> None:
    program = tmp_path / "pip-audit"
    program.write_text("#!/bin/sh\necho 'ERROR: connection refused' >&2\nexit 1\n")
    program.chmod(0o755)
    done = _audit(program, tmp_path / "constraints.txt")
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout == ("make audit: pip-audit could not ask the index (no network?): ERROR: connection refused\n")


@pytest.fixture
def service() -> Iterator[str]:
    """A service of holes that speaks OSV's protocol; it knows one."""

    class Answers(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            hole = {
                "id": "OSV-1",
                "aliases": [],
                "summary": "a hole",
                "affected": [
                    {
                        "package": {"name": "holey", "ecosystem": "PyPI"},
                        "ranges": [{"type": "ECOSYSTEM", "events": [{"introduced": "0"}, {"fixed": "2.1"}]}],
                    }
                ],
            }
            found = {"vulns": [hole]} if asked["package"]["name"] == "holey" else {}
            self.send_response(200)
            self.end_headers()
            self.wfile.write(json.dumps(found).encode())

        def log_message(self, *_: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_pip_audit_itself(tmp_path: Path, service: str) -> None:
    program = shutil.which("pip-audit", path=str(_ROOT / ".venv" / "audit" / "bin")) or shutil.which("pip-audit")
    if program is None:
        pytest.skip("needs pip-audit: `make .venv/audit.stamp` installs it")
    (tmp_path / "constraints.txt").write_text("good==1.0\nholey==2.0\n")
    done = _audit(program, tmp_path / "constraints.txt", "--vulnerability-service", "osv", "--osv-url", service)
    assert done.returncode == 1
    assert "holey 2.0: OSV-1, mended in 2.1" in done.stdout
    assert "2 of 2 packages looked up, 1 known holes" in done.stdout
