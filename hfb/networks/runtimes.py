"""A user's network, TorchScript or ONNX, on one thread of the CPU.

A network is a program: run only those you trust. No Python object of a file is ever unpickled: a file that is neither a
TorchScript archive nor ONNX is refused.
"""

import importlib.util
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch

from hfb.errors import InputError, install_advice
from hfb.kernels.determinism import one_torch_thread
from hfb.networks.network_files import MOST_CODE_BYTES, check_torchscript, is_onnx
from hfb.typing import Array, Float

_TOO_FEW = ("k argument", "selected index k out of range")
"""Messages of onnxruntime and torch where the k largest of fewer numbers are wanted."""
_HALF = torch.bfloat16
"""float16 takes twelve times as long on processors without instructions of its own, which are most."""
_IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)[:, None, None]
Given = Float[Array, "..."] | float | None
"""An input: numbers, a setting, or nothing where a network makes it up itself, such as the first state of a memory."""
_IMAGENET_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)[:, None, None]


class PictureTooSmall(InputError):
    """The image has fewer positions than the network selects; a larger image has enough."""


@dataclass(frozen=True)
class Outputs:
    """The outputs of a network, in its own order.

    Attributes:
        source: the network's file, for messages.
        names: names of the outputs; empty texts where it has none.
    """

    source: Path
    names: tuple[str, ...]
    arrays: tuple[Float[Array, "..."], ...]

    def get(self, key: int | str) -> Float[Array, "..."]:
        """Return one output.

        Args:
            key: its number or name.

        Raises:
            InputError: there is no such output.
        """
        if isinstance(key, int) and key < len(self.arrays):
            return self.arrays[key]
        if isinstance(key, str) and key in self.names:
            return self.arrays[self.names.index(key)]
        shapes = ", ".join(
            f"{index} {name} {array.shape}".replace("  ", " ")
            for index, (name, array) in enumerate(zip(self.names, self.arrays, strict=True))
        )
        raise InputError(f"{self.source} has no output {key!r}; it has {shapes}")


@runtime_checkable
class Network(Protocol):
    """A network from images to arrays."""

    def __call__(self, inputs: Sequence[Given]) -> Outputs:
        """Run the network.

        Args:
            inputs: its inputs, in order.

        Raises:
            InputError: it fails.
            FloatingPointError: an output is not finite.
        """
        ...


