"""Pickles that cost more than their bytes: steps, keys that collide, sizes that are none, names without end."""

import io
import pickle
import time
from typing import Any

import joblib
import numpy as np
import pytest
import torch

from hfb.errors import InputError
from hfb.io.safe import pickle_stream
from hfb.io.safe.pickle_reader import load_pickle
from hfb.io.safe.pickle_stream import Steps
from hfb.io.safe.pickled_arrays import to_array
from hfb.io.safe.torch_files import load_torch

COLLIDING = 2**61 - 1  # integers of this distance have the same hash


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """The least number of steps, small enough for a test to take them."""
    monkeypatch.setattr(pickle_stream, "_LEAST_STEPS", 1000)


def as_torch_does(content: bytes) -> bytes:
    """A pickled tensor outside torch.save: a file of the older kind, as bytes, loaded twice over."""
    heads = [pickle.dumps(one, 2) for one in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True})]
    inner = b"".join(heads) + content + pickle.dumps([], 2)
    return b"B" + len(inner).to_bytes(4, "little") + inner


@pytest.mark.usefixtures("few")
def test_steps_grow_with_the_file() -> None:
    many = b"N0" * 4000 + b"N."
    assert load_pickle(many) is None
    assert load_pickle(many, Steps(2000)) is None
    with pytest.raises(InputError, match=r"millions of steps.*without masks and features, or split it into shorter"):
        load_pickle(many, Steps(100))


@pytest.mark.usefixtures("few")
def test_what_is_nested_takes_from_the_same_steps() -> None:
    inner = as_torch_does(b"N0" * 300 + b"}.")
    head = b"ctorch.storage\n_load_from_bytes\nq\x00"
    assert load_pickle(head + inner + b"\x85R.", Steps(0)) == {}
    with pytest.raises(InputError, match="millions of steps"):
        load_pickle(head + inner + b"\x85q\x01" + b"0h\x00h\x01R" * 2 + b".", Steps(0))
    objects = io.BytesIO()
    joblib.dump([np.array([[None] * 250], dtype=object) for _ in range(4)], objects)
    load_pickle(objects.getvalue(), Steps(200))
    with pytest.raises(InputError, match="millions of steps"):
        load_pickle(objects.getvalue(), Steps(0))
    archive = io.BytesIO()
    torch.save([None] * 2000, archive)
    with pytest.raises(InputError, match="millions of steps"):
        load_torch(archive.getvalue(), Steps(0))


@pytest.mark.parametrize(
    "call",
    [
        b"ccollections\nOrderedDict\nh\x00\x85R",
        b"ctorch\nSize\nh\x00\x85R",
        b"cnumpy\ndtype\nh\x01R",
        b"cnumpy\ndtype\nh\x01\x81",
        b"cnumpy\ndtype\nh\x01}\x92",
        b"(cnumpy\ndtype\nh\x00o",
        b"(h\x00inumpy\ndtype\n",
    ],
)
@pytest.mark.usefixtures("few")
def test_a_list_that_is_handed_over_again_and_again(call: bytes) -> None:
    """Five bytes are worth the whole list each time."""
    pairs = b"](" + b"K\x01K\x02\x86" * 100 + b"eq\x00" + b"(" + b"N" * 100 + b"tq\x01"
    load_pickle(b"\x80\x04" + pairs + call + b".", Steps(0))
    with pytest.raises(InputError, match="millions of steps"):
        load_pickle(b"\x80\x04" + pairs + (call + b"0") * 10 + b"N.", Steps(0))


def test_bytes_that_are_copied_again_and_again() -> None:
    data = b"\x96" + (1 << 22).to_bytes(8, "little") + bytes(1 << 22)
    steps = Steps(0)
    before = steps.left
    load_pickle(b"\x80\x05" + data + b"q\x00" + b"cbuiltins\nbytes\nh\x00\x85R.", steps)
    assert before - steps.left > 1000


