"""Weights that would fill the memory are refused before torch opens them."""

import zipfile
from pathlib import Path

import pytest
import torch

from hfb.errors import InputError
from hfb.matting.user_networks.external import weights_of
from hfb.networks.runtimes import load_network
from tests.matting.networks import DifferenceMatting, save_scripted


def test_packed_weights_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, packed = tmp_path / "plain.pth", tmp_path / "packed.pth"
    torch.save({"a": torch.zeros(1000)}, plain)
    with zipfile.ZipFile(plain) as given, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in given.namelist():
            archive.writestr(name, given.read(name))
    with pytest.raises(InputError, match="weights of another network"):
        weights_of(plain)
    monkeypatch.setattr(torch, "load", lambda *_arguments, **_options: pytest.fail("it was opened"))
    with pytest.raises(InputError, match=r"packed\.pth cannot be used: its contents are compressed"):
        weights_of(packed)


def test_a_packed_network_is_refused(tmp_path: Path) -> None:
    """Only the code of a script is compressed by torch."""
    plain, packed = save_scripted(DifferenceMatting(), tmp_path / "plain.pt"), tmp_path / "packed.pt"
    with zipfile.ZipFile(plain) as given, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        assert any(info.compress_type != zipfile.ZIP_STORED for info in given.infolist())
        for name in given.namelist():
            archive.writestr(name, given.read(name))
    load_network(plain)
    with pytest.raises(InputError, match=r"packed\.pt cannot be used: its contents are compressed"):
        load_network(packed)
