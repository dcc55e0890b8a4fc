"""A floor in the world of exports: stated as a plane, or told by standing feet; and what contradicts it."""

from dataclasses import replace

import numpy as np
import pytest

from hfb.config import Floor, WorldUp
from hfb.geometry.placement import in_world, with_floor, world_of_pose, world_of_up, y_up, z_up
from hfb.geometry.world import World
from hfb.motion.footing import FEET, floor_fault, foot_contacts, sole_heights_m, stand, standing_feet
from hfb.motion.gravity import find_world
from hfb.motion.sampled import SampledMotion
from tests.motion.test_gravity import _TRUE, around, walk

_SOLE_M = 0.01
_CAMERA_M = 1.5  # above the floor of `walk`, which is at the height of the feet's joints


def walker(world: World | None = None) -> SampledMotion:
    """A walk whose ankles are well above its feet."""
    motion = walk(around(), noise_m=0.0)
    joints = motion.joints.copy()
    joints[:, [7, 8]] = joints[:, FEET] + 0.2 * _TRUE.R[2]
    return replace(motion, joints=joints, world=world)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_plane_in_the_camera_is_the_level_floor(sign: float) -> None:
    """Nothing else tells the world: up is the plane's normal, whichever way it points, and all files have it at 0."""
    up = _TRUE.R[2]
    motion = walker(with_floor(None, tuple(sign * np.array([*up, -_CAMERA_M]))))
    world = motion.export_world
    np.testing.assert_allclose(z_up(world).R[2], up, atol=1e-12)
    standing = standing_feet(motion, up)
    for height in (z_up(world).points(motion.joints)[..., 2], y_up(world).points(motion.joints)[..., 1]):
        np.testing.assert_allclose(height[:, FEET][standing], 0, atol=1e-9)
    np.testing.assert_allclose(sole_heights_m(motion)[standing], -_SOLE_M, atol=1e-9)
    assert floor_fault(motion) is None
    contacts, high = foot_contacts(motion), z_up(world).points(motion.joints[:, FEET])[..., 2] > 0.12
    assert contacts[standing].all()
    assert not contacts[high].any()
    assert find_world(motion, world) is world


@pytest.mark.parametrize("up", ["z", "-z", "y", "-y"])
def test_a_plane_in_the_calibrations_world(up: WorldUp) -> None:
    """Three points of the plane come to height 0 in every world, by the smallest turn."""
    pose = world_of_pose(_TRUE.R.T, np.array([0.3, 1.0, 4.0]), up)
    plane = np.array([0.05, -0.08, 0.05, 0.0])
    plane["xyz".index(up[-1])], plane[3] = 1.0, 0.4
    on_floor = with_floor(pose, tuple(plane / np.linalg.norm(plane[:3])))
    assert on_floor is not None
    before, normal = in_world(pose), plane[:3]
    points = np.random.default_rng(0).normal(0, 1, (3, 3))
    points -= ((points @ normal - plane[3]) / (normal @ normal))[:, None] * normal
    seen = (points - before.t) @ before.R
    np.testing.assert_allclose(z_up(on_floor).points(seen)[:, 2], 0, atol=1e-12)
    turned = np.degrees(np.arccos((np.trace(z_up(on_floor).R @ z_up(pose).R.T) - 1) / 2))
    assert turned == pytest.approx(np.degrees(np.arccos(1 / np.linalg.norm(normal))), abs=1e-6)


def test_feet_tell_the_floor() -> None:
    """Its height where up is stated; both where a walk tells up; a foot that is held up is none that stands."""
    up = _TRUE.R[2]
    stated = stand(walker(with_floor(world_of_up(up), "estimate")))
    walked = walker()
    walked = stand(replace(walked, world=find_world(walked, with_floor(None, "estimate"))))
    for motion, source in ((stated, "options"), (walked, "person")):
        world = motion.export_world
        assert (world.source, world.floor_source) == (source, "feet")
        standing = standing_feet(motion, z_up(world).R[2])
        assert abs(np.median(sole_heights_m(motion)[standing])) < 1e-9
        assert floor_fault(motion) is None
    assert stand(walked) is walked
    assert stand(walker()).world is None


@pytest.mark.parametrize(
    ("floor", "said"),
    [
        ((0, 0, 1, 0.4), "the soles are 41 cm below the floor that is given"),
        ((0, 0, 1, -0.4), "the soles are 39 cm above the floor that is given"),
        ((0.2, 0, 0.98, 0), "the floor that is given is 12 degrees aslant to the world's z axis, which is up"),
    ],
)
def test_a_floor_that_contradicts_the_person(floor: Floor, said: str) -> None:
    pose = world_of_pose(_TRUE.R.T, -_TRUE.R.T @ [0, 0, _CAMERA_M], "z")
    fault = floor_fault(walker(with_floor(pose, floor)))
    assert fault is not None
    assert fault.startswith(said)
    assert "--camera.floor" in fault
    assert floor_fault(walker(with_floor(pose, (0, 0, 1, 0)))) is None


def test_nobody_stands() -> None:
    motion = walker(with_floor(world_of_up(_TRUE.R[2]), "estimate"))
    flown = stand(replace(motion, joints=motion.joints + motion.times_s[:, None, None] * 3 * _TRUE.R[0]))
    assert not foot_contacts(flown).any()
    assert floor_fault(flown) == (
        "no foot stands still, so the floor is taken at the lowest soles: give its plane with --camera.floor"
    )
