"""A pickle runs code where it is opened. Here none does: at every place of every file it is refused by name."""

import copy
import io
import os
import pickle
import resource
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
import torch

from hfb.errors import InputError
from hfb.interop.readers.sniff import read_tracks
from hfb.io.safe import contents, pickle_stream
from hfb.io.safe.contents import read_contents
from hfb.io.safe.pickled_arrays import to_array
from hfb.io.safe.torch_files import load_torch
from tests.interop.readers import files
from tests.interop.readers.files import HEIGHT, PICKLED, WIDTH, Person

WRITERS = [files.pymaf, files.hybrik, files.phalp, files.wham, files.tram, files.sam3d, files.nlf]


class Attack:
    """What a hostile file holds: opened by pickle, it writes a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> Any:
        return os.system, (f"touch {self.target}",)


def places(content: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where something stands in nested dictionaries and lists, from the outside in."""
    yield above
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in inner:
        yield from places(value, (*above, key))


def with_attack(content: Any, place: tuple[Any, ...], attack: Attack) -> Any:
    if not place:
        return attack
    changed = copy.deepcopy(content)
    inside = changed
    for key in place[:-1]:
        inside = inside[key]
    inside[place[-1]] = attack
    return changed


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_no_place_of_a_result_runs(tmp_path: Path, write: Any) -> None:
    written = write(tmp_path, Person.some(count=files.COUNT))
    attack = Attack(tmp_path / "attacked")
    tried = 0
    for place in places(written.content):
        PICKLED[written.path.name](with_attack(written.content, place, attack), written.path)
        with pytest.raises(InputError, match=r"asks for posix\.system"):
            read_tracks([written.path], HEIGHT, WIDTH)
        assert not attack.target.exists()
        tried += 1
    assert tried > 5


def test_no_place_of_a_torch_file_runs(tmp_path: Path) -> None:
    written = files.gvhmr(tmp_path, Person.some(), np.zeros((1, 3)))
    attack = Attack(tmp_path / "attacked")
    for place in places(written.content):
        for zipped in (True, False):
            changed = with_attack(written.content, place, attack)
            torch.save(changed, written.path, _use_new_zipfile_serialization=zipped)
            with pytest.raises(InputError, match=r"asks for posix\.system"):
                read_tracks([written.path], HEIGHT, WIDTH)
    assert not attack.target.exists()


