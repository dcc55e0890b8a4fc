"""Alternatives: what they leave unknown, in numbers and in words, and their file."""

from pathlib import Path

import numpy as np
import pytest

from hfb.errors import InputError
from hfb.fitting.alternatives import (
    LIMB_JOINTS,
    LIMB_NAMES,
    Alternatives,
    direction_record,
    load_alternatives,
    save_alternatives,
    what_is_unknown,
)

ARM = LIMB_NAMES.index("left arm")


def swinging(probability: tuple[float, ...], arm_m: float = 0.3, frames: int = 1) -> Alternatives:
    """Everything drifts to the side and the left arm swings up; as found, the arm turned, all turned, both turned."""
    u = np.linspace(-0.5, 0.5, 5)
    joints = np.random.default_rng(0).normal(0, 0.3, (24, 3)) * np.ones((4, 5, 1, 1))
    side, up = np.array([0.4, 0, 0]), np.array([0, arm_m, 0])
    arm = np.isin(np.arange(24), LIMB_JOINTS[ARM])[:, None]
    away = ~np.isin(np.arange(24), (0,))[:, None]  # about the pelvis, which stays
    for index, (body, limb) in enumerate([(1, 1), (1, -1), (-1, -1), (-1, 1)]):
        joints[index] += u[:, None, None] * (away * ~arm * body * side + arm * limb * up)
    joints = np.concatenate([joints] * frames, 1)
    rows = joints.shape[1]
    limbs = np.zeros((4, frames, 5), bool)
    limbs[1, :, ARM], limbs[2], limbs[3] = True, True, ~limbs[1]
    return Alternatives(
        limbs,
        np.zeros((4, rows, 72)),
        np.zeros((4, rows, 3)),
        joints,
        {"loss": np.arange(4.0)},
        np.array(probability),
        0,
        np.repeat(np.arange(frames), 5),
    )


def test_probabilities_of_parts_are_sums_over_what_agrees() -> None:
    found = swinging((0.4, 0.3, 0.2, 0.1))
    assert found.limb_right()[0, ARM] == pytest.approx(0.4 + 0.1)
    assert found.limb_right()[0, LIMB_NAMES.index("right leg")] == pytest.approx(0.4 + 0.3)
    assert found.body_right()[0] == pytest.approx(0.7)
    assert found.limb_right_given_body()[0, ARM] == pytest.approx(0.4 / 0.7)
    joints = found.joint_right()[0]
    assert joints[LIMB_JOINTS[ARM][0]] == pytest.approx(0.5)
    assert np.isnan(joints[0])  # the pelvis stays where it is


def test_the_spread_is_where_alternatives_differ() -> None:
    spread = swinging((0.7, 0.3, 0.0, 0.0)).spread_m()
    wrist = LIMB_JOINTS[ARM][-1]
    assert spread[0, wrist] == pytest.approx(np.sqrt(0.3) * 0.3)
    assert spread[2].max() == pytest.approx(0, abs=1e-12)  # all agree in the middle
    assert spread[:, 1].max() == pytest.approx(0, abs=1e-12)  # a hip


def test_words_name_what_is_unsure_and_nothing_else() -> None:
    words = what_is_unknown(direction_record(swinging((0.4, 0.3, 0.2, 0.1))))
    assert "70 %" in words
    assert "the left arm 57 %" in words
    assert "leg" not in words
    sure = what_is_unknown(direction_record(swinging((0.97, 0.01, 0.01, 0.01))))
    assert "98 %" in sure
    assert "arm" not in sure
    assert "frame 2" in what_is_unknown(direction_record(swinging((0.4, 0.3, 0.2, 0.1), frames=2)))


def test_nothing_that_moved_is_said_so() -> None:
    still = swinging((1.0, 0.0, 0.0, 0.0))
    still = Alternatives(**vars(still) | {"joints": still.joints.mean(1, keepdims=True) * np.ones((4, 5, 1, 1))})
    record = direction_record(still)
    assert set(record[0]["right"].values()) == {None}
    assert what_is_unknown(record) == "Nothing moved far enough to have a direction."


def test_the_file_reads_back_without_pickle(tmp_path: Path) -> None:
    path, found = tmp_path / "alternatives.npz", swinging((0.4, 0.3, 0.2, 0.1), frames=2)
    features = {"reach": np.arange(240.0).reshape(10, 24), "edge": np.ones((10, 24))}
    save_alternatives(path, found, features)
    with np.load(path, allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)
        assert file["limb_right"].shape == (2, 5)
        assert file["joint_right"].shape == (2, 24)
        assert file["limbs"].tolist() == list(LIMB_NAMES)
    read, known = load_alternatives(path)
    np.testing.assert_allclose(read.joints, found.joints, atol=1e-6)
    np.testing.assert_array_equal(read.reversed_limbs, found.reversed_limbs)
    np.testing.assert_array_equal(read.probability, found.probability)
    np.testing.assert_array_equal(read.scores["loss"], found.scores["loss"])
    assert read.chosen == 0
    assert list(known) == ["reach", "edge"]
    np.testing.assert_allclose(known["reach"], features["reach"])


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04broken"])
def test_damaged_files_are_said_so(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "alternatives.npz"
    with pytest.raises(InputError, match="no file of alternatives"):
        load_alternatives(path)
    path.write_bytes(content)
    with pytest.raises(InputError, match="holds no alternatives"):
        load_alternatives(path)
