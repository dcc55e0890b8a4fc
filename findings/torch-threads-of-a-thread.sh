#!/usr/bin/env bash
# torch: set_num_threads in one thread leaves another thread, which has computed before, with its old number.
#
# Guess (2026-11-28): the number of threads is a setting of the process.
# Seen with torch 2.13.0: a thread that has multiplied matrices once reports, and uses, the old number afterwards; the main thread reports
# the new one.
# So: a pool of threads must set it in each of its threads.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check torch==2.13.0 numpy==2.4.6
OMP_NUM_THREADS=2 "$place/venv/bin/python" - <<'PY'
import threading

import torch

seen, ready, go = {}, threading.Event(), threading.Event()


def work():
    torch.rand(500, 500) @ torch.rand(500, 500)
    seen["before"] = torch.get_num_threads()
    ready.set()
    go.wait()
    seen["after"] = torch.get_num_threads()


thread = threading.Thread(target=work)
thread.start()
ready.wait()
torch.set_num_threads(1)
go.set()
thread.join()
print(seen, "main thread:", torch.get_num_threads())
assert torch.get_num_threads() == 1
assert seen == {"before": 2, "after": 2}, seen
print(f"torch {torch.__version__}: as found")
PY
