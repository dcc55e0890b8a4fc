"""Shapes in the types are enforced under test: every hfb module but the compiled kernels is checked at run time."""

import os
import pkgutil
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from hypothesis import settings
from jaxtyping import install_import_hook

import hfb
import tests.typechecking  # noqa: F401  (the hook finds the checker as an attribute of `tests`)

_LEAVES = [
    module.name
    for module in pkgutil.walk_packages([str(Path(hfb.__file__).parent)], "hfb.")
    if not module.ispkg and "kernels" not in module.name
]
install_import_hook(_LEAVES, "tests.typechecking.checked")

# A first call compiles kernels or waits for a busy machine: how long a case takes is no matter of right or wrong.
settings.register_profile("hfb", deadline=None, derandomize=True)
settings.load_profile("hfb")
