#!/usr/bin/env bash
# OpenCV: FileStorage reads a matrix whose rows are indented, and ends in a SystemError where the dashes stand below their key, as YAML writers put them.
#
# Guess (2026-11-28): FileStorage reads the YAML of calibration tools, or says that it cannot.
# Seen with opencv-python-headless 5.0.0.93: `T:` followed by `- [1, 2]` at the same column is valid YAML and what PyYAML writes (Kalibr's
# camchain files are so): "returned a result with an exception set". With two blanks before the dash, or in one line, it is read.
# So: read calibration files with a YAML parser; FileStorage is for files that OpenCV wrote.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6 pyyaml==6.0.3
cd "$place"
"$place/venv/bin/python" - <<'PY' 2>/dev/null
import cv2
import yaml

MATRIX = [[1.0, 2.0], [3.0, 4.0]]
HEAD = "%YAML:1.0\n---\n"
texts = {
    "in a line": "T: [[1.0, 2.0], [3.0, 4.0]]\n",
    "indented": "T:\n  - [1.0, 2.0]\n  - [3.0, 4.0]\n",
    "below its key": yaml.safe_dump({"T": MATRIX}, default_flow_style=None),
}
assert texts["below its key"] == "T:\n- [1.0, 2.0]\n- [3.0, 4.0]\n"
assert all(yaml.safe_load(text) == {"T": MATRIX} for text in texts.values())
found = {}
for name, text in texts.items():
    with open("camera.yaml", "w") as file:
        file.write(HEAD + text)
    try:
        storage = cv2.FileStorage("camera.yaml", cv2.FILE_STORAGE_READ)
        node = storage.getNode("T")
        found[name] = [[node.at(row).at(column).real() for column in (0, 1)] for row in (0, 1)]
    except SystemError as error:
        found[name] = type(error).__name__
print(found)
assert found == {"in a line": MATRIX, "indented": MATRIX, "below its key": "SystemError"}, found
print(f"OpenCV {cv2.__version__}: as found")
PY
