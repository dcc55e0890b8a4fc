"""Files made to harm: pickles that call, promises of huge sizes, bombs, nesting without end."""

import bz2
import gzip
import io
import json
import lzma
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import joblib
import numpy as np
import torch

CANARY = "canary"
"""What code that ran would leave in the current folder."""


class _Attack:
    """Opened by pickle, it writes a file."""

    def __reduce__(self) -> Any:
        return exec, (f"open({CANARY!r}, 'w').close()",)


def hostile(name: str, rng: np.random.Generator) -> bytes:
    """A file that is hostile to whoever opens one of this name."""
    ways = _ways(name)
    return ways[rng.integers(len(ways))](rng)


def _ways(name: str) -> list[Callable[[np.random.Generator], bytes]]:
    if name.endswith((".png", ".jpg", ".tiff", ".bmp", ".webp")):
        return [_large_png, _endless_text_in_png, _tiff_promise, _bmp_promise]
    if name.endswith((".toml", ".json", ".csv", ".yaml", ".xml", ".bvh", ".trc")):
        return [_many_keys, _long_line, _yaml_promise, _json_promise, _rows, _bvh_promise, _aliases]
    if name.endswith((".mp4", ".mkv", ".avi", ".mov", ".ts", ".gif", ".webm")):
        return [_playlist, _concat, _svg, _large_png]
    if name.endswith(".safetensors"):
        return [_tensors_promise, *_PICKLES]
    if name.endswith(".onnx"):
        return [_outside_weights, *_PICKLES]
    return [_zip_bomb, _many_members, _array_promise, *_PICKLES]


def _pickled(rng: np.random.Generator) -> bytes:
    trap: Any = _Attack()
    content = (trap, {"poses": trap}, [1, {"a": [trap]}], {"means": np.array([trap], dtype=object)})[rng.integers(4)]
    return pickle.dumps(content, int(rng.integers(0, 6)))


def _by_name(rng: np.random.Generator) -> bytes:
    """Opcodes by hand: names that look harmless, and what is behind them."""
    names = (
        b"cos\nsystem\n",
        b"cbuiltins\neval\n",
        b"cnumpy\nload\n",
        b"ctorch\nload\n",
        b"cjoblib\nload\n",
        b"ctorch.storage\n_load_from_bytes\n",
        b"cnumpy.core.multiarray\nscalar.__class__\n",
        b"ccopyreg\n__newobj__\n",
        b"cnumpy\nndarray.tofile\n",
        b"\x8c\x02os\x8c\x06system\x93",
        b"cchumpy.ch\nos.system\n",
        b"cscipy.sparse\ncsc_matrix.__init__\n",
        b"cpathlib\nPath\n",
        b"cbuiltins\nbytearray\n",
        b"\x82\x01",
        b"cbuiltins\ngetattr\n",
    )
    called = (f"(S'touch {CANARY}'\ntR.".encode(), b"(I2000000000\ntR.", b"(tR.", b"}b.")
    return b"\x80\x04" + names[rng.integers(len(names))] + called[rng.integers(len(called))]


def _laughs(rng: np.random.Generator) -> bytes:
    """Lists of the same list: a few hundred bytes that are 10 ** 20 numbers when they are walked through."""
    inner: Any = [1.0] * 10
    for _ in range(int(rng.integers(5, 20))):
        inner = [inner] * 10
    return pickle.dumps(
        (inner, {"poses": inner, "trans": inner}, {"pred_rotmat": inner}, {"joints": inner})[rng.integers(4)]
    )


def _cycle(rng: np.random.Generator) -> bytes:
    own: Any = []
    own.append(own)
    around: dict[str, Any] = {"poses": own, "joints": own, "D": own}
    around["smpl"] = around
    return pickle.dumps((own, around)[rng.integers(2)])


def _same_hash(rng: np.random.Generator) -> bytes:
    """Keys that Python's dictionary puts into one place: the time grows with the square of their number."""
    keys = (number * (2**61 - 1) for number in range(int(rng.integers(20_000, 60_000))))
    return b"\x80\x04}(" + b"".join(b"\x8a\x0b" + key.to_bytes(11, "little") + b"N" for key in keys) + b"u."


def _memo(rng: np.random.Generator) -> bytes:
    return b"\x80\x04Nr" + struct.pack("<I", int(rng.integers(1 << 28, 1 << 32))) + b"."


def _long_number(rng: np.random.Generator) -> bytes:
    return b"I" + b"9" * int(rng.integers(5000, 500_000)) + b"\n."


def _by_joblib(rng: np.random.Generator) -> bytes:
    stream = io.BytesIO()
    joblib.dump({"poses": np.array([_Attack(), 1], dtype=object)}, stream, compress=int(rng.integers(0, 3)))
    return stream.getvalue()


