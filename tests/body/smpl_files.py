"""Small synthetic models in SMPL's file layout: a closed ellipsoid with a random skeleton, shape and skin."""

import io
import pickle
import sys
import types
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from hfb.body.skeleton import PARENTS

RINGS, AROUND = 9, 12
VERTEX_COUNT = RINGS * AROUND + 2


def ellipsoid() -> tuple[np.ndarray, np.ndarray]:
    """(vertices (V, 3), faces (F, 3)) of a closed, outward oriented surface about the size of a person."""
    polar = np.pi * (np.arange(RINGS) + 1) / (RINGS + 1)
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    ring = np.stack(
        [
            np.sin(polar)[:, None] * np.sin(turn),
            np.broadcast_to(np.cos(polar)[:, None], (RINGS, AROUND)),
            np.sin(polar)[:, None] * np.cos(turn),
        ],
        -1,
    ).reshape(-1, 3)
    vertices = np.concatenate([ring, [[0, 1, 0], [0, -1, 0]]]) * [0.4, 0.9, 0.2]
    top, bottom = RINGS * AROUND, RINGS * AROUND + 1
    faces = []
    for k in range(AROUND):
        after = (k + 1) % AROUND
        faces += [(top, k, after), (bottom, (RINGS - 1) * AROUND + after, (RINGS - 1) * AROUND + k)]
        for row in range(RINGS - 1):
            a, b, c, d = row * AROUND + k, row * AROUND + after, (row + 1) * AROUND + k, (row + 1) * AROUND + after
            faces += [(a, c, b), (b, c, d)]
    return vertices, np.array(faces)


def smpl_arrays(shape_count: int = 10, seed: int = 0) -> dict[str, Any]:
    """What a SMPL file holds, as plain numpy arrays."""
    generator = np.random.default_rng(seed)
    vertices, faces = ellipsoid()
    weights = np.zeros((VERTEX_COUNT, 24))
    for row in weights:
        row[generator.choice(24, 4, replace=False)] = generator.uniform(0.1, 1, 4)
    regressor = np.zeros((24, VERTEX_COUNT))
    for row in regressor:
        row[generator.choice(VERTEX_COUNT, 6, replace=False)] = generator.uniform(0.1, 1, 6)
    return {
        "v_template": vertices,
        "shapedirs": generator.normal(0, 0.02, (VERTEX_COUNT, 3, shape_count)),
        "posedirs": generator.normal(0, 0.01, (VERTEX_COUNT, 3, 207)),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.array([PARENTS, range(24)], dtype=np.int64),
        "f": faces.astype(np.uint32),
    }


def save_npz(path: Path, arrays: dict[str, Any]) -> Path:
    np.savez(path, **arrays)
    return path


def save_pickle(path: Path, content: Any, protocol: int = 2) -> Path:
    path.write_bytes(pickle.dumps(content, protocol=protocol))
    return path


class FakeChumpy:
    """While entered, `chumpy` can be imported and its objects pickled; nothing of it is left behind."""

    def __enter__(self) -> "FakeChumpy":
        self.ch, self.reordering = types.ModuleType("chumpy.ch"), types.ModuleType("chumpy.reordering")

        class Ch:
            def __init__(self, **state: Any) -> None:
                self.__dict__.update(state)

        class Select(Ch):
            pass

        for module, cls in ((self.ch, Ch), (self.reordering, Select)):
            cls.__module__ = module.__name__
            cls.__qualname__ = cls.__name__
            setattr(module, cls.__name__, cls)
            sys.modules[module.__name__] = module
        sys.modules["chumpy"] = types.ModuleType("chumpy")
        return self

    def __exit__(self, *_: object) -> None:
        for name in ("chumpy", "chumpy.ch", "chumpy.reordering"):
            del sys.modules[name]

    def array(self, values: np.ndarray) -> Any:
        return self.ch.Ch(x=values, _dirty_vars={"x"}, _itr=None)

    def selection(self, values: np.ndarray) -> Any:
        """The values as entries of a larger array, in another order."""
        order = np.random.default_rng(1).permutation(values.size + 5)
        larger = np.full(values.size + 5, np.nan)
        larger[order[: values.size]] = values.reshape(-1)
        return self.reordering.Select(
            a=self.array(larger), idxs=order[: values.size], preferred_shape=tuple(values.shape)
        )


def rewrite_member_size(path: Path, claimed: int) -> Path:
    """A zip whose members claim to unpack to `claimed` bytes each."""
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(io.BytesIO(bytes(data))) as archive:
        start = archive.start_dir
    while (start := data.find(b"PK\x01\x02", start)) >= 0:
        data[start + 24 : start + 28] = claimed.to_bytes(4, "little")
        start += 4
    path.write_bytes(bytes(data))
    return path
