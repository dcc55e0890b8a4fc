"""Other differentiable rasterisers, doing the same work: the mean picture of the sub-frames, and its way back.

Each is used where it is installed; infra/peers/README.md says how to get them.
"""

import math
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import torch

from hfb.body.mesh import Mesh
from hfb.geometry.camera import PinholeCamera

MeanPicture = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
"""Vertices (S, V, 3) and texture (A, A, 3) to the mean of the sub-frames' pictures (H, W, 4)."""


def drtk_is_here() -> str | None:
    """None where Meta's DRTK can be used, else why not."""
    if find_spec("drtk") is None:
        return "DRTK is not installed (infra/peers/README.md)"
    try:
        found = version("drtk")
    except PackageNotFoundError:  # built in place
        return None
    if int(found.split(".")[0]) >= 100:  # before it is imported: it is somebody else's code
        return f"the package named drtk {found} is not Meta's DRTK; remove it (infra/peers/README.md)"
    return None


def drtk_mean(camera: PinholeCamera, mesh: Mesh) -> MeanPicture:
    """DRTK: rasterise, barycentrics, texture, edge gradients."""
    import drtk

    faces, uv_faces = mesh.faces.int(), mesh.uv_faces.int()
    uv = (2 * mesh.uv - 1)[None]

    def draw(vertices: torch.Tensor, texture: torch.Tensor) -> torch.Tensor:
        pixels = torch.cat([camera.project(vertices) - 0.5, vertices[..., 2:]], -1)
        index = drtk.rasterize(pixels, faces, camera.height, camera.width)
        _, barycentric = drtk.render(pixels, faces, index)
        where = drtk.interpolate(uv.expand(len(vertices), -1, -1), uv_faces, index, barycentric)
        texels = texture.permute(2, 0, 1)[None].expand(len(vertices), -1, -1, -1)
        colour = torch.nn.functional.grid_sample(
            texels, where.permute(0, 2, 3, 1), mode="bilinear", padding_mode="border", align_corners=False
        )
        inside = (index >= 0)[:, None].to(colour)
        picture = torch.cat([colour * inside, inside], 1)
        picture = drtk.edge_grad_estimator(v_pix=pixels, vi=faces, bary_img=barycentric, img=picture, index_img=index)
        return picture.mean(0).permute(1, 2, 0)

    return draw


def pytorch3d_is_here() -> str | None:
    """None where PyTorch3D can be used, else why not."""
    return None if find_spec("pytorch3d") else "PyTorch3D is not installed (infra/peers/README.md)"


def pytorch3d_mean(camera: PinholeCamera, mesh: Mesh) -> MeanPicture:
    """PyTorch3D: its soft silhouette, 50 faces per pixel; no colours, which would cost it more still."""
    from pytorch3d.renderer import (
        BlendParams,
        MeshRasterizer,
        MeshRenderer,
        RasterizationSettings,
        SoftSilhouetteShader,
    )
    from pytorch3d.structures import Meshes
    from pytorch3d.utils import cameras_from_opencv_projection

    size = camera.height, camera.width
    view = cameras_from_opencv_projection(
        torch.eye(3)[None], torch.zeros(1, 3), camera.matrix(torch.float32)[None], torch.tensor([size])
    )
    blend = BlendParams(sigma=1e-4, gamma=1e-4)
    settings = RasterizationSettings(
        image_size=size, blur_radius=math.log(1 / 1e-4 - 1) * blend.sigma, faces_per_pixel=50
    )
    renderer = MeshRenderer(MeshRasterizer(view, settings), SoftSilhouetteShader(blend))

    def draw(vertices: torch.Tensor, _: torch.Tensor) -> torch.Tensor:
        pictures = [renderer(Meshes(body[None], mesh.faces[None]))[0] for body in vertices]
        return torch.stack(pictures).mean(0)

    return draw