def _by_torch(rng: np.random.Generator) -> bytes:
    stream = io.BytesIO()
    content = ({"state_dict": _Attack()}, _Attack(), {"pred_rotmat": [torch.zeros(2), _Attack()]})[rng.integers(3)]
    torch.save(content, stream, _use_new_zipfile_serialization=bool(rng.integers(2)))
    return stream.getvalue()


def _by_numpy(rng: np.random.Generator) -> bytes:
    stream = io.BytesIO()
    array = np.array([_Attack()], dtype=object)
    names = ("poses", "joints", "means", "v_template", "frames", "id", "D", "pose")
    if rng.integers(2):
        np.save(stream, array, allow_pickle=True)
    else:
        np.savez(stream, **{names[rng.integers(len(names))]: array}, allow_pickle=True)
    return stream.getvalue()


def _packed_bomb(rng: np.random.Generator) -> bytes:
    """Nothing but zeros, packed as joblib packs."""
    pack = (zlib.compress, partial(gzip.compress, mtime=0), bz2.compress, lzma.compress)[rng.integers(4)]
    return pack(b"\x80\x04" + b"N0" * (16 << 20) + b"N.")


_PICKLES = [
    _pickled,
    _pickled,
    _by_name,
    _by_name,
    _laughs,
    _cycle,
    _same_hash,
    _memo,
    _long_number,
    _by_joblib,
    _by_torch,
    _by_numpy,
    _packed_bomb,
]


def archive(members: Iterable[tuple[str, bytes]], level: int | None = 6) -> bytes:
    """A zip whose bytes do not tell when it was made; not packed where there is no level."""
    stream = io.BytesIO()
    how = zipfile.ZIP_STORED if level is None else zipfile.ZIP_DEFLATED
    with zipfile.ZipFile(stream, "w") as packed:
        for name, content in members:
            packed.writestr(zipfile.ZipInfo(name), content, how, level)
    return stream.getvalue()


def _zip_bomb(rng: np.random.Generator) -> bytes:
    """Members of 64 MB of zeros, again and again."""
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (8388608,), }\n"
    member = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + bytes(8388608 * 8)
    names = (
        "poses",
        "trans",
        "joints",
        "means",
        "covars",
        "weights",
        "v_template",
        "frame",
        "id",
        "box",
        "xyz",
        "pose",
    )
    return archive([(f"{name}.npy", member) for name in names[: rng.integers(1, 4)]], 1)


def _many_members(rng: np.random.Generator) -> bytes:
    count = int(rng.integers(10_000, 20_000))
    return archive([(f"{number}/../../{CANARY}.npy", b"") for number in range(count)], None)


def _array_promise(rng: np.random.Generator) -> bytes:
    """Headers that promise what is not there."""
    shape = ("(100000000000,)", "(65536, 65536, 3)", "(0, 4611686018427387904)", "(4294967296, 4294967296)")[
        rng.integers(4)
    ]
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    member = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + bytes(64)
    if rng.integers(2):
        return member
    names = (
        "poses",
        "trans",
        "joints",
        "means",
        "weights",
        "covars",
        "v_template",
        "frame",
        "id",
        "box",
        "frames",
    )
    return archive([(f"{name}.npy", member) for name in names], None)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _large_png(rng: np.random.Generator) -> bytes:
    """Some hundred kilobytes that are a picture of 63 megapixels, or of far more."""
    width, height = ((9000, 7000), (12_000, 9000), (60_000, 60_000), (1 << 31, 1), (1, 1 << 30))[rng.integers(5)]
    lines = min(width * height * 3 + height + (1 << 20), 191_000_000)
    head = _chunk(b"IHDR", struct.pack(">IIBBBBB", width & 0xFFFFFFFF, height, 8, 2, 0, 0, 0))
    packer = zlib.compressobj(1)
    packed = b"".join([*(packer.compress(bytes(1 << 20)) for _ in range(lines >> 20)), packer.flush()])
    return b"\x89PNG\r\n\x1a\n" + head + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def _endless_text_in_png(rng: np.random.Generator) -> bytes:
    text = zlib.compress(bytes(int(rng.integers(1 << 20, 1 << 26))))
    head = _chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0))
    pixels = _chunk(b"IDAT", zlib.compress(bytes(52)))
    return b"\x89PNG\r\n\x1a\n" + head + _chunk(b"zTXt", b"a\0\0" + text) * 3 + pixels + _chunk(b"IEND", b"")


