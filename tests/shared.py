"""Real recordings beside the project, and inputs on which hfb was wrong; tests that need them are skipped elsewhere."""

import os
from pathlib import Path

_BESIDE = Path(__file__).parents[2] / "shared"
SHARED_DATA = Path(os.environ.get("HFB_SHARED_DATA", _BESIDE / "data"))
REPORTS = _BESIDE / "reports"