@pytest.mark.parametrize("key", [("walk", 3), ("walk", -1), "walk", 3, b"walk"])
def test_frames_by_text_and_number(key: Any) -> None:
    """PHALP without its own pictures keys frames so; for the same text no two numbers have the same hash."""
    assert load_pickle(pickle.dumps({key: 1, "b": 2})) == {key: 1, "b": 2}


@pytest.mark.parametrize(
    "key",
    [
        (3, "walk"),
        ("walk", "run"),
        ("walk", COLLIDING),
        ("walk", 1.5),
        ("walk", 1, 2),
        (("walk", 1), 2),
        ("walk",),
        (),
        ("walk", None),
        (b"walk", 1),
        COLLIDING,
        1.5,
        "w" * 5000,
        ("w" * 5000, 1),
    ],
)
def test_keys_that_could_collide(key: Any) -> None:
    for protocol in (0, 2, 4):
        with pytest.raises(InputError, match="a dictionary with a"):
            load_pickle(pickle.dumps({key: 1, "b": 2}, protocol))
        with pytest.raises(InputError, match="a dictionary with a"):
            load_pickle(pickle.dumps({key: 1}, protocol))


def test_sets_and_places_cannot_collide_either() -> None:
    for one in ({COLLIDING * n for n in range(5)}, frozenset([1.5])):
        for protocol in (0, 2, 4):
            assert load_pickle(pickle.dumps([one], protocol)[:]) == [None]
    with pytest.raises(InputError, match="dictionary"):
        load_pickle(b"(lp%d\n." % COLLIDING)


@pytest.mark.parametrize(
    "shape",
    [
        b"X\x01\x00\x00\x00aK\x20\x86",
        b"\x88K\x04\x86",
        b"J\xff\xff\xff\xffJ\xfc\xff\xff\xff\x86",
        b"X\x01\x00\x00\x00a",
        b"(" + b"\x8a\x10" * 1 + b"\xff" * 15 + b"\x7f" + b"t",
        b"(" + b"K\x01" * 100 + b"K\x04t",
    ],
    ids=["text", "bool", "negative", "no tuple", "huge", "sides"],
)
def test_sides_that_are_none(shape: bytes) -> None:
    stream = io.BytesIO()
    joblib.dump(np.zeros(4), stream)
    whole = stream.getvalue()
    frame = whole.index(b"\x95")
    unframed = whole[:frame] + whole[frame + 9 :]
    old = b"shape\x94K\x04\x85"
    assert old in unframed
    with pytest.raises(InputError, match="impossible shape"):
        load_pickle(unframed.replace(old, b"shape\x94" + shape))


def test_the_product_of_many_sides_is_not_taken() -> None:
    array = load_pickle(pickle.dumps(np.zeros(4)))
    array.state = ((1 << 30,) * 100_000, *array.state[1:])
    started = time.process_time()  # not the clock on the wall: other processes would count
    with pytest.raises(InputError, match="impossible shape"):
        to_array(array)
    assert time.process_time() - started < 1


def test_names_without_end() -> None:
    with pytest.raises(InputError, match="endless name"):
        load_pickle(b"cchumpy" + b".a" * 1000 + b"\nCh\n.")
    endless = (
        b"]q\x00(" + b"K\x01" * 10 + b"e" + b"".join(b"](" + b"h%c" % n * 10 + b"eq%c" % (n + 1) for n in range(9))
    )
    heads = b"".join(pickle.dumps(one, 2) for one in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True}))
    with pytest.raises(InputError, match="list of tensors"):
        load_torch(heads + pickle.dumps({}, 2) + b"\x80\x02" + endless + b"\x85.")
    reference = b"\x80\x02(X\x07\x00\x00\x00storagectorch\nFloatStorage\n" + endless + b"NK\x01tQ."
    with pytest.raises(InputError, match="without a name"):
        load_torch(heads + reference)
