"""Small files that hold the same large part over and over: nothing is copied, or put together, each time."""

import pickle
import time
import tracemalloc
from pathlib import Path
from typing import Any

import joblib
import pytest
import torch

from hfb.errors import InputError
from hfb.interop.readers import parts
from hfb.interop.readers.sniff import read_tracks
from tests.interop.readers import files
from tests.interop.readers.files import HEIGHT, WIDTH, Person


def large_by_reference(kind: str) -> Any:
    keys = {str(n): 0 for n in range(1500)}
    if kind == "frames of the same person":
        one = {"pred_keypoints_3d": 0, "pred_cam_t": 0, "focal_length": 0, **keys}
        return [[one] * 1500] * 1500
    needed = {
        "WHAM": ("pose", "trans", "betas", "frame_ids"),
        "PyMAF": ("pose", "betas", "orig_cam"),
        "PHALP": ("tid", "smpl", "camera"),
        "nobody's": (),
    }[kind]
    one: dict[str, Any] = {**keys, **{name: [] for name in needed}}
    return dict.fromkeys(range(3000), one)


@pytest.mark.parametrize("kind", ["WHAM", "PyMAF", "PHALP", "nobody's", "frames of the same person"])
def test_the_same_dictionary_a_thousand_times_is_not_copied(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "small.pkl"
    path.write_bytes(pickle.dumps(large_by_reference(kind)))
    assert path.stat().st_size < 40_000
    began = time.process_time()
    with pytest.raises(InputError, match=r"over and over|people more than|no result that hfb knows"):
        read_tracks([path], HEIGHT, WIDTH)
    assert time.process_time() - began < 2


def test_the_same_tensor_a_hundred_times_is_not_put_together(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    torch.save({"joints": [torch.zeros(1).expand(1 << 24)] * 100}, path)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="arrays of more than"):
            read_tracks([path], HEIGHT, WIDTH)
        assert tracemalloc.get_traced_memory()[1] < 600 << 20  # of 6.4 GB
    finally:
        tracemalloc.stop()


def test_the_rows_of_all_people_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "_MAX_ROWS", 12)
    written = files.wham(tmp_path, Person.some())
    joblib.dump(dict.fromkeys(range(2), written.content[0]), written.path)
    assert len(read_tracks([written.path], HEIGHT, WIDTH)) == 2
    joblib.dump(dict.fromkeys(range(3), written.content[0]), written.path)
    with pytest.raises(InputError, match="more than 12 rows"):
        read_tracks([written.path], HEIGHT, WIDTH)
