"""The clock of averaged frames."""

import numpy as np
import pytest

from hfb.datasets.real.shutter import Shutter
from hfb.motion.clock import next_opening


@pytest.mark.parametrize(("average", "frames", "fps"), [(2, 1, 30.0), (5, 1, 50.0), (9, 3, 60.0), (15, 2, 29.97)])
def test_every_sharp_frame_is_exposed_at_its_own_time(average: int, frames: int, fps: float) -> None:
    shutter = Shutter(average, frames, fps)
    times_s, index = shutter.instants()
    np.testing.assert_allclose(times_s, np.arange(average * frames) / fps, atol=1e-12)
    assert index.tolist() == [window for window in range(frames) for _ in range(average)]
    u = (times_s - index * shutter.interval_s) / shutter.exposure_s
    np.testing.assert_allclose(u.reshape(frames, average), np.tile(np.linspace(0, 1, average), (frames, 1)), atol=1e-9)
    # The next window opens one interval of the video after this one's last frame.
    gap = (next_opening(shutter.exposure_s, shutter.interval_s) - 1) * shutter.exposure_s
    assert gap == pytest.approx(1 / fps)
