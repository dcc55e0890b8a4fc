"""A researcher fits an image, tries a pose prior of her own, and compares both runs in MLflow."""

import subprocess
import sys
from pathlib import Path

import cv2
import torch

import hfb
from hfb.datasets.example import write_example


def nearly_straight(axis_angle: torch.Tensor) -> torch.Tensor:
    """Return how far the joints of every pose are bent: a prior that knows nothing else.

    Args:
        axis_angle: joints below the root [rad], (S, 23, 3).
    """
    return 40 * axis_angle.square().sum((1, 2))


def main(out: Path) -> None:
    """Fit the embedded example with both priors, record the runs, and put their strips into one picture.

    Args:
        out: where results go.
    """
    example = write_example(out / "input")
    strips = []
    for name, prior in (("anatomy", None), ("straight", nearly_straight)):
        result = hfb.fit(example.frame, example.background, prior=prior)
        errors = hfb.evaluate(result, example.truth)
        print(f"{name}: MPJPE {errors['mpjpe_mm']:.0f} mm, PA-MPJPE {errors['pa_mpjpe_mm']:.0f} mm")
        result.save(out / name)
        subprocess.run(["hfb", "record", str(out / name)], check=True)
        strips.append(cv2.imread(str(out / name / "strip.png")))
    width = min(strip.shape[1] for strip in strips)
    cv2.imwrite(str(out / "compared.png"), cv2.vconcat([strip[:, :width] for strip in strips]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
