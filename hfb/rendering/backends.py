"""Choose a rasteriser by name; only the chosen back end is imported."""

from importlib.util import find_spec
from typing import Literal

from hfb.errors import InputError, install_advice
from hfb.rendering.rasterizer import Rasterizer


def make_rasterizer(
    silhouette: Literal["coverage", "dibr"] = "coverage",
    backend: Literal["cpu", "reference", "cuda", "warp"] = "cpu",
    threads: int = 1,
    sharpness: float = 1.0,
) -> Rasterizer:
    """Choose how silhouettes are drawn.

    Args:
        silhouette: "coverage" is the exact share of each pixel that the body covers, with gradients from both sides of
            the edge; "dibr" is DIB-R's soft mask, a halo outside the edge, as in the paper.
        backend: "cpu" are the compiled kernels, "reference" the readable torch formulas they are tested against, "cuda"
            the Warp kernels on a CUDA device, "warp" the same on one thread of the processor.
        threads: number of the compiled kernels' threads; results do not depend on it.
        sharpness: of DIB-R's mask, see `hfb.rendering.reference_dibr.dibr_constants`.

    Raises:
        InputError: Warp or a CUDA device is missing, or the Warp kernels do not support the silhouette.
    """
    if backend == "reference":
        from hfb.rendering.reference import ReferenceRasterizer

        return ReferenceRasterizer(silhouette, sharpness)
    if backend in ("cuda", "warp"):
        return _make_warp_rasterizer(silhouette, "cuda" if backend == "cuda" else "cpu")
    from hfb.rendering.cpu import CpuRasterizer

    return CpuRasterizer(silhouette, threads, sharpness)


def _make_warp_rasterizer(silhouette: str, device: str) -> Rasterizer:
    if silhouette != "coverage":
        raise InputError(f"the Warp kernels draw exact coverage only: take --fit.rasterizer cpu for {silhouette!r}")
    if find_spec("warp") is None:
        raise InputError(f"the Warp kernels need warp-lang: {install_advice('cuda')}; or take --fit.rasterizer cpu")
    from hfb.rendering.warp import WarpRasterizer

    return WarpRasterizer(device)
