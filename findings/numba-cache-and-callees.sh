#!/usr/bin/env bash
# numba: a cached function goes on with the old code of a function that it calls in another file.
#
# Guess (2026-11-22): the cache's key covers what is compiled, so an edited callee is compiled again.
# Seen with numba 0.68.1: only the file of the function itself counts. After the callee's edit the caller gives the old value in every new
# process, the callee called by itself the new one. (numba's documentation says so; the symptom is two answers of one formula.)
# So: kernels that share helpers need a cache folder named by the hash of all their sources.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check numba==0.68.1 numpy==2.4.6
cd "$place"
printf 'import numba\n\n\n@numba.njit(cache=True)\ndef inner(x):\n    return x + 1\n' > callee.py
printf 'import callee\nimport numba\n\n\n@numba.njit(cache=True)\ndef outer(x):\n    return callee.inner(x)\n' > caller.py
ask() { "$place/venv/bin/python" -c 'import callee, caller; print(caller.outer(1), callee.inner(1))'; }
before=$(ask)
sed -i 's/x + 1/x + 100/' callee.py
after=$(ask)
echo "(caller, callee): before the edit $before, after it $after"
test "$before" = "2 2" && test "$after" = "2 101"
echo "numba 0.68.1: as found"
