"""The interface of rasterisers: R_F and R_S of the paper's eq. (1)."""

from typing import Protocol, runtime_checkable

from hfb.body.mesh import Mesh
from hfb.geometry.camera import PinholeCamera
from hfb.typing import Float, Tensor

Texture = Float[Tensor, "A A 3"]
"""Texture of a body; row 0 is v = 0."""

NEAR_M = 0.05
"""Faces with a corner nearer to the lens than this [m], or behind it, are not drawn."""


@runtime_checkable
class Rasterizer(Protocol):
    """Draws bodies, one per sub-frame: differentiable in the vertices and in the texture.

    vertices: [m], camera coordinates (OpenCV). texture: linear RGB, row 0 is v = 0; None where only the
    silhouette is wanted (its colours are then zero). A body outside the image, behind the lens or of zero
    size draws nothing and receives zero gradients.
    """

    def render(
        self, vertices: Float[Tensor, "S V 3"], texture: Texture | None, camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "S H W 4"]:
        """Return one image per sub-frame: R_S R_F (linear RGB, premultiplied) and R_S, the silhouette in [0, 1].

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            texture: linear light; None draws silhouettes alone.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
        """
        ...

    def render_mean(
        self, vertices: Float[Tensor, "S V 3"], texture: Texture | None, camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "H W 4"]:
        """Return the averages of eq. (1); back ends do not hold the single images.

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            texture: linear light; None draws silhouettes alone.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
        """
        return self.render(vertices, texture, camera, mesh).mean(0)

    def silhouette_mean(
        self, vertices: Float[Tensor, "S V 3"], camera: PinholeCamera, mesh: Mesh
    ) -> Float[Tensor, "H W"]:
        """Return the mean of R_S over the sub-frames, which is compared with the matte.

        Args:
            vertices: vertices of each sub-frame [m], camera coordinates.
            camera: pinhole camera; its height and width are the image's.
            mesh: faces, edges and texture coordinates of the body.
        """
        return self.render_mean(vertices, None, camera, mesh)[..., 3]
