#!/usr/bin/env bash
# numba: a float32 times the literal 2 is float64, where NumPy 2 stays in float32.
#
# Guess (2026-11-28): since NumPy 2 a Python number takes the array's type, and numba follows.
# Seen with numba 0.68.1 and NumPy 2.4.6: `x[i] * 2` and `x[i] / 2` of float32 are float64, as under NumPy 1; `x[i] * np.float32(2)` is float32.
# So: a kernel written in float32 computes half of its terms in double precision, with other bits than its NumPy reference; write np.float32(2).
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check numba==0.68.1 numpy==2.4.6
"$place/venv/bin/python" - <<'PY'
import numba
import numpy as np

TWO = np.float32(2)


def twice(x):
    return x[0] * 2


def half(x):
    return x[0] / 2


def typed(x):
    return x[0] * TWO


x = np.full(3, 0.1, np.float32)
found = {}
for function in (twice, half, typed):
    compiled = numba.njit(function)
    compiled(x)
    found[function.__name__] = str(compiled.nopython_signatures[0].return_type), str(function(x).dtype)
print("(numba, NumPy):", found)
assert found["twice"] == found["half"] == ("float64", "float32"), found
assert found["typed"] == ("float32", "float32"), found
print(f"numba {numba.__version__}, NumPy {np.__version__}: as found")
PY
