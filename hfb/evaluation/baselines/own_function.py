"""A function in a file of the user's own as a method: `--methods NAME=FILE.py:FUNCTION`.

It is called with an observation and the starts, one `hfb.FirstBody` per frame, and returns R rows, as many for each
frame, evenly over the exposure: (poses (R, 24, 3), trans (R, 3), betas (10,)), or joints (R, 24, 3) alone.
"""

import runpy
import time
from collections.abc import Sequence

import numpy as np
import torch

from hfb.body.model import Body
from hfb.datasets.case import Case
from hfb.errors import InputError
from hfb.evaluation.baselines.rows import motion_of_rows
from hfb.evaluation.prediction import Prediction
from hfb.motion.static_pose import FirstBody
from hfb.rendering.observation import Observation

_WANTED = "return (poses (R, 24, 3), trans (R, 3), betas (10,)) or joints (R, 24, 3), R a multiple of the frames"


class OwnFunction:
    """A method whose file is run when it is made.

    Args:
        name: name of the method.
        text: FILE.py:FUNCTION.
        body: model of starts and poses.

    Raises:
        InputError: the file ends in an error.
    """

    def __init__(self, name: str, text: str, body: Body) -> None:
        self.name = name
        self._body = body
        file, _, function = text.rpartition(":")
        try:
            self._function = runpy.run_path(file)[function]
        except Exception as error:
            raise InputError(f"{file}: {type(error).__name__}: {error}") from error

    def __call__(self, case: Case, observation: Observation, starts: Sequence[FirstBody]) -> Prediction:
        """Predict poses or joints; an error of the function is the case's, and the case is not used."""
        began, frames = time.perf_counter(), len(observation.mattes)
        try:
            found = self._function(observation, list(starts))
            parts = [np.asarray(one, np.float64) for one in (found if isinstance(found, tuple) else (found,))]
        except Exception as error:
            raise InputError(f"{self.name}: {type(error).__name__}: {error}") from error
        seconds, rows = time.perf_counter() - began, parts[0].shape[0] if parts and parts[0].ndim else 0
        shapes = [one.shape for one in parts]
        if not rows or rows % frames or shapes not in ([(rows, 24, 3)], [(rows, 24, 3), (rows, 3), (10,)]):
            raise InputError(f"{self.name} returned the shapes {shapes} for {frames} frames: {_WANTED}")
        if len(parts) == 1:
            return Prediction(None, None, None, seconds, joints=parts[0])
        if not all(np.isfinite(one).all() for one in parts):
            raise InputError(
                f"{self.name} returned numbers that are not finite: where some are unknown, give joints alone"
            )
        poses, trans, betas = (torch.from_numpy(one) for one in parts)
        return Prediction(motion_of_rows(poses, trans, betas, observation, self._body), None, None, seconds)
