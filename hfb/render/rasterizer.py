"""The one interface through which the forward model sees a body: R_F and R_S of the paper's eq. (1)."""

from importlib.util import find_spec
from typing import Literal, Protocol, runtime_checkable

from hfb.body.mesh import Mesh
from hfb.errors import InputError
from hfb.render.camera import PinholeCamera
from hfb.shapes import Float, Tensor

NEAR_M = 0.05
"""Faces with a corner nearer to the lens than this [m], or behind it, are not drawn."""


@runtime_checkable
class Rasterizer(Protocol):
    """Draws bodies, one per sub-frame: differentiable in the vertices and in the texture.

    vertices: [m], camera coordinates (OpenCV). texture: linear RGB, row 0 is v = 0; None where only the
    silhouette is wanted (its colours are then zero). A body outside the picture, behind the lens or of zero
    size draws nothing and receives zero gradients.
    """

    def render(
        self,
        vertices: Float[Tensor, "S V 3"],
        texture: Float[Tensor, "A A 3"] | None,
        camera: PinholeCamera,
        mesh: Mesh,
    ) -> Float[Tensor, "S H W 4"]:
        """One picture per sub-frame: R_S R_F (linear RGB, premultiplied) and R_S, the silhouette in [0, 1]."""
        ...

    def render_mean(
        self,
        vertices: Float[Tensor, "S V 3"],
        texture: Float[Tensor, "A A 3"] | None,
        camera: PinholeCamera,
        mesh: Mesh,
    ) -> Float[Tensor, "H W 4"]:
        """`render(...).mean(0)`, the averages of eq. (1), without holding the single pictures."""
        ...

    def silhouette_mean(
        self, vertices: Float[Tensor, "S V 3"], camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "H W"]:
        """Mean of R_S over the sub-frames: what the matte is compared with. Cheaper than `render_mean`."""
        ...


def make_rasterizer(
    silhouette: Literal["coverage", "dibr"] = "coverage",
    backend: Literal["cpu", "reference", "cuda", "warp"] = "cpu",
    threads: int = 1,
) -> Rasterizer:
    """Choose how silhouettes are drawn.

    silhouette: "coverage" is the exact share of each pixel that the body covers, with gradients from both
        sides of the edge; "dibr" is DIB-R's soft mask, a halo outside the edge, as in the paper.
    backend: "cpu" are the compiled kernels, "reference" the readable torch formulas they are tested against, "cuda"
        the Warp kernels on a CUDA device, "warp" the same on one thread of the processor.
    threads: of the compiled kernels; the result does not depend on it.

    Raises:
        InputError: Warp or a CUDA device is missing, or asked for what the Warp kernels do not draw.
    """
    if backend == "reference":
        from hfb.render.reference import ReferenceRasterizer

        return ReferenceRasterizer(silhouette)
    if backend in ("cuda", "warp"):
        return _make_warp_rasterizer(silhouette, "cuda" if backend == "cuda" else "cpu")
    from hfb.render.cpu import CpuRasterizer

    return CpuRasterizer(silhouette, threads)


def _make_warp_rasterizer(silhouette: str, device: str) -> Rasterizer:
    if silhouette != "coverage":
        raise InputError(f"the Warp kernels draw exact coverage only: take --fit.rasterizer cpu for {silhouette!r}")
    if find_spec("warp") is None:
        raise InputError("the Warp kernels need warp-lang: pip install 'hfb[cuda]', or take --fit.rasterizer cpu")
    from hfb.render.cuda import WarpRasterizer

    return WarpRasterizer(device)
