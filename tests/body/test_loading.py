"""Users' SMPL files: every dialect loads to the same body, everything else is one sentence, and no pickle runs."""

import os
import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
import torch

from hfb.body.assets import load_body
from hfb.body.model import Body
from hfb.errors import InputError
from tests.body.smpl_files import FakeChumpy, rewrite_member_size, save_npz, save_pickle, smpl_arrays


def same(body: Body, arrays: dict[str, Any]) -> None:
    """The body holds exactly these arrays."""
    tensor = torch.from_numpy
    assert body.betas_space == "smpl"
    assert body.pose_directions is not None
    torch.testing.assert_close(body.template, tensor(arrays["v_template"]))
    torch.testing.assert_close(body.shape_directions, tensor(arrays["shapedirs"][:, :, :10].copy()))
    torch.testing.assert_close(body.pose_directions, tensor(arrays["posedirs"]))
    torch.testing.assert_close(body.joint_regressor, tensor(arrays["J_regressor"]))
    torch.testing.assert_close(body.skinning_weights, tensor(arrays["weights"]))
    torch.testing.assert_close(body.joint_template, tensor(arrays["J_regressor"] @ arrays["v_template"]))
    torch.testing.assert_close(body.mesh.faces, tensor(arrays["f"].astype(np.int64)))


def refusal(path: Path) -> str:
    """The sentence with which a file is refused."""
    with pytest.raises(InputError) as caught:
        load_body(path)
    text = str(caught.value)
    assert str(path) in text
    assert "\n" not in text
    assert "leave the body model out" in text or "give a SMPL" in text or "give the .npz" in text
    return text


