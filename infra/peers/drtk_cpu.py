"""Build what `make bench` uses of DRTK without CUDA: `python drtk_cpu.py CHECKOUT SITE`, then add SITE to PYTHONPATH.

DRTK's own setup.py asks for a CUDA compiler. Its CPU versions need none: their sources are compiled as they are, what
they name of CUDA throws, and four of its eight extensions are enough. Needs a C++20 compiler, ninja, and beside torch
the headers in the wheels nvidia-cuda-runtime-cu12 and nvidia-cuda-nvcc-cu12.
"""

import re
import shutil
import sys
from importlib.metadata import files
from pathlib import Path

from setuptools import setup
from torch.utils.cpp_extension import BuildExtension, CppExtension

EXTENSIONS = ("rasterize", "render", "edge_grad", "interpolate")
_HEADERS = {"nvidia-cuda-runtime-cu12": "cuda_runtime.h", "nvidia-cuda-nvcc-cu12": "host_defines.h"}
_LEFT_OUT = re.compile(r"^from \.(filter2d|grid_scatter|mipmap_grid_sample|msi) import (\([^)]*\)|.*)", re.M)
_DECLARED = re.compile(r"((?:std|torch)::[^;()]*?_cuda\w*\s*\([^;]*?\))\s*;")


def stubs(folder: Path, name: str) -> Path:
    """A source in which every CUDA function that a header declares throws; weak, since some have a body elsewhere."""
    header = re.sub(r"//.*", "", (folder / f"{name}_kernel.h").read_text()).partition("#pragma once")[2]
    bodies = [
        f'__attribute__((weak)) {re.sub(r"=[^,)]*", "", one)} {{ throw std::runtime_error("built without CUDA"); }}'
        for one in _DECLARED.findall(header)
    ]
    path = folder / f"{name}_without_cuda.cpp"
    path.write_text("\n".join(["#include <torch/extension.h>", f'#include "{name}_kernel.h"', *bodies, ""]))
    return path


def include_folders() -> list[str]:
    """Where the CUDA headers lie."""
    found = []
    for wheel, header in _HEADERS.items():
        paths = [Path(str(file.locate())) for file in files(wheel) or () if file.name == header]
        found += {str(path.parent.parent if path.parent.name == "crt" else path.parent) for path in paths}
    return found


def main() -> None:
    """Compile the extensions into SITE/drtk and put the Python half beside them."""
    checkout, site = (Path(one).resolve() for one in sys.argv[1:3])
    package = site / "drtk"
    shutil.copytree(checkout / "drtk", package, dirs_exist_ok=True)
    entry = package / "__init__.py"
    entry.write_text(_LEFT_OUT.sub("", entry.read_text()))
    extensions = []
    for name in EXTENSIONS:
        folder = checkout / "src" / name
        sources = [folder / f"{name}_module.cpp", folder / f"{name}_kernel_cpu.cpp", stubs(folder, name)]
        extensions.append(
            CppExtension(
                f"drtk.{name}_ext", [str(source) for source in sources],
                include_dirs=[str(checkout / "src" / "include"), *include_folders()],
                extra_compile_args={"cxx": ["-std=c++20", "-O3", "-ffast-math", "-fopenmp"]},
                extra_link_args=["-fopenmp"],
            )
        )  # fmt: skip
    build = ["build_ext", "--build-lib", str(site), "--build-temp", str(checkout / "build")]
    setup(
        name="drtk-cpu", packages=[], ext_modules=extensions, cmdclass={"build_ext": BuildExtension}, script_args=build
    )


if __name__ == "__main__":
    main()
