"""The rasteriser for CUDA devices: Warp kernels, all bodies of a batch at once."""

import numpy as np
import torch

from hfb.body.mesh import Mesh
from hfb.errors import InputError
from hfb.render.camera import PinholeCamera
from hfb.render.cuda_operators import draw_by_warp
from hfb.render.rasterizer import NEAR_M
from hfb.render.texture import corner_uv
from hfb.shapes import Float, Int, Tensor


def _memberships(owners: Int[Tensor, "n k"], count: int) -> tuple[Int[Tensor, "c"], Int[Tensor, "m"]]:
    """For each of `count` vertices where it stands in a table of vertices: (where its places begin, the places)."""
    flat = owners.flatten().numpy()
    begins = np.concatenate([[0], np.bincount(flat, minlength=count).cumsum()])
    return torch.from_numpy(begins), torch.from_numpy(np.argsort(flat, kind="stable"))


class WarpRasterizer:
    """The Protocol of `hfb.render.rasterizer` in float32 or float64, exact coverage (geometry in float64).

    Draws on its own device and answers on the caller's: nothing is copied where these are the same.
    """

    def __init__(self, device: str = "cuda") -> None:
        """device: "cuda", "cuda:1" ..., or "cpu", where the same kernels run on one thread, for tests.

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
        """Texture coordinates of corners and index tables, on the device; kept for the mesh used last."""
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
        texture: Float[Tensor, "A A 3"] | None,
        camera: PinholeCamera,
        mesh: Mesh,
        subframes: int,
    ) -> tuple[Tensor, Tensor, Tensor, list[Tensor], list[float], int]:
        """What `cuda_operators.draw_by_warp` takes."""
        uv, topology = self._of_mesh(mesh, vertices.shape[1])
        lens = [camera.fx, camera.fy, camera.cx, camera.cy, NEAR_M, camera.height, camera.width]
        texels = vertices.new_empty(0, 0, 3) if texture is None else texture.to(vertices.dtype)
        bodies, texels = vertices.to(self.device).contiguous(), texels.to(self.device).contiguous()
        return bodies, texels, uv, topology, [float(value) for value in lens], subframes

    def _pictures(
        self,
        vertices: Float[Tensor, "B V 3"],
        texture: Float[Tensor, "A A 3"] | None,
        camera: PinholeCamera,
        mesh: Mesh,
        subframes: int,
    ) -> Float[Tensor, "P H W 4"]:
        pictures = draw_by_warp(*self.arguments(vertices, texture, camera, mesh, subframes))[0].to(vertices.device)
        return pictures if texture is not None else torch.nn.functional.pad(pictures, (3, 0))

    def render(
        self,
        vertices: Float[Tensor, "S V 3"],
        texture: Float[Tensor, "A A 3"] | None,
        camera: PinholeCamera,
        mesh: Mesh,
    ) -> Float[Tensor, "S H W 4"]:
        """One picture per sub-frame: R_S R_F and R_S."""
        return self._pictures(vertices, texture, camera, mesh, 1)

    def render_mean(
        self,
        vertices: Float[Tensor, "S V 3"],
        texture: Float[Tensor, "A A 3"] | None,
        camera: PinholeCamera,
        mesh: Mesh,
    ) -> Float[Tensor, "H W 4"]:
        """Mean of `render` over the sub-frames."""
        return self._pictures(vertices, texture, camera, mesh, len(vertices))[0]

    def render_frames(
        self,
        vertices: Float[Tensor, "T S V 3"],
        texture: Float[Tensor, "A A 3"] | None,
        camera: PinholeCamera,
        mesh: Mesh,
    ) -> Float[Tensor, "T H W 4"]:
        """`render_mean` of several frames (or windows) at once: what keeps a device busy."""
        return self._pictures(vertices.flatten(0, 1), texture, camera, mesh, vertices.shape[1])

    def silhouette_mean(
        self, vertices: Float[Tensor, "S V 3"], camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "H W"]:
        """Mean of R_S over the sub-frames."""
        arguments = self.arguments(vertices, None, camera, mesh, len(vertices))
        return draw_by_warp(*arguments)[0][0, ..., 0].to(vertices.device)
