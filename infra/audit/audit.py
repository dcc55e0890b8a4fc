"""Known holes of the pinned packages: python infra/audit/audit.py PIP_AUDIT REQUIREMENTS [options of pip-audit].

All packages are looked up, whatever becomes of one. Holes come first, then what the index does not know: a package that
nobody could look up is no pass. Exit code 0: every package was looked up, and none has a known hole.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

_OPTIONS = ("--no-deps", "--disable-pip", "--progress-spinner", "off", "--format", "json")


def main(program: str, requirements: str, *more: str) -> int:
    """Run pip-audit and tell what it found; the exit code."""
    done = subprocess.run(
        [program, "--requirement", requirements, *_OPTIONS, *more], capture_output=True, text=True, check=False
    )
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except (ValueError, KeyError, TypeError):
        reason = done.stderr.strip().splitlines()[-1:] or ["it said nothing"]
        print(f"make audit: pip-audit could not ask the index (no network?): {reason[0]}")
        return 1
    lines, code = report(packages)
    print("\n".join(lines))
    return code


def report(packages: list[dict[str, Any]]) -> tuple[list[str], int]:
    """What to print of pip-audit's list of packages, and the exit code."""
    holes = [
        f"{one['name']} {one['version']}: {hole['id']}, mended in {', '.join(hole['fix_versions']) or 'no version yet'}"
        for one in packages
        for hole in one.get("vulns", ())
    ]
    unknown = [one["name"] for one in packages if "skip_reason" in one]
    looked_up = f"{len(packages) - len(unknown)} of {len(packages)} packages looked up, {len(holes)} known holes"
    lines = [*holes, f"make audit: {looked_up}"]
    if unknown:
        lines.append(f"make audit: not known to the index, look them up yourself: {', '.join(unknown)}")
    return lines, 1 if holes or unknown or not packages else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
