"""Draw the moving picture of README.md from the film of a result: blurred frame beside the recovered sub-frames.

    hfb demo --out build/demo
    python docs/images/moving.py build/demo

Writes docs/images/moving.webp from slowmotion.mp4: its first two panels, a few images per second, played in a loop.
"""

import sys
from pathlib import Path

import av
from PIL import Image, ImageDraw

_OUT = Path(__file__).parent / "moving.webp"
_PANELS, _SHOWN_PANELS, _TIME_LINE_PX = 3, 2, 32
_EVERY, _STEP_MS, _HOLD_MS = 4, 133, 900
_WIDTH_PX, _BAR_PX, _QUALITY = 720, 6, 70
LARGEST_BYTES = 400_000


def draw_moving_picture(film: Path) -> list[Image.Image]:
    """Return the images of the animation.

    Args:
        film: slowmotion.mp4 of a result.
    """
    with av.open(str(film)) as container:
        images = [frame.to_image() for frame in container.decode(video=0)]
    width, height = images[0].width * _SHOWN_PANELS // _PANELS, images[0].height - _TIME_LINE_PX
    shown = [image.crop((0, 0, width, height)) for image in [*images[:-1:_EVERY], images[-1]]]
    size = (_WIDTH_PX, round(height * _WIDTH_PX / width))
    small = [image.resize(size, Image.Resampling.LANCZOS) for image in shown]
    for number, image in enumerate(small):
        done = round(_WIDTH_PX * number / (len(small) - 1))
        ImageDraw.Draw(image).rectangle((0, size[1] - _BAR_PX, done, size[1]), fill="#d2691e")
    return small


def main(result: Path) -> None:
    """Write the animation of a result's film.

    Args:
        result: a folder made by ``hfb demo`` or ``hfb fit``.
    """
    images = draw_moving_picture(result / "slowmotion.mp4")
    times = [_STEP_MS] * (len(images) - 1) + [_HOLD_MS]
    settings = {"loop": 0, "quality": _QUALITY, "method": 6, "minimize_size": True}
    images[0].save(_OUT, save_all=True, append_images=images[1:], duration=times, **settings)
    size = _OUT.stat().st_size
    if size > LARGEST_BYTES:
        raise SystemExit(f"{_OUT} has {size} bytes; at most {LARGEST_BYTES} are allowed: lower its quality or width.")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