def _tiff_promise(rng: np.random.Generator) -> bytes:
    """A directory whose entries count and point beyond everything."""
    count = int(rng.choice([1, 1 << 16, (1 << 32) - 1]))
    tags = (
        (256, 4, 1, 8000), (257, 4, 1, 7000), (258, 3, 3, 8), (262, 3, 1, 2), (273, 4, count, 8), (277, 3, 1, 3),
        (279, 4, count, 8),
    )  # fmt: skip
    entries = b"".join(struct.pack("<HHII", *one) for one in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + struct.pack("<I", int(rng.choice([0, 8])))


def _bmp_promise(rng: np.random.Generator) -> bytes:
    width, height = ((65_535, 65_535), (9000, 7000), (-5, 10))[rng.integers(3)]
    return (
        b"BM"
        + struct.pack("<IHHI", 54, 0, 0, 54)
        + struct.pack("<IiiHHIIiiII", 40, width, height, 1, 24, 0, 0, 0, 0, 0, 0)
    )


def _many_keys(rng: np.random.Generator) -> bytes:
    return b"".join(b"a%d = 1\n" % number for number in range(int(rng.integers(1000, 20_000)))) + b"a.b.c.d = 1\n" * 50


def _long_line(rng: np.random.Generator) -> bytes:
    return (b"1,", b"a.", b"[", b"HIERARCHY ", b"\t", b"a = 1 ")[rng.integers(6)] * int(rng.integers(1000, 300_000))


def _aliases(rng: np.random.Generator) -> bytes:
    text = "%YAML:1.0\n---\na: &a [x, x, x]\n"
    for number in range(int(rng.integers(5, 40))):
        text += f"b{number}: &b{number} [*a, *a, *a, *a]\n"
    return text.encode()


def _yaml_promise(rng: np.random.Generator) -> bytes:
    rows, columns = ((100_000, 100_000), (-1, 3), (3, 1 << 30), (46_341, 46_341))[rng.integers(4)]
    sizes = f"   rows: {rows}\n   cols: {columns}\n"
    return f"%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n{sizes}   dt: d\n   data: [ 1. ]\n".encode()


def _json_promise(rng: np.random.Generator) -> bytes:
    numbers: Any = [[[0.0] * 3] * 24] * int(rng.integers(10, 3000))
    return json.dumps({"joints": numbers, "K": [[1e400, 0, 1], [0, 1, 0], [0, 0, 1]]}).encode()


def _rows(rng: np.random.Generator) -> bytes:
    names = "\t".join(f"m{number}" for number in range(2000))
    head = f"PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate NumMarkers Units\n25 2000 m\nFrame#\tTime\t{names}\n\n"
    return (head + "".join(f"{number}\t{number / 25}\n" for number in range(int(rng.integers(100, 20_000))))).encode()


def _bvh_promise(rng: np.random.Generator) -> bytes:
    frames = int(rng.choice([999_999_999, 2, 0]))
    depth = int(rng.integers(1, 3000))
    head = (
        "".join(f"{'JOINT' if n else 'ROOT'} j{n}\n{{\nOFFSET 0 1 0\nCHANNELS 0\n" for n in range(depth))
        + "}\n" * depth
    )
    return f"HIERARCHY\n{head}MOTION\nFrames: {frames}\nFrame Time: .01\n{'1 ' * 5000}\n".encode()


def _playlist(rng: np.random.Generator) -> bytes:
    """What FFmpeg takes for a list of other files, or of addresses, whatever the file is called."""
    what = ("/etc/passwd", "http://127.0.0.1:9/x.ts", "../seed.mp4", "concat:/etc/passwd|/etc/passwd")[rng.integers(4)]
    return f"#EXTM3U\n#EXT-X-TARGETDURATION:5\n#EXTINF:5,\n{what}\n#EXT-X-ENDLIST\n".encode()


def _concat(rng: np.random.Generator) -> bytes:
    return (b"ffconcat version 1.0\nfile /etc/passwd\n", b"v=0\nm=video 9 RTP/AVP 96\n", b"<MPD></MPD>")[
        rng.integers(3)
    ]


def _svg(rng: np.random.Generator) -> bytes:
    del rng
    return b'<svg xmlns="http://www.w3.org/2000/svg"><image href="file:///etc/passwd"/></svg>'


def _tensors_promise(rng: np.random.Generator) -> bytes:
    length = int(rng.choice([1 << 62, 1 << 40, 100_000_000, 0]))
    return length.to_bytes(8, "little") + b'{"means":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}' + bytes(4)


def _outside_weights(rng: np.random.Generator) -> bytes:
    """A network whose numbers are to be found in another file."""
    from onnx import TensorProto, helper

    place = ("/etc/passwd", "../../etc/passwd", "graph.data")[rng.integers(3)]
    outside = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[4], data_location=TensorProto.EXTERNAL)
    outside.external_data.add(key="location", value=place)
    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [4])
    graph = helper.make_graph(
        [helper.make_node("Add", ["x", "w"], ["y"])],
        "g",
        [value],
        [helper.make_tensor_value_info("y", 1, [4])],
        [outside],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9).SerializeToString()
