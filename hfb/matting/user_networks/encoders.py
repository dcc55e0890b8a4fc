"""The encoders of BackgroundMattingV2: ResNet (He et al. 2015) and MobileNetV2 (Sandler et al. 2018).

Both give their maps at 1/16, 1/8, 1/4, 1/2 and 1/1 of the image: the last halving is replaced by a dilation of two.
Parameters are named as in the weights that are published everywhere.
"""

from torch import nn

from hfb.typing import Float, Tensor

_MOBILE = ((1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 2), (6, 320, 1, 1))
"""Expansion, channels, blocks, stride of the first."""
_MOBILE_OUT = (1, 3, 6, 17)
"""The last blocks at 1/2, 1/4, 1/8 and 1/16."""
_DILATED_FROM = 14


class Bottleneck(nn.Module):
    """1 x 1, 3 x 3 (strided or dilated), 1 x 1 convolutions, plus the identity or a projection.

    Args:
        before: number of input channels.
        inner: number of inner channels, a quarter of the output's.
        stride: of the middle convolution.
        dilation: of the middle convolution.
    """

    def __init__(self, before: int, inner: int, stride: int, dilation: int) -> None:
        super().__init__()
        after = 4 * inner
        self.conv1 = nn.Conv2d(before, inner, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(inner)
        self.conv2 = nn.Conv2d(inner, inner, 3, stride, dilation, dilation, bias=False)
        self.bn2 = nn.BatchNorm2d(inner)
        self.conv3 = nn.Conv2d(inner, after, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(after)
        self.downsample: nn.Module | None = None
        if stride != 1 or before != after:
            self.downsample = nn.Sequential(nn.Conv2d(before, after, 1, stride, bias=False), nn.BatchNorm2d(after))

    def forward(self, picture: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D h w"]:
        """Apply the block; see the class.

        Args:
            picture: features, or the image itself.
        """
        kept = picture if self.downsample is None else self.downsample(picture)
        now = self.bn1(self.conv1(picture)).relu()
        now = self.bn2(self.conv2(now)).relu()
        return (self.bn3(self.conv3(now)) + kept).relu()


class ResNet(nn.Module):
    """ResNet-50 (6 blocks in its third stage) or -101 (23).

    Args:
        inputs: number of input channels.
        third: number of blocks in the third stage.
    """

    def __init__(self, inputs: int, third: int) -> None:
        super().__init__()
        self.channels = (2048, 512, 256, 64, inputs)
        self.conv1 = nn.Conv2d(inputs, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = _stage(64, 64, 3, 1)
        self.layer2 = _stage(256, 128, 4, 2)
        self.layer3 = _stage(512, 256, third, 2)
        self.layer4 = _stage(1024, 512, 3, 1, dilation=2)

    def forward(self, picture: Float[Tensor, "B C H W"]) -> tuple[Tensor, ...]:
        """Return feature maps from 1/16 of the size to the image itself.

        Args:
            picture: features, or the image itself.
        """
        half = self.bn1(self.conv1(picture)).relu()
        quarter = self.layer1(self.maxpool(half))
        eighth = self.layer2(quarter)
        return self.layer4(self.layer3(eighth)), eighth, quarter, half, picture


def _stage(before: int, inner: int, blocks: int, stride: int, dilation: int = 1) -> nn.Sequential:
    """Build a stage, whose first block is strided, and not yet dilated."""
    first = Bottleneck(before, inner, stride, 1)
    return nn.Sequential(first, *(Bottleneck(4 * inner, inner, 1, dilation) for _ in range(blocks - 1)))


class InvertedResidual(nn.Module):
    """Expansion, depthwise convolution, projection; plus the identity where sizes agree.

    Args:
        before: number of input channels.
        after: number of output channels.
        expansion: factor of the inner channels.
        stride: of the depthwise convolution.
        dilation: of the depthwise convolution.
    """

    def __init__(self, before: int, after: int, expansion: int, stride: int, dilation: int) -> None:
        super().__init__()
        inner = expansion * before
        self._keeps = stride == 1 and before == after
        layers: list[nn.Module] = [] if expansion == 1 else [_activated(nn.Conv2d(before, inner, 1, bias=False))]
        depthwise = nn.Conv2d(inner, inner, 3, stride, dilation, dilation, groups=inner, bias=False)
        layers += [_activated(depthwise), nn.Conv2d(inner, after, 1, bias=False), nn.BatchNorm2d(after)]
        self.conv = nn.Sequential(*layers)

    def forward(self, picture: Float[Tensor, "B C H W"]) -> Float[Tensor, "B D h w"]:
        """Apply the block; see the class.

        Args:
            picture: features, or the image itself.
        """
        return picture + self.conv(picture) if self._keeps else self.conv(picture)


class MobileNetV2(nn.Module):
    """MobileNetV2 up to its last block.

    Args:
        inputs: number of input channels.
    """

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.channels = (320, 32, 24, 16, inputs)
        blocks: list[nn.Module] = [_activated(nn.Conv2d(inputs, 32, 3, 2, 1, bias=False))]
        before = 32
        for expansion, after, count, stride in _MOBILE:
            for index in range(count):
                number = len(blocks)
                step = stride if index == 0 and number != _DILATED_FROM else 1
                block = InvertedResidual(before, after, expansion, step, 2 if number > _DILATED_FROM else 1)
                blocks.append(block)
                before = after
        self.features = nn.Sequential(*blocks)

    def forward(self, picture: Float[Tensor, "B C H W"]) -> tuple[Tensor, ...]:
        """Return feature maps from 1/16 of the size to the image itself.

        Args:
            picture: features, or the image itself.
        """
        maps, now = [picture], picture
        for number, block in enumerate(self.features):
            now = block(now)
            if number in _MOBILE_OUT:
                maps.append(now)
        return tuple(reversed(maps))


def _activated(convolution: nn.Conv2d) -> nn.Sequential:
    return nn.Sequential(convolution, nn.BatchNorm2d(convolution.out_channels), nn.ReLU6())
