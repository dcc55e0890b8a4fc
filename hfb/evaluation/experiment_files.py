"""Files of the paper's experiments; light to import, so that a misspelt name is reported at once."""

from importlib import resources
from importlib.resources.abc import Traversable

from hfb.errors import InputError

_FILES = resources.files("hfb.evaluation") / "data"


def experiment_names() -> list[str]:
    """Return the names of the paper's tables and figures that hfb comes with."""
    return sorted(one.name.removesuffix(".toml") for one in _FILES.iterdir() if one.name.endswith(".toml"))


def experiment_file(name: str) -> Traversable:
    """Return the file of one of the paper's tables or figures, such as ``table1``.

    Args:
        name: name such as ``table1``.

    Raises:
        InputError: there is none of that name.
    """
    if name not in experiment_names():
        raise InputError(f"there is no experiment called {name}: known are {', '.join(experiment_names())}")
    return _FILES / f"{name}.toml"
