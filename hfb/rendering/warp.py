"""The rasteriser for CUDA devices: Warp kernels, all bodies of a batch at once."""

from collections.abc import Sequence

import numpy as np
import torch

from hfb.body.mesh import Mesh
from hfb.errors import InputError
from hfb.geometry.camera import PinholeCamera
from hfb.kernels.warp.operators import draw_by_warp
from hfb.rendering.rasterizer import NEAR_M, Rasterizer, Texture
from hfb.rendering.texels import corner_uv
from hfb.typing import Float, Int, Tensor


def _memberships(owners: Int[Tensor, "n k"], count: int) -> tuple[Int[Tensor, "c"], Int[Tensor, "m"]]:
    """Return the places of each of `count` vertices in a table of vertices: (first place of each, the places)."""
    flat = owners.flatten().numpy()
    begins = np.concatenate([[0], np.bincount(flat, minlength=count).cumsum()])
    return torch.from_numpy(begins), torch.from_numpy(np.argsort(flat, kind="stable"))


class WarpRasterizer(Rasterizer):
    """The Protocol of `hfb.rendering.rasterizer` in float32 or float64, exact coverage (geometry in float64).

    It renders on its own device and returns results on the caller's; nothing is copied where these are the same.

    Args:
        device: "cuda", "cuda:1" ..., or "cpu", where the same kernels run on one thread, for tests.
    """

    def __init__(self, device: str = "cuda") -> None:
        """Choose the device: "cuda", "cuda:1" ..., or "cpu", where the same kernels run on one thread, for tests.

        Raises:
            InputError: there is no such device.
        """
        if device != "cpu" and not torch.cuda.is_available():
            raise InputError(
                f"this torch finds no device {device!r}: install one built for it, or take --fit.rasterizer cpu"
            )
        self.device = torch.device(device)
        self._tables: tuple[Mesh, int, Tensor, list[Tensor]] | None = None

    def _of_mesh(self, mesh: Mesh, vertex_count: int) -> tuple[Tensor, list[Tensor]]:
        """Return texture coordinates of corners and index tables, on the device; kept for the mesh used last."""
        tables = self._tables
        if tables is None or tables[0] is not mesh or tables[1] != vertex_count:
            members = *_memberships(mesh.faces, vertex_count), *_memberships(mesh.edge_vertices, vertex_count)
            index = mesh.faces, mesh.edge_vertices, mesh.edge_faces, *members
            on_device = [table.to(self.device, torch.int32).contiguous() for table in index]
            uv = corner_uv(mesh).to(self.device, torch.float64).contiguous()
            tables = self._tables = (mesh, vertex_count, uv, on_device)
        return tables[2], tables[3]

    def arguments(
        self,
        vertices: Float[Tensor, "B V 3"],
        textures: Float[Tensor, "G A A 3"] | None,
        cameras: Sequence[PinholeCamera],
        mesh: Mesh,
    ) -> tuple[Tensor, Tensor, Tensor, list[Tensor], Tensor, list[int], float]:
        """Return the arguments of `hfb.kernels.warp.operators.draw_by_warp`.

        Args:
            vertices: vertices of all images' sub-frames, one after another [m], camera coordinates.
            textures: linear light, one per group of cameras; None draws silhouettes alone.
            cameras: one per image, all of one size.
            mesh: faces, edges and texture coordinates of the body.

        Raises:
            ValueError: cameras of several image sizes, or bodies or textures that do not share out evenly.
        """
        sizes = {(camera.height, camera.width) for camera in cameras}
        groups = 1 if textures is None else len(textures)
        if len(sizes) != 1 or len(vertices) % len(cameras) or len(cameras) % groups:
            raise ValueError(f"{len(vertices)} bodies, {groups} textures, {len(cameras)} pictures of sizes {sizes}")
        uv, topology = self._of_mesh(mesh, vertices.shape[1])
        lens = [[camera.fx, camera.fy, camera.cx, camera.cy] for camera in cameras]
        texels = vertices.new_empty(1, 0, 0, 3) if textures is None else textures.to(vertices.dtype)
        bodies, texels = vertices.to(self.device).contiguous(), texels.to(self.device).contiguous()
        lenses = torch.tensor(lens, dtype=torch.float64).to(self.device)
        return bodies, texels, uv, topology, lenses, [int(side) for side in sizes.pop()], NEAR_M

    def render_pictures(
        self,
        vertices: Float[Tensor, "P S V 3"],
        textures: Float[Tensor, "G A A 3"] | None,
        cameras: Sequence[PinholeCamera],
        mesh: Mesh,
    ) -> Float[Tensor, "P H W 4"]:
        """Return `render_mean` of several images (frames, windows, whole fits) at once, which uses a device well.

        Args:
            vertices: vertices of each image's sub-frames [m], camera coordinates.
            textures: image p uses number p G / P; colours are zero without any.
            cameras: one per image, all of one size.
            mesh: faces, edges and texture coordinates of the body.
        """
        pictures = draw_by_warp(*self.arguments(vertices.flatten(0, 1), textures, cameras, mesh))[0]
        pictures = pictures.to(vertices.device)
        return pictures if textures is not None else torch.nn.functional.pad(pictures, (3, 0))

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
        textures = None if texture is None else texture[None]
        return self.render_pictures(vertices[:, None], textures, [camera] * len(vertices), mesh)

    def render_mean(
        self, vertices: Float[Tensor, "S V 3"], texture: Texture | None, camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "H W 4"]:
        """Return the mean of `render` over the sub-frames.

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            texture: linear light; None draws silhouettes alone.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
        """
        return self.render_pictures(vertices[None], None if texture is None else texture[None], [camera], mesh)[0]
