"""Draw the stored pictures anew, after a change that is meant to change them: ``python -m tests.golden.regenerate``.

Look at every picture before committing it.
"""

from pathlib import Path

from PIL import Image

from tests.golden.views import VIEWS, draw_view

HERE = Path(__file__).parent


def main() -> None:
    for name in VIEWS:
        Image.fromarray(draw_view(name)).save(HERE / f"{name}.png", optimize=True)
        print(HERE / f"{name}.png")


if __name__ == "__main__":
    main()
