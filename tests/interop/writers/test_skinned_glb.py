"""motion.glb by a strict reader of glTF 2.0 that shares no code with the writer, and by trimesh."""

import io
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from hfb.body.assets import load_default_body
from hfb.body.skeleton import JOINT_NAMES
from hfb.errors import InputError
from hfb.geometry.rotations import axis_angle_to_matrix
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.skinned_glb import skinned_glb, slow_factor, slow_frames
from tests.interop.writers.motions import motion_of

BODY = load_default_body()
MOTION = motion_of(BODY, frames=2)
_TYPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_KINDS = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c49444154789c63f8cfc000000301010018dd8db0"
    "0000000049454e44ae426082"
)


class Glb:
    """A file, taken apart as the specification says."""

    def __init__(self, data: bytes) -> None:
        magic, version, length = struct.unpack_from("<4sII", data)
        assert (magic, version, length) == (b"glTF", 2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        assert size % 4 == 0
        self.document = json.loads(data[20 : 20 + size])
        binary, kind = struct.unpack_from("<I4s", data, 20 + size)
        assert kind == b"BIN\0"
        assert 28 + size + binary == len(data)
        self.binary = data[28 + size :]
        (buffer,) = self.document["buffers"]
        assert 0 <= len(self.binary) - buffer["byteLength"] < 4

    def array(self, index: int) -> np.ndarray:
        accessor = self.document["accessors"][index]
        view = self.document["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        kind, width = np.dtype(_KINDS[accessor["componentType"]]), _TYPES[accessor["type"]]
        assert view["byteLength"] == accessor["count"] * width * kind.itemsize
        values = np.frombuffer(self.binary, kind, accessor["count"] * width, view["byteOffset"])
        values = values.reshape(accessor["count"], width) if width > 1 else values
        if "min" in accessor:
            flat = values.reshape(len(values), -1)
            np.testing.assert_array_equal(flat.min(0), np.float32(accessor["min"]))
            np.testing.assert_array_equal(flat.max(0), np.float32(accessor["max"]))
        return values

    def worlds(self, local: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
        """World matrices of all nodes, from their local ones."""
        worlds: dict[int, np.ndarray] = {}

        def descend(node: int, above: np.ndarray) -> None:
            worlds[node] = above @ local[node]
            for child in self.document["nodes"][node].get("children", ()):
                descend(child, worlds[node])

        for root in self.document["scenes"][self.document["scene"]]["nodes"]:
            descend(root, np.eye(4))
        return worlds

    def posed(self, animation: dict, key: int) -> dict[int, np.ndarray]:
        """World matrices of all nodes at one key of an animation."""
        parts = {number: dict(node) for number, node in enumerate(self.document["nodes"])}
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            assert sampler["interpolation"] == "LINEAR"
            parts[channel["target"]["node"]][channel["target"]["path"]] = self.array(sampler["output"])[key]
        local = {}
        for number, node in parts.items():
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_quat(np.array(node.get("rotation", [0, 0, 0, 1]), float)).as_matrix()
            matrix[:3, 3] = node.get("translation", [0, 0, 0])
            local[number] = matrix
        return self.worlds(local)


@pytest.fixture(scope="module")
def glb() -> Glb:
    return Glb(skinned_glb(Exported(MOTION, "hfb", BODY, _PNG)))


def in_gltf(points: np.ndarray) -> np.ndarray:
    """From the camera's frame to glTF's, in which the camera looks along -z and y is up."""
    return points * [1.0, -1.0, -1.0]


def test_joints_at_every_key_of_both_animations(glb: Glb) -> None:
    slow_motion, true_time = glb.document["animations"]
    assert (slow_motion["name"], true_time["name"]) == ("slow motion 14.6x", "true time")
    assert glb.document["asset"]["extras"]["slow_factor"] == pytest.approx(slow_factor(MOTION, 24))
    assert slow_factor(MOTION, 24) == pytest.approx(350 / 24)
    # 1/30 s are 11.67 steps of 1/350 s: the second exposure begins 12 whole frames after the first
    shown_s = np.array([*range(1, 9), *range(13, 21)]) / 24
    joints = glb.document["skins"][0]["joints"]
    assert [glb.document["nodes"][joint]["name"] for joint in joints] == list(JOINT_NAMES)
    for animation, at_s in ((true_time, MOTION.times_s), (slow_motion, shown_s)):
        for sampler in animation["samplers"]:
            times_s = glb.array(sampler["input"])
            assert (np.diff(times_s) > 0).all()
            np.testing.assert_allclose(times_s, at_s, atol=1e-6)
        for key in range(len(MOTION.times_s)):
            worlds = glb.posed(animation, key)
            places = np.array([worlds[joint][:3, 3] for joint in joints])
            assert 1000 * np.linalg.norm(places - in_gltf(MOTION.joints[key]), axis=-1).max() < 0.01


def test_the_skin_is_the_bodys_surface(glb: Glb) -> None:
    (mesh,) = glb.document["meshes"][0]["primitives"]
    read = {name: glb.array(index) for name, index in mesh["attributes"].items()}
    weights = np.concatenate([read[name] for name in sorted(read) if name.startswith("WEIGHTS")], 1)
    joints = np.concatenate([read[name] for name in sorted(read) if name.startswith("JOINTS")], 1)
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-6)
    assert (joints[weights == 0] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(read["NORMAL"], axis=1), 1, atol=1e-5)

    bind = glb.array(glb.document["skins"][0]["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    worlds = glb.posed(glb.document["animations"][0], 5)
    moves = np.stack([worlds[node] for node in glb.document["skins"][0]["joints"]]) @ bind
    points = np.concatenate([read["POSITION"], np.ones((len(weights), 1))], 1)
    skinned = np.einsum("vk,vkij,vj->vi", weights, moves[joints], points)[:, :3]

    rotations = axis_angle_to_matrix(torch.from_numpy(MOTION.poses[5:6]).unflatten(1, (24, 3))).float()
    shaped = BODY.shape(torch.from_numpy(MOTION.betas).float())
    surface = shaped.pose(rotations, torch.from_numpy(MOTION.trans[5:6]).float()).vertices[0].numpy()
    corners = skinned[glb.array(mesh["indices"]).reshape(-1, 3)]
    expected = in_gltf(surface[BODY.mesh.faces.numpy()])
    assert 1000 * np.linalg.norm(corners - expected, axis=-1).max() < 0.1
    uv = read["TEXCOORD_0"][glb.array(mesh["indices"])]
    np.testing.assert_allclose(uv, BODY.mesh.uv[BODY.mesh.uv_faces].reshape(-1, 2).numpy(), atol=1e-6)


def test_what_the_file_says_about_itself(glb: Glb) -> None:
    facts = glb.document["asset"]["extras"]
    assert facts["betas_space"] == "hfb"
    np.testing.assert_allclose(facts["betas"], MOTION.betas, atol=1e-6)
    extras = glb.document["nodes"][glb.document["skins"][0]["joints"][20]]["extras"]["joint_radius_mm"]
    assert MOTION.joint_radius_mm is not None
    assert extras["mean"] == pytest.approx(MOTION.joint_radius_mm[:, 20].mean(), abs=0.01)
    image = glb.document["images"][0]
    view = glb.document["bufferViews"][image["bufferView"]]
    assert glb.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]] == _PNG
    plain = Glb(skinned_glb(Exported(MOTION, "hfb", BODY))).document
    assert "images" not in plain
    assert "baseColorTexture" not in plain["materials"][0]["pbrMetallicRoughness"]


def test_the_camera_looks_where_ours_does() -> None:
    """From K alone, where the motion does not say the size of its images; the optical axis is off the middle."""
    K = np.array([[700.0, 0, 350], [0, 720, 220], [0, 0, 1]])
    document = Glb(
        skinned_glb(Exported(replace(MOTION, K=K, size=(640, 480)), "hfb", BODY, plate="plate.png"))
    ).document
    (camera,) = document["cameras"]
    view, extras = camera["perspective"], camera["extras"]
    node = next(one for one in document["nodes"] if one.get("camera") == 0)
    turned = Rotation.from_quat(node["rotation"]).inv().apply(MOTION.joints[3])  # glTF's camera looks along -z
    height = 2 * np.tan(view["yfov"] / 2)
    seen = turned[:, :2] / -turned[:, 2:] / [height * view["aspectRatio"], height]
    seen -= np.array(extras["lens_shift"]) / [view["aspectRatio"], 1]
    projected = MOTION.joints[3] @ K.T
    np.testing.assert_allclose((0.5 + seen * [1, -1]) * [640, 480], projected[:, :2] / projected[:, 2:], atol=1e-6)
    assert extras["background"] == "plate.png"
    (guessed,) = Glb(skinned_glb(Exported(MOTION, "hfb", BODY))).document["cameras"]
    assert guessed["extras"]["size_px"] == [640, 480]
    assert guessed["extras"]["lens_shift"] == [0, 0]
    with pytest.raises(InputError, match="no focal length"):
        skinned_glb(Exported(replace(MOTION, K=np.diag([0.0, 0, 1])), "hfb", BODY))


def test_halves_of_frames_and_close_keys() -> None:
    """A key has a frame of its own, and the same one whatever rounding its time has."""
    for noise in (-1e-9, 1e-9):
        at_s = np.array([0, 1.5 + noise, 2.5 - noise, 3.5 + noise, 3.50005, 9]) / 100
        np.testing.assert_array_equal(slow_frames(at_s, 100), [1, 2, 3, 4, 5, 10])


def test_another_reader_takes_it() -> None:
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.load(io.BytesIO(skinned_glb(Exported(MOTION, "hfb", BODY, _PNG))), file_type="glb")
    (mesh,) = scene.geometry.values()
    assert len(mesh.faces) == len(BODY.mesh.faces)
    rest = BODY.shape(torch.from_numpy(MOTION.betas).float()).vertices.numpy()
    np.testing.assert_allclose(mesh.bounds, np.stack([rest.min(0), rest.max(0)]), atol=1e-5)
    assert set(JOINT_NAMES) <= set(scene.graph.nodes)
    assert scene.graph.get("pelvis")[0][:3, 3] == pytest.approx(in_gltf(MOTION.joints[0, 0]), abs=1e-5)
