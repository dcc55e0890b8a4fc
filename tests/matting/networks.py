"""Small networks with the interfaces of BackgroundMattingV2 and Robust Video Matting."""

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional


class DifferenceMatting(nn.Module):
    """BackgroundMattingV2's interface as its export_torchscript.py makes it: options hoisted to the top level.

    alpha = how much a picture differs from its plate, seen coarsely, its worst pixels refined. It asks for sides that
    are multiples of four, and fails like the real one where more pixels are to be refined than there are.
    """

    def __init__(self) -> None:
        super().__init__()
        self.backbone_scale = 0.25
        self.refine_mode = "sampling"
        self.refine_sample_pixels = 80_000
        self.refine_threshold = 0.1
        self.register_buffer("gain", torch.tensor(4.0))

    def forward(self, src: Tensor, bgr: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
        assert src.size() == bgr.size()
        assert src.size(2) % 4 == 0 and src.size(3) % 4 == 0  # noqa: PT018  (scripted)
        full = ((src - bgr).abs().amax(1, keepdim=True) * self.gain).clamp(0.0, 1.0)
        coarse = functional.interpolate(full, scale_factor=self.backbone_scale, mode="area")
        error = functional.interpolate(coarse, scale_factor=0.25 / self.backbone_scale, mode="nearest").flatten(1)
        if self.refine_mode == "sampling":
            error.topk(self.refine_sample_pixels // 16, dim=1)
        return full, src, coarse, coarse, coarse, coarse


class RememberingMatting(nn.Module):
    """Robust Video Matting's interface: four states go in and out; alpha grows as it looks again."""

    def forward(
        self,
        src: Tensor,
        r1: Tensor | None = None,
        r2: Tensor | None = None,
        r3: Tensor | None = None,
        r4: Tensor | None = None,
        downsample_ratio: float = 1.0,
    ) -> list[Tensor]:
        before = torch.zeros(1, 1, 1, 1) if r1 is None else r1
        now = before + 1
        alpha = (src[:, :1] > 0.5).float() * (1 - 0.5**now) + 0 * downsample_ratio
        return [src, alpha, now, now, now, now]


def save_scripted(module: nn.Module, path: Path) -> Path:
    torch.jit.script(module.eval()).save(str(path))
    return path
