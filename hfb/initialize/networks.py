"""The two pose networks of MediaPipe: where they lie, and how `hfb models` gets them.

They are not part of this project: their owner's wheel is fetched from the package index by pip, checked against
a fixed digest, and two files of it are unpacked into the user's cache. Nothing else here touches the network.
"""

import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from hfb.errors import InputError
from hfb.media.atomic import write_bytes_atomic

_VERSION = "0.10.21"  # the last wheel with the networks inside
_WHEEL = f"mediapipe-{_VERSION}-cp311-cp311-manylinux_2_28_x86_64.whl"
_WHEEL_SHA256 = "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3"
_WHEEL_LIMIT = 64 << 20
_MINUTES = 10


@dataclass(frozen=True)
class NetworkFile:
    """One file inside the wheel."""

    name: str
    member: str
    sha256: str
    size: int


POSE_DETECTION = NetworkFile(
    "pose_detection.tflite",
    "mediapipe/modules/pose_detection/pose_detection.tflite",
    "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    2959046,
)
POSE_LANDMARK = NetworkFile(
    "pose_landmark_full.tflite",
    "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
    "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    6440512,
)
NETWORKS = (POSE_DETECTION, POSE_LANDMARK)


@dataclass(frozen=True)
class NetworkStatus:
    """One row of `hfb models list`."""

    name: str
    licence: str
    source: str
    path: str
    present: bool
    size_bytes: int
    get: str

    def as_dict(self) -> dict[str, str | bool | int]:
        """The row as plain values, for `--json`."""
        return asdict(self)


def networks_folder() -> Path:
    """HFB_MODELS_DIR, else hfb/models in the user's cache (XDG_CACHE_HOME, ~/.cache)."""
    own = os.environ.get("HFB_MODELS_DIR")
    if own:
        return Path(own).expanduser()
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "hfb" / "models"


def network_path(network: NetworkFile) -> Path | None:
    """The file if it lies there undamaged, else None."""
    path = networks_folder() / network.name
    try:
        return path if path.stat().st_size == network.size and _sha256_of(path) == network.sha256 else None
    except OSError:
        return None


def list_networks() -> list[NetworkStatus]:
    """What there is, whose it is, and how to get the rest. Offline."""
    return [
        NetworkStatus(
            name=network.name,
            licence="Apache-2.0 (The MediaPipe Authors)",
            source=f"PyPI: mediapipe {_VERSION}",
            path=str(networks_folder() / network.name),
            present=network_path(network) is not None,
            size_bytes=network.size,
            get="hfb models fetch",
        )
        for network in NETWORKS
    ]


def fetch_networks(
    progress: Callable[[str], None] | None = None, wheel: Path | None = None, force: bool = False
) -> list[NetworkStatus]:
    """Get, check and unpack what is missing. The only function of hfb that uses the network.

    Args:
        progress: is told in one sentence what happens.
        wheel: a MediaPipe wheel that already lies here (for machines without network).
        force: do it even if the files are there.

    Raises:
        InputError: no pip, no connection, or a file that is not the expected one.
    """
    say = progress or (lambda _: None)
    if not force and all(network_path(network) for network in NETWORKS):
        say("the pose networks are already there")
        return list_networks()
    if wheel is not None:
        _unpack(Path(wheel), say)
        return list_networks()
    with tempfile.TemporaryDirectory(prefix="hfb-models-") as folder:
        say(f"downloading mediapipe {_VERSION} (35 MB) from the package index")
        _unpack(_download(Path(folder)), say)
    return list_networks()


def _download(folder: Path) -> Path:
    """Let pip fetch the wheel: it knows the user's index, proxy and certificates.

    Platform and Python are fixed, so that every Python and system gets the one file whose digest is known;
    nothing of it is installed or run.
    """
    command = [
        sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-input", "--no-deps",
        "--only-binary=:all:", "--platform", "manylinux_2_28_x86_64", "--python-version", "3.11",
        "--implementation", "cp", "--abi", "cp311", "--dest", str(folder), f"mediapipe=={_VERSION}",
    ]  # fmt: skip
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60 * _MINUTES, check=False)
    except subprocess.TimeoutExpired:
        raise InputError(
            f"the download did not end within {_MINUTES} minutes; check the connection and run it again."
        ) from None
    wheel = folder / _WHEEL
    if done.returncode or not wheel.is_file():
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError(
            f"pip could not fetch {_WHEEL} ({last}); check the connection, or download that file by hand "
            "and give it with --wheel."
        )
    return wheel


def _unpack(wheel: Path, say: Callable[[str], None]) -> None:
    """Check the wheel and put its two files into the cache, each whole or not at all."""
    say("checking the digest")
    try:
        if wheel.stat().st_size > _WHEEL_LIMIT or _sha256_of(wheel) != _WHEEL_SHA256:
            raise InputError(f"{wheel.name} is not the expected wheel (its sha256 differs); download {_WHEEL} again.")
        with zipfile.ZipFile(wheel) as archive:
            contents = {network: _member(archive, network) for network in NETWORKS}
    except (OSError, zipfile.BadZipFile, KeyError) as error:
        raise InputError(f"{wheel}: can't be read as a wheel ({error}); download {_WHEEL} again.") from None
    folder = networks_folder()
    for network, content in contents.items():
        try:
            write_bytes_atomic(folder / network.name, content)
        except OSError as error:
            raise InputError(
                f"{folder}: can't be written ({error.strerror}); set HFB_MODELS_DIR to a folder of yours."
            ) from None
    say(f"wrote {len(contents)} networks to {folder}")


def _member(archive: zipfile.ZipFile, network: NetworkFile) -> bytes:
    """One file by its exact name and size; its name is never used as a path."""
    with archive.open(network.member) as file:
        content = file.read(network.size + 1)
    if len(content) != network.size or hashlib.sha256(content).hexdigest() != network.sha256:
        raise InputError(f"{network.name} inside the wheel is not the expected file; download {_WHEEL} again.")
    return content


def _sha256_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