def test_the_camera_beside_a_result_does_not_run_either(tmp_path: Path) -> None:
    written = files.tram(tmp_path, Person.some())
    attack = Attack(tmp_path / "attacked")
    np.save(tmp_path / "camera.npy", np.array({"img_focal": attack}, dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match=r"camera\.npy cannot be used: its pickle asks for posix\.system"):
        read_tracks([written.path, tmp_path / "camera.npy"], HEIGHT, WIDTH)
    assert not attack.target.exists()


def test_an_attack_within_a_tensors_own_file(tmp_path: Path) -> None:
    """A tensor outside torch.save is pickled as bytes that torch would open in turn."""
    attack = Attack(tmp_path / "attacked")
    inner = io.BytesIO()
    torch.save(attack, inner, _use_new_zipfile_serialization=False)

    class Nested:
        def __reduce__(self) -> Any:
            return torch.storage._load_from_bytes, (inner.getvalue(),)

    path = tmp_path / "hps_track_0.npy"
    np.save(path, np.array({"frame": Nested()}, dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match=r"asks for posix\.system"):
        read_tracks([path], HEIGHT, WIDTH)
    joblib.dump({"a": np.array([attack, 1], dtype=object)}, tmp_path / "o.pkl")
    with pytest.raises(InputError, match=r"asks for posix\.system"):
        read_tracks([tmp_path / "o.pkl"], HEIGHT, WIDTH)
    assert not attack.target.exists()


def test_a_promise_of_more_than_there_is(tmp_path: Path) -> None:
    """Sizes are checked against the bytes that are there before anything is allocated."""
    data = io.BytesIO()
    joblib.dump(np.zeros(4), data)
    lying = data.getvalue().replace(b"shape\x94K\x04\x85", b"shape\x94K\xff\x85")
    assert lying != data.getvalue()
    (tmp_path / "a.pkl").write_bytes(lying)
    with pytest.raises(InputError, match="cut off"):
        read_tracks([tmp_path / "a.pkl"], HEIGHT, WIDTH)
    bomb = tmp_path / "bomb.npz"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("joints.npy", b"\0" * (1 << 20))
    content = bytearray(bomb.read_bytes())
    at = content.find(b"PK\x01\x02")
    content[at + 24 : at + 28] = (0xF0000000).to_bytes(4, "little")
    bomb.write_bytes(bytes(content))
    with pytest.raises(InputError, match="larger than 512 MB"):
        read_tracks([bomb], HEIGHT, WIDTH)


@pytest.mark.parametrize("zipped", [True, False])
@pytest.mark.parametrize(
    "tensor",
    [
        torch.arange(24.0).reshape(2, 3, 4),
        torch.arange(24.0).reshape(2, 3, 4).transpose(0, 2)[1:],
        torch.arange(5).half(),
        torch.arange(5).bfloat16(),
        torch.arange(6).reshape(2, 3),
        torch.tensor([True, False]),
        torch.tensor(3.5, dtype=torch.float64),
        torch.zeros(0, 3),
        torch.nn.Parameter(torch.ones(2)),
    ],
)
def test_tensors_without_torch(tensor: torch.Tensor, zipped: bool) -> None:
    """What torch.save wrote, and what a bare pickle or joblib makes of the tensor, is read to the last bit."""
    stream = io.BytesIO()
    torch.save({"a": [tensor]}, stream, _use_new_zipfile_serialization=zipped)
    expected = tensor.detach().float().numpy()
    np.testing.assert_array_equal(to_array(load_torch(stream.getvalue())["a"][0]), expected)


def test_damaged_torch_files_are_a_sentence() -> None:
    for zipped in (True, False):
        stream = io.BytesIO()
        torch.save({"a": torch.arange(1000.0)}, stream, _use_new_zipfile_serialization=zipped)
        whole = stream.getvalue()
        for cut in (10, len(whole) // 2, len(whole) - 300):
            with pytest.raises(InputError):
                load_torch(whole[:cut])
    wrong = io.BytesIO()
    torch.save(pickle.dumps({}), wrong)
    assert load_torch(wrong.getvalue()) == pickle.dumps({})


@pytest.mark.parametrize(
    ("place", "others"),
    [
        ("joints", {}),
        ("K", {"joints": np.ones((1, 24, 3))}),
        ("thetas", {}),
        ("poses", {"trans": [[0.0] * 3], "mocap_framerate": 30}),
    ],
)
def test_lists_of_the_same_list_are_not_multiplied_out(tmp_path: Path, place: str, others: dict[str, Any]) -> None:
    endless: list[Any] = [0.0]
    for _ in range(18):
        endless = [endless] * 10  # 10 ** 18 numbers in a few hundred bytes
    path = tmp_path / "small.pkl"
    path.write_bytes(pickle.dumps({place: endless, **others}))
    assert path.stat().st_size < 4000
    before = resource.getrlimit(resource.RLIMIT_AS)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (size + (1 << 29), before[1]))  # an error here, not the end of the machine
    try:
        with pytest.raises(InputError) as refused:
            read_tracks([path], HEIGHT, WIDTH)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    assert "MemoryError" not in str(refused.value)


def object_array(path: Path, shape: bytes, objects: list[Any]) -> Path:
    """A .npy file whose pickle says that its objects have this shape."""
    stream = io.BytesIO()
    held = np.empty(len(objects), dtype=object)
    held[:] = objects
    np.save(stream, held, allow_pickle=True)
    whole = stream.getvalue()
    start = whole.index(b"\n") + 1
    before, _, after = pickle.dumps(held, 2).rpartition(b"K%c\x85" % len(objects))
    path.write_bytes(whole[:start] + before + shape + after)
    return path


def test_objects_in_an_array_of_many_sides(tmp_path: Path) -> None:
    many, some, other, text = b"(" + b"K\x01" * 5000 + b"t", b"(" + b"K\x01" * 20 + b"t", b"K\x02\x85", b"U\x01a\x85"
    for shape in (many, some, other, text):
        with pytest.raises(InputError, match="impossible shape"):
            read_contents(object_array(tmp_path / "a.npy", shape, [{"a": 1}]))
    rows_of_none = b"\x8a\x05\0\0\0\0\x40K\x00\x86"  # 2 ** 38 of them
    assert read_contents(object_array(tmp_path / "a.npy", rows_of_none, [])) == []
    assert read_contents(object_array(tmp_path / "a.npy", b"K\x02K\x01\x86", [3, 4])) == [[3], [4]]
    assert read_contents(object_array(tmp_path / "a.npy", b")", [{"a": 1}])) == {"a": 1}


@pytest.mark.parametrize(
    ("error", "says"),
    [(KeyError("a"), r"damaged \(KeyError"), (RecursionError(), "damaged"), (MemoryError(), "memory")],
)
def test_what_nobody_foresaw_is_a_sentence(
    tmp_path: Path, error: Exception, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_arguments: Any) -> None:
        raise error

    (tmp_path / "a.pkl").write_bytes(b"N.")
    monkeypatch.setattr(contents, "load_pickle", fail)
    with pytest.raises(InputError, match=rf"a\.pkl cannot be used: it .*{says}.*; give a result file of"):
        read_contents(tmp_path / "a.pkl")


def test_all_members_of_a_file_take_from_the_same_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The budget is the file's as it lies on the disk: what it unpacks to counts nothing."""
    monkeypatch.setattr(pickle_stream, "_LEAST_STEPS", 6000)
    for count, path in ((1, tmp_path / "one.npz"), (10, tmp_path / "many.npz")):
        members = {f"a{n}": np.array([[None] * 5000, None], dtype=object) for n in range(count)}
        np.savez_compressed(path, **members)
    assert len(read_contents(tmp_path / "one.npz")) == 1
    with pytest.raises(InputError, match=r"many\.npz cannot be used: it takes millions of steps.*shorter files"):
        read_contents(tmp_path / "many.npz")
    joblib.dump([None] * 100_000, tmp_path / "packed.pkl", compress=9)
    assert (tmp_path / "packed.pkl").stat().st_size < 3000
    with pytest.raises(InputError, match="millions of steps"):
        read_contents(tmp_path / "packed.pkl")


def test_long_files_of_phalp_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many small objects per frame: what it takes grows with the file, also where it is packed."""
    monkeypatch.setattr(pickle_stream, "_LEAST_STEPS", 0)
    written = files.phalp(tmp_path, Person.some(count=files.COUNT))
    _, frame = sorted(written.content.items())[-1]
    rng = np.random.default_rng(0)
    frames = {}
    for n in range(60):
        smpl = {name: value + rng.normal(0, 1e-3, value.shape) for name, value in frame["smpl"][0].items()}
        frames["walk", n] = {**frame, "time": n, "smpl": [smpl]}  # so are its keys with extract_video=False
    joblib.dump(frames, written.path, compress=3)
    (track,) = read_tracks([written.path], HEIGHT, WIDTH)
    assert list(track.frames) == list(range(60))
