"""Users' prior files: every container they come in, and none of their code."""

import pickle
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from hfb.errors import InputError
from hfb.priors.anatomy import AnatomicalPrior
from hfb.priors.gmm import GmmPrior
from hfb.priors.load import load_pose_prior
from hfb.priors.vposer import VPoserPrior
from tests.priors.test_gmm import make_mixture
from tests.priors.test_vposer import make_vposer

POSES = 0.3 * torch.randn(3, 23, 3, generator=torch.Generator().manual_seed(0))


class _Runs:
    """Something that writes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def test_no_file_is_the_anatomical_prior():
    assert isinstance(load_pose_prior(None), AnatomicalPrior)


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_smplifys_pickle(tmp_path, protocol):
    mixture = make_mixture()
    path = tmp_path / "gmm_08.pkl"
    path.write_bytes(pickle.dumps(mixture, protocol))
    prior = load_pose_prior(path)
    assert isinstance(prior, GmmPrior)
    direct = GmmPrior(mixture["means"], mixture["covars"], mixture["weights"], "test")
    torch.testing.assert_close(prior(POSES), direct(POSES))


def test_a_mixture_as_npz(tmp_path):
    np.savez(tmp_path / "mixture.npz", **make_mixture())
    assert isinstance(load_pose_prior(tmp_path / "mixture.npz"), GmmPrior)


def _lightning(state: dict[str, torch.Tensor], path: Path) -> None:
    """A checkpoint with objects of a library that is not installed, as Lightning leaves them."""
    module = ModuleType("some_trainer")
    for name, bases in {"Callback": (), "Settings": (dict,), "Plain": ()}.items():
        setattr(module, name, type(name, bases, {"__module__": "some_trainer"}))
    sys.modules["some_trainer"] = module
    try:
        plain = module.Plain()
        plain.answer = 42
        names = {f"vp_model.{name}": value for name, value in state.items()}
        extras = {"callbacks": {module.Callback: {"best": 0.1}}, "hparams": module.Settings(lr=1e-3), "plain": plain}
        torch.save({"epoch": 8, "state_dict": names, **extras}, path)
    finally:
        del sys.modules["some_trainer"]


@pytest.mark.parametrize("container", ["lightning", "zip", "legacy", "safetensors", "npz"])
def test_vposer_in_every_container(tmp_path, container):
    state = dict(make_vposer(1 if container == "legacy" else 2).float().state_dict())
    path = tmp_path / "snapshot"  # told apart by content, not by name
    if container == "lightning":
        _lightning(state, path)
    elif container == "safetensors":
        save_file(state, path)
    elif container == "npz":
        with path.open("wb") as file:
            np.savez(file, **{name: value.numpy() for name, value in state.items()})
    else:
        torch.save(state, path, _use_new_zipfile_serialization=container == "zip")
    prior = load_pose_prior(path)
    assert isinstance(prior, VPoserPrior)
    torch.testing.assert_close(prior(POSES), VPoserPrior.from_state(state, "test")(POSES))


@pytest.mark.parametrize("kind", ["pickle", "torch", "legacy", "npz"])
def test_no_code_in_a_file_is_run(tmp_path, kind):
    witness, path = tmp_path / "witness", tmp_path / "prior"
    trap = make_mixture(1) | {"trap": _Runs(witness)}
    if kind == "pickle":
        path.write_bytes(pickle.dumps(trap))
    elif kind == "npz":
        with path.open("wb") as file:
            np.savez(file, means=np.array([_Runs(witness)], dtype=object))
    else:
        torch.save(trap, path, _use_new_zipfile_serialization=kind == "torch")
    with pytest.raises(InputError):
        load_pose_prior(path)
    assert not witness.exists()
    pickle.loads(pickle.dumps(_Runs(witness)))  # the trap itself works
    assert witness.exists()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello",
        b"PK\x03\x04 cut off",
        b"\x80\x04N.",
        b"\x00" * 64,
        b"\x08\0\0\0\0\0\0\0{broken}",
        pickle.dumps([1, 2]),
    ],
)
def test_what_is_no_prior_is_refused_with_a_sentence_that_names_the_fix(tmp_path, content):
    path = tmp_path / "prior.pkl"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"gmm_08.pkl|VPoser v1 or v2"):
        load_pose_prior(path)


def test_a_scikit_learn_object_is_refused_with_the_way_to_convert_it(tmp_path, monkeypatch):
    module = ModuleType("sklearn_of_2015")
    module.GMM = type("GMM", (), {"__module__": module.__name__})
    monkeypatch.setitem(sys.modules, module.__name__, module)
    (tmp_path / "gmm.pkl").write_bytes(pickle.dumps(module.GMM()))
    with pytest.raises(InputError, match=r"numpy\.savez\(file, means=g\.means_"):
        load_pose_prior(tmp_path / "gmm.pkl")


def test_a_missing_file_and_one_of_something_else(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_pose_prior(tmp_path / "missing.pkl")
    np.savez(tmp_path / "other.npz", v_template=np.zeros((4, 3)))
    with pytest.raises(InputError, match="no VPoser encoder"):
        load_pose_prior(tmp_path / "other.npz")
    np.savez(tmp_path / "words.npz", words=np.array(["a"]))
    with pytest.raises(InputError, match="other than numbers"):
        load_pose_prior(tmp_path / "words.npz")


def test_packed_weights_are_refused_before_torch_unpacks_them(tmp_path, monkeypatch):
    plain, packed = tmp_path / "plain.pt", tmp_path / "packed.pt"
    torch.save({"a": torch.zeros(1000)}, plain)
    with zipfile.ZipFile(plain) as given, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in given.namelist():
            archive.writestr(name, given.read(name))
    monkeypatch.setattr(torch, "load", lambda *_arguments, **_options: pytest.fail("it was opened"))
    with pytest.raises(InputError, match=r"packed\.pt: its contents are compressed, as torch.*; give SMPLify"):
        load_pose_prior(packed)
