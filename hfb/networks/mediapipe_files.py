"""Local files of MediaPipe's pose networks, and the choice among them. Offline.

They are not part of this project: `hfb models fetch` downloads them (see `hfb.networks.fetch`).
"""

import hashlib
import os
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

from hfb.errors import InputError

LandmarkChoice = Literal["auto", "heavy", "full"]


@dataclass(frozen=True)
class NetworkFile:
    """One network's file, identified by its digest.

    Attributes:
        source: the package that holds it.
        member: its name in that package's archive.
    """

    name: str
    source: str
    member: str
    sha256: str
    size: int


WHEEL_VERSION = "0.10.21"  # the last wheel with the networks inside
NPM_PACKAGE = "@mediapipe/pose@0.5.1675469404"
_WHEEL_SOURCE, _NPM_SOURCE = f"PyPI: mediapipe {WHEEL_VERSION}", f"npm: {NPM_PACKAGE}"

POSE_DETECTION = NetworkFile(
    "pose_detection.tflite",
    _WHEEL_SOURCE,
    "mediapipe/modules/pose_detection/pose_detection.tflite",
    "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    2959046,
)
LANDMARK_FULL = NetworkFile(
    "pose_landmark_full.tflite",
    _WHEEL_SOURCE,
    "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
    "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    6440512,
)
LANDMARK_HEAVY = NetworkFile(
    "pose_landmark_heavy.tflite",
    _NPM_SOURCE,
    "package/pose_landmark_heavy.tflite",
    "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe",
    27709200,
)
NETWORKS = (POSE_DETECTION, LANDMARK_FULL, LANDMARK_HEAVY)
LANDMARKERS = {"heavy": LANDMARK_HEAVY, "full": LANDMARK_FULL}
"""The networks that find landmarks, the best first: same input, same outputs."""


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
        """Return the row as plain values, for `--json`."""
        return asdict(self)


def networks_folder() -> Path:
    """Return HFB_MODELS_DIR, else hfb/models in the user's cache (XDG_CACHE_HOME, ~/.cache)."""
    own = os.environ.get("HFB_MODELS_DIR")
    if own:
        return Path(own).expanduser()
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "hfb" / "models"


def network_path(network: NetworkFile) -> Path | None:
    """Return the file's path if it is there undamaged, else None.

    Args:
        network: name, size and digest of the file.
    """
    path = networks_folder() / network.name
    try:
        return path if path.stat().st_size == network.size and sha256_of(path) == network.sha256 else None
    except OSError:
        return None


def networks_in_use(choice: LandmarkChoice = "auto") -> tuple[Path, ...]:
    """Return the files of the detector and of the landmark networks, the best first; none where one is missing.

    Args:
        choice: which landmark network; auto takes those that are there.

    Raises:
        InputError: the network that is requested by name is missing.
    """
    detector = network_path(POSE_DETECTION)
    candidates = LANDMARKERS.values() if choice == "auto" else (LANDMARKERS[choice],)
    landmarkers = [path for one in candidates if (path := network_path(one)) is not None]
    if detector is not None and landmarkers:
        return detector, *landmarkers
    if choice != "auto":
        missing = POSE_DETECTION if detector is None else LANDMARKERS[choice]
        raise InputError(f"the pose network {missing.name} is not there; run `hfb models fetch`.")
    return ()


def list_networks() -> list[NetworkStatus]:
    """List the networks, their owners, and how to get missing ones."""
    return [
        NetworkStatus(
            name=network.name,
            licence="Apache-2.0 (The MediaPipe Authors)",
            source=network.source,
            path=str(networks_folder() / network.name),
            present=network_path(network) is not None,
            size_bytes=network.size,
            get="hfb models fetch",
        )
        for network in NETWORKS
    ]


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file's content, which is read again only once the file has changed. Raises OSError.

    Args:
        path: the file.
    """
    status = path.stat()
    return _sha256(path, status.st_ino, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=16)
def _sha256(path: Path, *_status: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