def test_npz(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    same(load_body(save_npz(tmp_path / "SMPL_NEUTRAL.npz", arrays), torch.float64), arrays)


def test_float32_by_default(tmp_path: Path) -> None:
    body = load_body(save_npz(tmp_path / "m.npz", smpl_arrays()))
    assert {body.template.dtype, body.mesh.uv.dtype, body.joint_template.dtype} == {torch.float32}


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_pickle_of_every_protocol(tmp_path: Path, protocol: int) -> None:
    arrays = smpl_arrays()
    same(load_body(save_pickle(tmp_path / "m.pkl", arrays, protocol), torch.float64), arrays)


def test_pickle_with_fortran_order_and_foreign_bytes(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    odd = dict(arrays, posedirs=np.asfortranarray(arrays["posedirs"]), weights=arrays["weights"].astype(">f8"))
    same(load_body(save_pickle(tmp_path / "m.pkl", odd), torch.float64), arrays)


def test_names_of_numpy_1_and_of_python_2(tmp_path: Path) -> None:
    """Old files say numpy.core and __builtin__, and hold arrays as latin1 text."""
    arrays = smpl_arrays()
    data = pickle.dumps(arrays, protocol=2, fix_imports=True)
    assert b"numpy._core.multiarray" in data
    path = tmp_path / "m.pkl"
    path.write_bytes(data.replace(b"numpy._core.multiarray", b"numpy.core.multiarray"))
    same(load_body(path, torch.float64), arrays)


def python_2_array(array: np.ndarray) -> bytes:
    """How Python 2's cPickle wrote an array, opcode by opcode: numpy's old names, bytes as plain strings."""
    kind = array.dtype.str.lstrip("<>=|").encode()
    data = array.tobytes()
    return b"".join(
        [
            b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tU\x01btR(K\x01(",
            *(b"J" + struct.pack("<i", size) for size in array.shape),
            b"tcnumpy\ndtype\n(U" + bytes([len(kind)]) + kind,
            b"K\x00K\x01tR(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb",
            b"I00\nT" + struct.pack("<i", len(data)) + data + b"tb",
        ]
    )


def test_a_file_of_python_2(tmp_path: Path) -> None:
    """As the SMPL files of 2015 are: chumpy objects of the old copy_reg, a sparse regressor, strings of bytes."""
    arrays = smpl_arrays()
    sparse = scipy.sparse.csc_matrix(arrays["J_regressor"])
    parts = [b"(dU\x0av_templateccopy_reg\n_reconstructor\n(cchumpy.ch\nCh\nc__builtin__\nobject\nNtR(dU\x01x"]
    parts += [python_2_array(arrays["v_template"]), b"sU\x0b_dirty_varsc__builtin__\nset\n((lU\x01xatRsbs"]
    parts += [b"U\x0bJ_regressorccopy_reg\n_reconstructor\n(cscipy.sparse.csc\ncsc_matrix\nc__builtin__\nobject\nNtR(d"]
    parts += [b"U\x06_shape(K\x18K\x6etsU\x08maxprintK2s"]
    for name in ("data", "indices", "indptr"):
        parts += [b"U" + bytes([len(name)]) + name.encode(), python_2_array(getattr(sparse, name)), b"s"]
    parts += [b"bs"]
    for name in ("shapedirs", "posedirs", "weights", "f", "kintree_table"):
        values = arrays[name].astype(np.uint32) if name == "kintree_table" else arrays[name]
        parts += [b"U" + bytes([len(name)]) + name.encode(), python_2_array(values), b"s"]
    path = tmp_path / "basicModel_neutral_lbs_10_207_0_v1.0.0.pkl"
    path.write_bytes(b"".join(parts) + b".")
    same(load_body(path, torch.float64), arrays)


@pytest.mark.parametrize("protocol", [0, 2, 4])
@pytest.mark.parametrize("form", ["csc_matrix", "csr_matrix", "coo_matrix", "csc_array"])
def test_sparse_regressor(tmp_path: Path, form: str, protocol: int) -> None:
    arrays = smpl_arrays()
    sparse = dict(arrays, J_regressor=getattr(scipy.sparse, form)(arrays["J_regressor"]))
    same(load_body(save_pickle(tmp_path / "m.pkl", sparse, protocol), torch.float64), arrays)


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_chumpy_arrays(tmp_path: Path, protocol: int) -> None:
    arrays = smpl_arrays()
    with FakeChumpy() as chumpy:
        content = dict(
            arrays,
            v_template=chumpy.array(arrays["v_template"]),
            shapedirs=chumpy.selection(arrays["shapedirs"]),
            posedirs=chumpy.array(arrays["posedirs"]),
            J=chumpy.array(np.zeros((24, 3))),
            bs_style="lbs",
        )
        path = save_pickle(tmp_path / "m.pkl", content, protocol)
    same(load_body(path, torch.float64), arrays)


def test_npz_with_pickled_members(tmp_path: Path) -> None:
    """numpy.savez wraps chumpy and sparse objects into object arrays, which are pickles."""
    arrays = smpl_arrays()
    with FakeChumpy() as chumpy:
        path = save_npz(
            tmp_path / "m.npz",
            dict(
                arrays,
                shapedirs=np.array(chumpy.array(arrays["shapedirs"]), dtype=object),
                J_regressor=scipy.sparse.csc_matrix(arrays["J_regressor"]),
            ),
        )
    same(load_body(path, torch.float64), arrays)


def test_300_betas_are_cut_to_ten(tmp_path: Path) -> None:
    arrays = smpl_arrays(shape_count=300)
    body = load_body(save_npz(tmp_path / "m.npz", arrays), torch.float64)
    assert body.shape_count == 10
    same(body, arrays)


def test_unsigned_parents(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    table = arrays["kintree_table"].astype(np.uint32)
    assert table[0, 0] == 4294967295
    for kind in (np.uint32, np.int64, np.uint64):
        same(
            load_body(save_npz(tmp_path / "m.npz", dict(arrays, kintree_table=table.astype(kind))), torch.float64),
            arrays,
        )


def test_a_files_own_texture_is_kept(tmp_path: Path) -> None:
    arrays = smpl_arrays()
    corners = np.random.default_rng(0).uniform(0, 1, (40, 2))
    path = save_npz(tmp_path / "m.npz", dict(arrays, vt=corners, ft=arrays["f"] % 40))
    mesh = load_body(path, torch.float64).mesh
    np.testing.assert_allclose(mesh.uv[:, 0], corners[:, 0])
    np.testing.assert_allclose(mesh.uv[:, 1], 1 - corners[:, 1])  # v = 0 is the top row
    np.testing.assert_array_equal(mesh.uv_faces, arrays["f"] % 40)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    assert "cannot be read" in refusal(tmp_path / "SMPL_NEUTRAL.npz")
    assert "folder" in refusal(tmp_path)


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04 nothing", b"\x89PNG\r\n\x1a\n", b"\x80\x04N.", b"hello", pickle.dumps([1, 2])]
)
def test_not_a_model(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.pkl"
    path.write_bytes(content)
    assert "cannot be used as a body model" in refusal(path)


def test_cut_off_files(tmp_path: Path) -> None:
    for path in (save_npz(tmp_path / "m.npz", smpl_arrays()), save_pickle(tmp_path / "m.pkl", smpl_arrays(), 4)):
        path.write_bytes(path.read_bytes()[:-5000])
        refusal(path)


@pytest.mark.parametrize(
    ("name", "joints", "poses"),
    [("SMPL-X", 55, 486), ("SMPL-H", 52, 459), ("MANO", 16, 135), ("FLAME", 5, 36), ("STAR", 24, 93)],
)
def test_relatives_are_refused_by_name(tmp_path: Path, name: str, joints: int, poses: int) -> None:
    arrays = smpl_arrays()
    count = len(arrays["v_template"])
    arrays.update(
        posedirs=np.zeros((count, 3, poses)),
        J_regressor=np.zeros((joints, count)),
        weights=np.zeros((count, joints)),
        kintree_table=np.zeros((2, joints), dtype=np.int64),
    )
    text = refusal(save_npz(tmp_path / "SMPL_NEUTRAL.npz", arrays))
    assert f"is a {name} model ({joints} joints, {poses} pose blend shapes)" in text
    assert "SMPL (24 joints, 207)" in text
    assert "https://smpl.is.tue.mpg.de" in text


def test_a_motion_file_is_refused_by_name(tmp_path: Path) -> None:
    path = save_npz(
        tmp_path / "walk.npz", {"poses": np.zeros((5, 156)), "trans": np.zeros((5, 3)), "betas": np.zeros(16)}
    )
    assert "is a motion file" in refusal(path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"v_template": None}, "no v_template"),
        ({"weights": None, "f": None}, "lacks weights, f"),
        ({"v_template": np.zeros((110, 2))}, "v_template has the shape (110, 2)"),
        ({"weights": np.full((110, 23), 1 / 23)}, "weights has the shape (110, 23), not (110, 24)"),
        ({"weights": np.ones((110, 24))}, "rows of weights do not add up to 1"),
        ({"shapedirs": np.zeros((110, 3, 4))}, "shapedirs has the shape (110, 3, 4)"),
        ({"shapedirs": np.full((110, 3, 10), np.nan)}, "not finite"),
        ({"v_template": np.full((110, 3), np.inf)}, "not finite"),
        ({"posedirs": np.full((110, 3, 207), 1e200)}, "absurdly large"),
        ({"v_template": smpl_arrays()["v_template"] * 100}, "not a SMPL model in metres"),
        ({"f": np.array([[0, 1, 110]])}, "points outside its 110 vertices"),
        ({"f": np.array([[0, 1, -1]])}, "points outside its 110 vertices"),
        ({"f": np.zeros((5, 4), dtype=int)}, "no list of triangles"),
        ({"kintree_table": np.zeros((2, 24), dtype=int)}, "not SMPL's skeleton"),
        ({"J_regressor": np.array("text")}, "not numbers"),
    ],
)
def test_damage_is_named(tmp_path: Path, change: dict[str, Any], says: str) -> None:
    arrays = dict(smpl_arrays(), **change)
    path = save_npz(tmp_path / "m.npz", {name: value for name, value in arrays.items() if value is not None})
    assert says in refusal(path)


class Evil:
    """Its pickle asks for a shell."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple:
        return os.system, (f"touch {self.target}",)


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_pickle_runs_nothing(tmp_path: Path, protocol: int) -> None:
    trace = tmp_path / "trace"
    path = save_pickle(tmp_path / "m.pkl", dict(smpl_arrays(), extra=Evil(trace)), protocol)
    assert "posix.system" in refusal(path) or "nt.system" in refusal(path)
    in_npz = save_npz(tmp_path / "m.npz", dict(smpl_arrays(), weights=np.array([Evil(trace)], dtype=object)))
    assert "system" in refusal(in_npz)
    assert not trace.exists()


@pytest.mark.parametrize(
    "programme",
    [
        b"cbuiltins\neval\n(S'1'\ntR.",
        b"cbuiltins\ngetattr\n(cnumpy\nndarray\nS'__class__'\ntR.",
        b"\x80\x04\x8c\x08builtins\x8c\x04exec\x93\x8c\x01x\x85R.",
        b"ctorch\nload\n.",
        b"cnumpy\nload\n.",
        b"cchumpy.ch\nCh\n)R(dS'x'\ng0\nb.",
        b"Pid\n.",  # persistent id
        b"\x82\x01.",  # extension registry
        b"c_codecs\nencode\n}(S'__defaults__'\n(I1\ntsb.",  # a state for a function
        b"\x80\x02cnumpy._core.multiarray\n_reconstruct\n)R}b.",
    ],
)
def test_crafted_pickles_are_refused(tmp_path: Path, programme: bytes) -> None:
    path = tmp_path / "m.pkl"
    path.write_bytes(programme)
    refusal(path)


def test_an_array_that_holds_itself_is_refused(tmp_path: Path) -> None:
    with FakeChumpy() as chumpy:
        snake = chumpy.array(np.zeros(3))
        snake.x = snake
        path = save_pickle(tmp_path / "m.pkl", dict(smpl_arrays(), weights=snake))
    assert "RecursionError" in refusal(path)


def test_absurd_sizes_are_refused_before_they_are_read(tmp_path: Path) -> None:
    huge = tmp_path / "huge.npz"
    with huge.open("wb") as file:  # sparse: takes no room on the disk
        file.truncate((1 << 30) + 1)
    assert "far more than a body model" in refusal(huge)
    bomb = rewrite_member_size(save_npz(tmp_path / "bomb.npz", smpl_arrays()), 0xF0000000)
    assert "larger than 512 MB" in refusal(bomb)
    # An array of 2**60 entries, and a byte string that claims 2**50.
    path = save_pickle(tmp_path / "m.pkl", {"v_template": np.zeros((3, 3))}, 2)
    path.write_bytes(
        path.read_bytes().replace(b"K\x03K\x03\x86", b"\x8a\x08" + struct.pack("<q", 1 << 60) + b"K\x03\x86")
    )
    assert "absurd shape" in refusal(path)
    path.write_bytes(b"\x80\x05\x96" + struct.pack("<Q", 1 << 50) + b".")
    assert "cut off" in refusal(path)
    path.write_bytes(b"\x80\x02Nr\xff\xff\xff\x7f.")  # a memo index of two thousand million
    refusal(path)


def test_a_lying_npz_header_is_refused(tmp_path: Path) -> None:
    path = save_npz(tmp_path / "m.npz", smpl_arrays())
    data = path.read_bytes()
    assert b"(110, 3)" in data
    path.write_bytes(data.replace(b"(110, 3)", b"(111, 3)"))
    refusal(path)
