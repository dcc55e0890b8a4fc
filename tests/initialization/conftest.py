"""Where the shared data lies, if it is there."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real pictures beside the project; tests that need them are skipped elsewhere."""
    folder = Path(os.environ.get("HFB_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no shared data in {folder} (set HFB_SHARED_DATA)")
    return folder