def load_network(path: Path, settings: Mapping[str, float | str] | None = None, half: bool = False) -> Network:
    """Open a network file.

    Args:
        path: .onnx or TorchScript.
        settings: attributes of a TorchScript network to set, as far as it has them; an ONNX one keeps its own.
        half: a TorchScript network computes in 16 bits; an ONNX one in its file's.

    Raises:
        InputError: missing, damaged, or neither TorchScript nor ONNX.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a TorchScript or ONNX network")
    if is_onnx(path):
        return OnnxNetwork(path)
    check_torchscript(path)
    return TorchScriptNetwork(path, settings or {}, half)


class TorchNetwork:
    """A `Network` of a torch module.

    Args:
        path: origin of the weights, named in messages.
        module: the torch module.
        half: compute in 16 bits, in half the memory.
    """

    def __init__(self, path: Path, module: torch.nn.Module, half: bool = False) -> None:
        """Take a module; `path` names its weights in messages, `half` computes in 16 bits, in half the memory."""
        self._path = path
        self._kind = _HALF if half else torch.float32
        self._module = module.to(self._kind)

    def __call__(self, inputs: Sequence[Given]) -> Outputs:
        """See `Network`."""
        try:
            with torch.inference_mode(), one_torch_thread():
                result = self._module(
                    *[
                        torch.from_numpy(np.ascontiguousarray(one)).to(self._kind)
                        if isinstance(one, np.ndarray)
                        else one
                        for one in inputs
                    ]
                )
        except (RuntimeError, TypeError, ValueError) as error:
            raise _failed(self._path, inputs, error, half=self._kind == _HALF) from None
        return _finite(self._path, *_flat(result, self._path))


class TorchScriptNetwork(TorchNetwork):
    """A `Network` of torch.jit.save's archive.

    Args:
        path: the network's file.
        settings: attributes to set, as far as the network has them.
        half: compute in 16 bits.
    """

    def __init__(self, path: Path, settings: Mapping[str, float | str], half: bool = False) -> None:
        """Load the file. Raises InputError where torch cannot read it."""
        try:
            _declare_roi_align(path)
            module = torch.jit.load(str(path), map_location="cpu").eval()
        except Exception as error:  # a damaged file makes it raise nearly anything
            raise InputError(f"{path}: torch cannot read this TorchScript file ({_first_line(error)})") from None
        for name, value in settings.items():
            if hasattr(module, name):
                setattr(module, name, value)
        super().__init__(path, module, half)


class OnnxNetwork:
    """A `Network` run by onnxruntime.

    Args:
        path: the network's file.
    """

    def __init__(self, path: Path) -> None:
        try:
            import onnxruntime
        except ImportError:
            raise InputError(f"{path}: ONNX networks need onnxruntime: {install_advice('onnx')}") from None
        self._path = path
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # failures are reported below, or tried again
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its own exception classes share no base but this
            raise InputError(f"{path}: onnxruntime cannot read this file ({_first_line(error)})") from None

    def input_shapes(self) -> tuple[tuple[int | None, ...], ...]:
        """Return the shapes of the inputs, None for sides that the file leaves open."""
        shapes = (one.shape for one in self._session.get_inputs())
        return tuple(tuple(side if isinstance(side, int) else None for side in shape) for shape in shapes)

    def __call__(self, inputs: Sequence[Given]) -> Outputs:
        """See `Network`."""
        known = self._session.get_inputs()
        names = [one.name for one in known]
        if len(names) != len(inputs):
            raise InputError(
                f"{self._path} takes {len(names)} inputs and was given {len(inputs)}: "
                'set frames in its layout ("one", "stacked" or "list")'
            )
        kinds = [np.float16 if one.type == "tensor(float16)" else np.float32 for one in known]
        arrays = [np.asarray(one, kind) for one, kind in zip(inputs, kinds, strict=True)]
        try:
            arrays = self._session.run(None, dict(zip(names, arrays, strict=True)))
        except Exception as error:  # see above
            raise _failed(self._path, inputs, error) from None
        outputs = tuple(one.name for one in self._session.get_outputs())
        return _finite(self._path, outputs, tuple(np.asarray(one, np.float32) for one in arrays))


def normalised(picture_srgb: Float[Array, "H W 3"], normalisation: str, channels: str) -> Float[Array, "1 3 H W"]:
    """Convert an image to a network's input.

    Args:
        picture_srgb: in [0, 1].
        normalisation: scaling of the values, such as ``signed`` or ``imagenet``.
        channels: ``rgb`` or ``bgr``.
    """
    planes = np.ascontiguousarray(picture_srgb.transpose(2, 0, 1), np.float32)
    if normalisation == "signed":
        planes = 2 * planes - 1
    elif normalisation == "imagenet":
        planes = (planes - _IMAGENET_MEAN) / _IMAGENET_DEVIATION
    return np.ascontiguousarray(planes[::-1] if channels == "bgr" else planes)[None]


def denormalised(planes: Float[Array, "N 3 H W"], normalisation: str, channels: str) -> Float[Array, "N H W 3"]:
    """Invert `normalised` and clip to [0, 1].

    Args:
        planes: output of a network.
        normalisation: scaling of the values, such as ``signed`` or ``imagenet``.
        channels: ``rgb`` or ``bgr``.
    """
    rgb = planes[:, ::-1] if channels == "bgr" else planes
    if normalisation == "signed":
        rgb = (rgb + 1) / 2
    elif normalisation == "imagenet":
        rgb = rgb * _IMAGENET_DEVIATION + _IMAGENET_MEAN
    return np.ascontiguousarray(np.clip(rgb, 0, 1).transpose(0, 2, 3, 1), np.float32)


@lru_cache(maxsize=1)
def _roi_align_schema() -> torch.library.Library | None:
    """Return an operator of torchvision that some matting networks name and do not call; kept alive by the cache."""
    if importlib.util.find_spec("torchvision") is not None:
        try:
            importlib.import_module("torchvision")
        except (ImportError, RuntimeError, OSError):  # it fits its own torch only
            pass
        else:
            return None
    library = torch.library.Library("torchvision", "FRAGMENT")
    with suppress(RuntimeError):  # half an import may have declared it
        library.define(
            "roi_align(Tensor input, Tensor rois, float spatial_scale, int pooled_height, int pooled_width, "
            "int sampling_ratio, bool aligned) -> Tensor"
        )
    return library


def _declare_roi_align(path: Path) -> None:
    """Declare torchvision's operator: torch refuses a script that names an unknown one, even if it is never called."""
    with zipfile.ZipFile(path) as archive:
        codes = [info for info in archive.infolist() if info.filename.endswith(".py") and "code/" in info.filename]
        if any(b"torchvision.roi_align" in archive.read(info) for info in codes if info.file_size < MOST_CODE_BYTES):
            _roi_align_schema()


def _flat(result: Any, path: Path) -> tuple[tuple[str, ...], tuple[Float[Array, "..."], ...]]:
    """Return the tensors of a tensor, tuple, list or dictionary, nested ones one after another."""
    if isinstance(result, torch.Tensor):
        return ("",), (result.float().numpy(),)
    parts: list[tuple[str, Any]]
    if isinstance(result, dict):
        parts = [(str(name), part) for name, part in result.items()]
    elif isinstance(result, (tuple, list)):
        parts = [("", part) for part in result]
    else:
        raise InputError(f"{path} gave a {type(result).__name__}; it must give tensors")
    names: list[str] = []
    arrays: list[Array] = []
    for name, part in parts:
        inner_names, inner = _flat(part, path)
        names += [name if len(inner) == 1 and name else inner_name for inner_name in inner_names]
        arrays += inner
    return tuple(names), tuple(arrays)


def _finite(path: Path, names: tuple[str, ...], arrays: tuple[Float[Array, "..."], ...]) -> Outputs:
    if not arrays:
        raise InputError(f"{path} gave nothing")
    if not all(np.isfinite(array).all() for array in arrays):
        raise FloatingPointError(f"{path} gave numbers that are not finite")
    return Outputs(path, names, arrays)


def _failed(path: Path, inputs: Sequence[Given], error: Exception, half: bool = False) -> InputError:
    shapes = ", ".join(str(one.shape) for one in inputs if isinstance(one, np.ndarray))
    if any(said in str(error) for said in _TOO_FEW):
        return PictureTooSmall(
            f"{path} chooses more places than inputs of {shapes} have ({_first_line(error)}); give larger pictures"
        )
    return InputError(
        f"{path} failed on inputs of {shapes} ({_first_line(error)}); "
        "check that it is the network it was named, and the layout in its chains file where it has one"
        + (", or leave half precision away" if half else "")
    )


def _first_line(error: Exception) -> str:
    """Return an error's last line, which states the reason, without torch's trace."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1][:200] if lines else type(error).__name__
