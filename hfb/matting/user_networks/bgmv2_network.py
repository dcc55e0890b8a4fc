"""BackgroundMattingV2 (Lin et al., Real-Time High-Resolution Background Matting, 2021), for its plain weights.

Written from the paper's description, with the released names of parameters: an encoder (ResNet or MobileNetV2) at a
small size whose last block is dilated instead of strided, atrous pooling, a decoder with skip connections from the
encoder, and a refiner that processes at full size only the 4 x 4 patches with the largest predicted error.
"""

from collections.abc import Mapping

import torch
from torch import nn
from torch.nn import functional

from hfb.matting.user_networks.encoders import MobileNetV2, ResNet
from hfb.typing import Bool, Float, Tensor

_BASE_CHANNELS = 1 + 3 + 1 + 32  # alpha, colour, error, and further input of the refiner


class MattingNetwork(nn.Module):
    """Base and, where the weights have one, refiner; its attributes are those of the released TorchScript files.

    Args:
        backbone: mobilenetv2, resnet50 or resnet101.
        refined: whether the weights have a refiner.
    """

    def __init__(self, backbone: str, refined: bool) -> None:
        """Build the layers; `backbone` is mobilenetv2, resnet50 or resnet101."""
        super().__init__()
        self.backbone = MobileNetV2(6) if backbone == "mobilenetv2" else ResNet(6, 23 if backbone == "resnet101" else 6)
        deepest, *finer = self.backbone.channels
        self.aspp = AtrousPooling(deepest)
        self.decoder = Decoder((256, 128, 64, 48, _BASE_CHANNELS), tuple(finer))
        if refined:
            self.refiner = Refiner()
        self._refined = refined
        self.backbone_scale = 0.25
        self.refine_mode = "sampling"
        self.refine_sample_pixels = 80_000
        self.refine_threshold = 0.1

    def forward(self, src: Float[Tensor, "B 3 H W"], bgr: Float[Tensor, "B 3 H W"]) -> tuple[Tensor, ...]:
        """Return alpha, colour and error at full size; alpha first.

        Args:
            src: frame, sRGB in [0, 1], sides multiples of four.
            bgr: plate, likewise.
        """
        both = torch.cat([src, bgr], 1)
        small = _resized(both, scale=self.backbone_scale) if self._refined else both
        deepest, *finer = self.backbone(small)
        found = self.decoder(self.aspp(deepest), finer)
        alpha, error = found[:, :1].clamp(0, 1), found[:, 4:5].clamp(0, 1)
        colour, hidden = found[:, 1:4], found[:, 5:].relu()
        if not self._refined:
            return alpha, (colour + src).clamp(0, 1), error
        chosen = self._chosen(error, src.shape[-2] // 4, src.shape[-1] // 4)
        fine = self.refiner(both, torch.cat([hidden, alpha, colour], 1), chosen)
        return fine[:, :1].clamp(0, 1), (fine[:, 1:] + src).clamp(0, 1), alpha, error

    def _chosen(self, error: Float[Tensor, "B 1 h w"], rows: int, columns: int) -> Bool[Tensor, "B a b"] | None:
        """Return the patches to refine; None for all of them at once."""
        if self.refine_mode == "full":
            return None
        error = _resized(error, (rows, columns))[:, 0]
        if self.refine_mode == "thresholding":
            return error > self.refine_threshold
        worst = error.flatten(1).topk(self.refine_sample_pixels // 16, dim=1, sorted=False).indices
        ranked = torch.zeros_like(error.flatten(1), dtype=torch.bool).scatter_(1, worst, True)
        return ranked.unflatten(1, (rows, columns)) & (error > 0)


class AtrousPooling(nn.Module):
    """DeepLabV3's atrous spatial pyramid: dilations 3, 6, 9, a 1 x 1 convolution and the image's mean.

    Args:
        channels: number of input channels.
        inner: number of output channels.
    """

    def __init__(self, channels: int, inner: int = 256) -> None:
        super().__init__()

        def dilated(rate: int) -> nn.Sequential:
            convolution = nn.Conv2d(channels, inner, 3, padding=rate, dilation=rate, bias=False)
            return nn.Sequential(convolution, nn.BatchNorm2d(inner), nn.ReLU())

        point = nn.Sequential(nn.Conv2d(channels, inner, 1, bias=False), nn.BatchNorm2d(inner), nn.ReLU())
        mean = nn.Sequential(
            nn.AdaptiveAvgPool2d(1), nn.Conv2d(channels, inner, 1, bias=False), nn.BatchNorm2d(inner), nn.ReLU()
        )
        self.convs = nn.ModuleList([point, *(dilated(rate) for rate in (3, 6, 9)), mean])
        self.project = nn.Sequential(nn.Conv2d(5 * inner, inner, 1, bias=False), nn.BatchNorm2d(inner), nn.ReLU())

    def forward(self, deep: Float[Tensor, "B C h w"]) -> Float[Tensor, "B 256 h w"]:
        """Return the pooled features at the size of the input.

        Args:
            deep: the encoder's smallest feature map.
        """
        parts = [convolution(deep) for convolution in self.convs]
        parts[-1] = _resized(parts[-1], deep.shape[-2:])
        return self.project(torch.cat(parts, 1))


class Decoder(nn.Module):
    """Four doublings, each with the encoder's map of that size as a skip connection.

    Args:
        channels: number of channels of each step.
        beside: number of channels of the encoder's maps.
    """

    def __init__(self, channels: tuple[int, ...], beside: tuple[int, ...]) -> None:
        super().__init__()
        for step, (before, after, other) in enumerate(zip(channels, channels[1:], beside, strict=False), start=1):
            last = step == len(beside)
            setattr(self, f"conv{step}", nn.Conv2d(before + other, after, 3, padding=1, bias=last))
            setattr(self, f"bn{step}", nn.Identity() if last else nn.BatchNorm2d(after))
        self._steps = len(beside)

    def forward(self, deep: Float[Tensor, "B 256 h w"], finer: list[Tensor]) -> Float[Tensor, "B C H W"]:
        """Return the decoded map at the size of the last entry of `finer`.

        Args:
            deep: features to start from.
            finer: the encoder's maps, the smallest first, the input itself last.
        """
        now = deep
        for step, beside in enumerate(finer, start=1):
            now = torch.cat([_resized(now, beside.shape[-2:]), beside], 1)
            now = getattr(self, f"bn{step}")(getattr(self, f"conv{step}")(now))
            if step < self._steps:
                now = now.relu()
        return now


class Refiner(nn.Module):
    """Two convolutions at half and two at full size, everywhere or on patches of 4 x 4 pixels."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(32 + 4 + 6, 24, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(24)
        self.conv2 = nn.Conv2d(24, 16, 3, bias=False)
        self.bn2 = nn.BatchNorm2d(16)
        self.conv3 = nn.Conv2d(16 + 6, 12, 3, bias=False)
        self.bn3 = nn.BatchNorm2d(12)
        self.conv4 = nn.Conv2d(12, 4, 3)

    def forward(
        self, both: Float[Tensor, "B 6 H W"], coarse: Float[Tensor, "B 36 h w"], chosen: Bool[Tensor, "B a b"] | None
    ) -> Float[Tensor, "B 4 H W"]:
        """Return alpha and colour at full size; the coarse ones enlarged where no patch is chosen.

        Args:
            both: frame and plate, sRGB.
            coarse: the decoder's channels at reduced size.
            chosen: patches to refine; None for all.
        """
        height, width = both.shape[-2:]
        half = torch.cat([_resized(one, (height // 2, width // 2)) for one in (coarse, both)], 1)
        padded_half, padded = functional.pad(half, (3,) * 4), functional.pad(both, (2,) * 4)
        if chosen is None:
            middle = functional.interpolate(self._half(padded_half), size=padded.shape[-2:])  # nearest
            return self._full(middle, padded)
        whole = _resized(coarse[:, 32:], (height, width))
        if not bool(chosen.any()):
            return whole
        middle = functional.interpolate(self._half(_patches(padded_half, 8, 2, chosen)), size=(8, 8))
        fine = self._full(middle, _patches(padded, 8, 4, chosen))
        tiles = whole.unflatten(3, (-1, 4)).unflatten(2, (-1, 4)).permute(0, 2, 4, 1, 3, 5).clone()
        tiles[chosen] = fine
        return tiles.permute(0, 3, 1, 4, 2, 5).flatten(4, 5).flatten(2, 3)

    def _half(self, picture: Float[Tensor, "n 42 h w"]) -> Float[Tensor, "n 16 a b"]:
        return self.bn2(self.conv2(self.bn1(self.conv1(picture)).relu())).relu()

    def _full(self, told: Float[Tensor, "n 16 h w"], both: Float[Tensor, "n 6 h w"]) -> Float[Tensor, "n 4 a b"]:
        return self.conv4(self.bn3(self.conv3(torch.cat([told, both], 1))).relu())


def network_of(state: Mapping[str, Tensor]) -> MattingNetwork:
    """Build the network that some weights belong to, in evaluation mode.

    Args:
        state: weights by name, as released.

    Raises:
        ValueError: they are of another network.
    """
    if "backbone.features.0.0.weight" in state:
        backbone = "mobilenetv2"
    else:
        backbone = "resnet101" if "backbone.layer3.22.conv1.weight" in state else "resnet50"
    network = MattingNetwork(backbone, "refiner.conv1.weight" in state)
    try:
        network.load_state_dict(dict(state))
    except RuntimeError as error:
        raise ValueError(str(error)) from error
    return network.requires_grad_(False).eval()


def _patches(picture: Tensor, side: int, step: int, chosen: Bool[Tensor, "B a b"]) -> Float[Tensor, "n C side side"]:
    """Return windows of a padded image, one per chosen patch."""
    windows = picture.permute(0, 2, 3, 1).unfold(1, side, step).unfold(2, side, step)
    return windows[chosen]


def _resized(picture: Tensor, size: tuple[int, ...] | torch.Size | None = None, scale: float | None = None) -> Tensor:
    if scale is not None:
        return functional.interpolate(
            picture, scale_factor=scale, mode="bilinear", align_corners=False, recompute_scale_factor=True
        )
    assert size is not None
    return functional.interpolate(picture, size=tuple(size), mode="bilinear", align_corners=False)
