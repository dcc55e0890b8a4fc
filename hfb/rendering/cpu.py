"""The fast rasteriser: compiled kernels, bit-equal for any number of threads."""

from typing import Literal

import torch

from hfb.body.mesh import Mesh
from hfb.geometry.camera import PinholeCamera
from hfb.kernels.rendering.render_blocks import Setting
from hfb.kernels.rendering.render_operators import ImageLoss, draw, losses_of, pictures
from hfb.rendering.rasterizer import NEAR_M, Texture
from hfb.rendering.reference_dibr import dibr_constants
from hfb.rendering.texels import corner_uv
from hfb.typing import Float, Tensor


class CpuRasterizer:
    """The Protocol of `hfb.rendering.rasterizer` in float32 or float64 (the kernels compute and add in float64).

    Args:
        silhouette: exact coverage, or DIB-R's mask.
        threads: number of threads; results do not depend on it.
        sharpness: of DIB-R's mask, see `hfb.rendering.reference_dibr.dibr_constants`.
    """

    def __init__(
        self, silhouette: Literal["coverage", "dibr"] = "coverage", threads: int = 1, sharpness: float = 1.0
    ) -> None:
        self.silhouette, self.threads, self._sharpness = silhouette, threads, sharpness
        self._tables: tuple[Mesh, Tensor, list[Tensor]] | None = None
        self._kept: tuple[Mesh, PinholeCamera, bool, Setting] | None = None

    def _of_mesh(self, mesh: Mesh) -> tuple[Tensor, list[Tensor]]:
        """Return texture coordinates of corners, and index tables of the smallest integer type that holds them.

        The tables are read for every body, and small ones fit into the CPU's cache. The last mesh's are cached.
        """
        tables = self._tables
        if tables is None or tables[0] is not mesh:
            index = [mesh.faces, mesh.edge_vertices, mesh.edge_faces]
            small = max(int(table.max()) for table in index) < 2**16 - 1
            whole = [table.to(torch.int32).to(torch.int16 if small else torch.int32).contiguous() for table in index]
            tables = self._tables = (mesh, corner_uv(mesh).contiguous(), whole)
        return tables[1], tables[2]

    def _same(
        self, camera: PinholeCamera, mesh: Mesh, mean: bool
    ) -> tuple[Tensor, list[Tensor], list[float], list[float], bool, int]:
        """Return the arguments that do not depend on bodies and texture."""
        lens = [camera.fx, camera.fy, camera.cx, camera.cy, NEAR_M, camera.width, camera.height]
        soft = dibr_constants(camera, self._sharpness) if self.silhouette == "dibr" else (0.0, 0.0, 0)
        numbers = [float(value) for value in lens], [float(value) for value in soft]
        return *self._of_mesh(mesh), *numbers, mean, self.threads

    def _setting(self, camera: PinholeCamera, mesh: Mesh, mean: bool) -> Setting:
        """Return the setting, cached for the last mesh and camera."""
        kept = self._kept
        if kept is None or kept[0] is not mesh or kept[1:3] != (camera, mean):
            kept = self._kept = (mesh, camera, mean, Setting.of(*self._same(camera, mesh, mean)))
        return kept[3]

    def arguments(
        self, vertices: Float[Tensor, "S V 3"], texture: Texture | None, camera: PinholeCamera, mesh: Mesh, mean: bool
    ) -> tuple[Tensor, Tensor, Tensor, list[Tensor], list[float], list[float], bool, int]:
        """Return the arguments of `hfb.kernels.rendering.render_operators.draw`.

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            texture: linear light; None draws silhouettes alone.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
            mean: draw the mean over the sub-frames.
        """
        return *_whole(vertices, texture), *self._same(camera, mesh, mean)

    def _drawn(
        self, vertices: Float[Tensor, "S V 3"], texture: Texture | None, camera: PinholeCamera, mesh: Mesh, mean: bool
    ) -> Float[Tensor, "P H W C"]:
        if torch.compiler.is_compiling():
            return draw(*self.arguments(vertices, texture, camera, mesh, mean))[0]
        return pictures(*_whole(vertices, texture), self._setting(camera, mesh, mean))

    def render(
        self, vertices: Float[Tensor, "S V 3"], texture: Texture | None, camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "S H W 4"]:
        """Return one image per sub-frame: R_S R_F and R_S.

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            texture: linear light; None draws silhouettes alone.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
        """
        return _coloured(self._drawn(vertices, texture, camera, mesh, False))

    def render_mean(
        self, vertices: Float[Tensor, "S V 3"], texture: Texture | None, camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "H W 4"]:
        """Return the mean of `render` over the sub-frames, without holding the single images.

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            texture: linear light; None draws silhouettes alone.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
        """
        # Not indexed: the backward pass of an index fills an image with zeros and copies.
        return _coloured(self._drawn(vertices, texture, camera, mesh, True)).squeeze(0)

    def image_losses(
        self,
        vertices: Float[Tensor, "S V 3"],
        texture: Float[Tensor, "A A 3"],
        camera: PinholeCamera,
        mesh: Mesh,
        loss: ImageLoss,
    ) -> tuple[Float[Tensor, ""], ...]:
        """Return losses of `render_mean`, differentiable in the vertices and the texture; one autograd node for both.

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            texture: linear light.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
            loss: loss of the mean image, with its gradient.
        """
        return losses_of(*_whole(vertices, texture), self._setting(camera, mesh, True), loss)

    def silhouette_mean(
        self, vertices: Float[Tensor, "S V 3"], camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "H W"]:
        """Return the mean of R_S over the sub-frames.

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
        """
        return self._drawn(vertices, None, camera, mesh, True).squeeze((0, -1))


def _whole(
    vertices: Float[Tensor, "S V 3"], texture: Float[Tensor, "A A 3"] | None
) -> tuple[Float[Tensor, "S V 3"], Float[Tensor, "A A 3"]]:
    """Return both as arguments of the operators: an empty texture for none."""
    texels = vertices.new_empty(0, 0, 3) if texture is None else texture.to(vertices.dtype)
    return vertices.contiguous(), texels.contiguous()


def _coloured(drawn: Float[Tensor, "P H W C"]) -> Float[Tensor, "P H W 4"]:
    """Return a silhouette alone, C = 1, as black with alpha."""
    return drawn if drawn.shape[-1] == 4 else torch.nn.functional.pad(drawn, (3, 0))
