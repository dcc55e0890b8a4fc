"""Read a pickle without running it."""

from typing import Any

from hfb.io.safe.pickle_stream import Bytes, Steps
from hfb.io.safe.pickles import load_from
from hfb.io.safe.torch_files import load_torch


def load_pickle(data: bytes, steps: Steps | None = None) -> Any:
    """Read a pickle, with placeholders for everything that is not a plain Python value.

    Args:
        data: content of the pickle.
        steps: limit of the work, shared where it is a part of a file, or was compressed.

    Raises:
        InputError: it names anything but arrays, or is not a whole pickle; the text continues "FILE cannot be
            used: ".
    """
    return load_from(Bytes(data, steps), load_torch)
