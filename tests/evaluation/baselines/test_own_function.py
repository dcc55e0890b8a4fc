"""A function of the user's own as a method: it sees what every method sees, and its errors are its own."""

from pathlib import Path

import numpy as np
import pytest

from hfb.body.assets import load_default_body
from hfb.errors import InputError
from hfb.evaluation.baselines.build import make_method
from hfb.evaluation.baselines.method_spec import method_spec, program_of
from tests.evaluation.baselines.cases import bare_case
from tests.scenes import moving_scene

FILE = """
import numpy as np
import torch
print("the file is run")

def still(observation, starts):
    poses = np.stack([start.pose.numpy() for start in starts for _ in range(4)])
    places = np.stack([start.translation.numpy() for start in starts for _ in range(4)])
    return poses, places, starts[0].betas

def points(observation, starts):
    joints = np.full((len(observation.mattes) * 3, 24, 3), np.nan)
    joints[:, 0] = 0
    return torch.from_numpy(joints)

def short(observation, starts):
    return np.zeros((5, 3))

def hole(observation, starts):
    return np.full((4, 24, 3), np.nan), np.zeros((4, 3)), np.zeros(10)

def broken(observation, starts):
    return starts[9]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    return path


def test_poses_are_the_motion_of_the_static_method(file: Path, tmp_path: Path) -> None:
    body = load_default_body()
    scene = moving_scene(body)
    mine, static = (
        make_method(method_spec(text), body)(bare_case(tmp_path), scene.observation, scene.middle).motion
        for text in (f"mine={file}:still", "static")
    )
    assert mine is not None
    assert static is not None
    assert len(mine.poses) == 4
    np.testing.assert_array_equal(mine.poses, static.poses[:4])
    np.testing.assert_allclose(mine.joints, static.joints[:4], atol=1e-6)


def test_joints_alone(file: Path, tmp_path: Path) -> None:
    scene = moving_scene(load_default_body())
    found = make_method(method_spec(f"mine={file}:points"), load_default_body())(
        bare_case(tmp_path), scene.observation, scene.middle
    )
    assert found.motion is None
    assert found.joints is not None
    assert found.joints.shape == (3, 24, 3)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("short", r"mine returned the shapes \[\(5, 3\)\] for 1 frames: return \(poses"),
        ("hole", "mine returned numbers that are not finite: where some are unknown, give joints alone"),
        ("broken", "mine: IndexError: list index out of range"),
    ],
)
def test_what_a_function_does_wrong_is_the_cases_error(file: Path, tmp_path: Path, name: str, says: str) -> None:
    scene = moving_scene(load_default_body())
    method = make_method(method_spec(f"mine={file}:{name}"), load_default_body())
    with pytest.raises(InputError, match=says):
        method(bare_case(tmp_path), scene.observation, scene.middle)


def test_a_wrong_entry_is_told_before_the_file_is_run(file: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match=r"mine\.py has no function 'absent' at its top level; it has still, points,"):
        method_spec(f"mine={file}:absent")
    with pytest.raises(InputError, match=r"none\.py cannot be read \(No such file or directory\): a method is"):
        method_spec("mine=none.py:f")
    assert "the file is run" not in capfd.readouterr().out
    file.write_text("def f(:\n")
    with pytest.raises(InputError, match=r"mine\.py is no Python"):
        method_spec(f"mine={file}:f")
    file.write_text("def f(a, b):\n    return a\n1 / 0\n")
    with pytest.raises(InputError, match=r"mine\.py: ZeroDivisionError: division by zero"):
        make_method(method_spec(f"mine={file}:f"), load_default_body())


def test_the_file_that_is_checked_is_the_one_that_is_run(file: Path) -> None:
    """A blank before the path is part of it: a deployment compares the same path with its list."""
    assert program_of(f" mine={file}:still ") == file
    assert program_of(f"mine= {file}:still") == Path(f" {file}")
    with pytest.raises(InputError, match="cannot be read"):
        method_spec(f"mine= {file}:still")


def test_another_content_is_another_method(file: Path) -> None:
    before = method_spec(f"mine={file}:still")
    file.write_text(FILE + "\n")
    after = method_spec(f"mine={file}:still")
    assert before.digests != after.digests
    assert before.model_copy(update={"digests": ()}) == after.model_copy(update={"digests": ()})


@pytest.mark.parametrize("name", ["../mine", "..", "a/b", "", " "])
def test_a_name_stays_in_the_folder_of_methods(file: Path, name: str) -> None:
    with pytest.raises(InputError, match="is to be a folder's name"):
        method_spec(f"{name}={file}:still")
