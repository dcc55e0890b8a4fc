"""The user's own networks and results: identified by content, read from their current place."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import TYPE_CHECKING

from hfb.config import OWN_NETWORKS, InitConfig, MattingConfig, RunConfig
from hfb.errors import InputError
from hfb.interop.readers.beside import companions
from hfb.networks.mediapipe_files import LANDMARK_FULL, LandmarkChoice, networks_in_use
from hfb.networks.network_files import check_network_file
from hfb.tasks.core.handles import FileHandle, sha256_of
from hfb.tasks.telemetry import progress

if TYPE_CHECKING:
    from hfb.matting.matting_protocol import Matting

_OWN_MATTING = ("bgmv2", "rvm")


def matting_file(config: RunConfig) -> Path | None:
    """Return the matting network's file, where the method needs one.

    Args:
        config: all options.

    Raises:
        InputError: the method needs one and none is given, a needless one is given, or the file is no network.
    """
    own = config.matting.method in _OWN_MATTING
    if own != (config.matting.weights is not None):
        raise InputError(
            f"--matting {config.matting.method} needs the network's file: give it with --matting-weights FILE"
            if own
            else f"--matting {config.matting.method} takes no --matting-weights: say bgmv2 or rvm"
        )
    weights = config.matting.weights
    if weights is not None and weights.is_file():
        check_network_file(weights, weights_too=config.matting.method == "bgmv2")
    return weights


def init_files(init: InitConfig) -> tuple[Path, ...]:
    """Return the other system's result and the files that belong to it, or the user's network; empty for other methods.

    Args:
        init: options of the first bodies.

    Raises:
        InputError: the method needs a file and none is given, or a needless one is given.
    """
    own = init.method in OWN_NETWORKS
    if own != (init.weights is not None):
        raise InputError(
            f"--init {init.method} needs the network's file: give it with --init-weights FILE"
            if own
            else f"--init {init.method} takes no --init-weights: say {' or '.join(OWN_NETWORKS)}"
        )
    if init.mesh_sampling is not None and init.method != "metro":
        raise InputError(f"--init {init.method} takes no --init.mesh-sampling: say metro")
    if (init.method == "file") != (init.file is not None):
        raise InputError(
            "give another system's result with --init FILE"
            if init.method == "file"
            else f"init.file does not go with init.method {init.method}: leave one of them out"
        )
    if init.weights is not None and init.weights.is_file():
        check_network_file(init.weights)
    if init.file is not None:
        return (init.file, *companions(init.file))
    return tuple(file for file in (init.weights, init.mesh_sampling) if file is not None)


def with_matting_network(config: MattingConfig, file: FileHandle | None) -> MattingConfig:
    """Return the options with the current place of the network's file.

    Args:
        config: options of the mattes.
        file: the network; None for methods without one.
    """
    return config if file is None else config.model_copy(update={"weights": file.path})


def shade_networks(init: InitConfig, networks: tuple[FileHandle, ...]) -> tuple[FileHandle, ...]:
    """Return the networks that tell a person from shade on the floor: MediaPipe's, where first bodies use them.

    Args:
        init: options of the first bodies.
        networks: the installed pose networks, or the user's own.
    """
    return networks if init.method in ("auto", "mediapipe") else ()


def person_matting(
    config: MattingConfig,
    own: FileHandle | None,
    landmarks: LandmarkChoice,
    networks: tuple[FileHandle, ...],
    *,
    quick: bool = False,
) -> Matting:
    """Return the method of matting, without shade on the floor where there are networks that tell it.

    Args:
        config: options of the mattes.
        own: the user's matting network; None for methods without one.
        landmarks: choice among the landmark networks.
        networks: those of the calling machine, by `shade_networks`.
        quick: see `hfb.matting.methods.make_matting`.

    Raises:
        InputError: as `check_networks`.
    """
    from hfb.initialization.floor_shade import without_shade
    from hfb.matting.methods import make_matting

    matting = make_matting(with_matting_network(config, own), quick)
    if not networks:
        return matting
    check_networks(InitConfig(landmarks=landmarks), networks)
    return without_shade(matting, landmarks)


def with_pose_network(config: InitConfig, networks: tuple[FileHandle, ...]) -> InitConfig:
    """Return the options with the current places of the user's network's files.

    Args:
        config: options of the first bodies.
        networks: its files.
    """
    if config.method not in OWN_NETWORKS:
        return config
    sampling = networks[1].path if config.mesh_sampling is not None else None
    return config.model_copy(update={"weights": networks[0].path, "mesh_sampling": sampling})


def tell_networks(networks: tuple[FileHandle, ...]) -> None:
    """Print a line where first bodies come from the smaller landmark network alone.

    Args:
        networks: the pose networks in use.
    """
    if [file.path.name for file in networks[1:]] == [LANDMARK_FULL.name]:
        progress.say(
            "hfb: MediaPipe's full landmark network is used alone: `hfb models fetch` brings the heavy one, too"
        )


def check_networks(config: InitConfig, networks: tuple[FileHandle, ...]) -> None:
    """Check that this machine has the pose networks of the calling one: others give other first bodies.

    Args:
        config: options of the first bodies.
        networks: those of the calling machine.

    Raises:
        InputError: they are missing here, or differ.
    """
    if config.method not in ("auto", "mediapipe"):
        return
    here = [sha256_of(path) for path in networks_in_use(config.landmarks)]
    if here != [file.sha256 for file in networks]:
        raise InputError(
            f"the pose networks on {socket.gethostname()} are not those of the machine that asked: `hfb models fetch` "
            "on both, or --init.method matte"
        )
