"""Blurred people without colours: coverage and, per garment, the garment's contribution to every pixel.

A blurred image is linear in the texture. So a figure is rendered once per garment, with the garment's shade as its
texture, and gets its colours only when a training image is composed: c_1 M_1 + c_2 M_2 + ...
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from scipy import ndimage
from scipy.spatial.transform import Rotation

from hfb.body.height import height_m
from hfb.body.model import Body
from hfb.body.skeleton import JOINT_NAMES
from hfb.datasets.network_errors import draw_turns, pose_errors
from hfb.datasets.synthetic.clothed import draw_clothing, dress
from hfb.datasets.synthetic.textures import clothes_texture
from hfb.geometry.camera import PinholeCamera
from hfb.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from hfb.rendering.backends import make_rasterizer
from hfb.rendering.texels import texel_faces
from hfb.training.matting.bone_directions import Recording, poses_at

SIZE_PX = 224
TEXTURE_PX = 256
GARMENTS = ("skin", "hair", "shoes", "shirt", "shirt pattern", "trousers", "trousers pattern", "thing", "thing pattern")
PHOTO = slice(1 + len(GARMENTS), 4 + len(GARMENTS))
CHANNELS = 4 + len(GARMENTS)  # coverage, garments, a whole photo as texture (square root of premultiplied light)

_PATTERNS = {"plain": 0.22, "stripes": 0.25, "soft": 0.08, "checks": 0.12, "spots": 0.1, "clouds": 0.15, "grain": 0.08}
_THINGS = ("skirt", "hair", "bag", "ball", "stick", "legs", "cape")
_THINGS_SHARE, _THINGS_BESIDE_DOUBLES = 0.5, 0.3  # of figures
_FILLS = 0.78  # of the picture's side: the box around the whole blur
_SHARP = 0.22  # of all figures stand still
_LARGEST_SMEAR_PX = 100
_MOST_INSTANTS = 48
_ERRORS, _MOTION, _BLUR_PX = (0.005, 0.15), (0.8, 1.05), (0.6, 6.0)
"""Of doubles: ranges of a network's errors, of the share of the motion that is kept, of the texture's blur."""
_ALIKE = 0.6  # of doubles have the person's clothes: a fit swells to them
_KEPT, _SHAPE, _ASIDE, _DOUBLES_INSTANTS = 0.95, 0.15, 0.0007, 8
"""Of doubles: share of the true betas that is kept, scale of their errors; sideways steps relative to the distance."""


@dataclass(frozen=True)
class Figure:
    """One person in 8 bits, and the speed of their motion."""

    channels: np.ndarray  # (CHANNELS, SIZE_PX, SIZE_PX) uint8
    smear_px: float  # longest path of a joint during the exposure
    exposure_s: float
    source: str


class Painter:
    """The body and its texture layout, shared by all figures."""

    def __init__(self, body: Body) -> None:
        """Assign every texel to a face, texels between charts to the nearest.

        Args:
            body: the body model.
        """
        self.body = body
        owner = texel_faces(body.mesh, TEXTURE_PX).numpy()
        nearest = ndimage.distance_transform_edt(owner < 0, return_distances=False, return_indices=True)
        self.owner = owner[tuple(nearest)]
        self.faces = body.mesh.faces.numpy().astype(np.int64)
        self.joint_of_face = body.skinning_weights.numpy()[self.faces].sum(1).argmax(1)
        self.centre_of_face = body.template.numpy()[self.faces].mean(1)
        self.rest = body.joint_template.double().numpy()
        self.rasterizer = make_rasterizer("coverage", "cpu", threads=1)

    def texture(self, of_face: np.ndarray) -> torch.Tensor:
        """Return a texture (A, A, 3) from a value per face.

        Args:
            of_face: (F, 3).
        """
        return torch.from_numpy(np.ascontiguousarray(of_face[self.owner], dtype=np.float32))


def draw_figure(
    painter: Painter,
    recordings: list[Recording],
    photos: list[np.ndarray],
    rng: np.random.Generator,
    with_double: bool = False,
) -> Figure:
    """Render a person at a random moment of a random recording, from a random side.

    Args:
        painter: the body.
        recordings: at least one.
        photos: (h, w, 3) linear; empty: generated clothes replace them.
        rng: of the figure.
        with_double: appends the channels of a double that stands for a fit: a bare body of slightly different pose and
            shape, with less motion and a blurred texture.
    """
    sharp = rng.random() < _SHARP
    wanted = 0.0 if sharp else float(rng.uniform(1, _LARGEST_SMEAR_PX))
    shots = [_shoot(painter, recordings, sharp, rng) for _ in range(1 if sharp else 5)]
    shot = min(shots, key=lambda candidate: abs(candidate[4] - wanted))
    rotations, places, camera, recording, smear, exposure_s = shot
    count = int(np.clip(smear / 1.5, 2 if sharp else 8, _MOST_INSTANTS))
    chosen = np.linspace(0, len(rotations) - 1, count).round().astype(int)
    body = painter.body if rng.random() < 0.35 else dress(painter.body, draw_clothing(painter.body, rng))
    betas = torch.from_numpy(np.clip(rng.normal(0, 1, 10), -2, 2)).float()
    posed = body.shape(betas).pose(
        torch.from_numpy(rotations[chosen]).float(), torch.from_numpy(places[chosen]).float()
    )
    often = _THINGS_BESIDE_DOUBLES if with_double else _THINGS_SHARE
    things = _draw_things(camera.project(posed.joints).numpy(), rng) if rng.random() < often else []
    shade = _shade(painter, posed.vertices[count // 2].numpy(), rng)
    worn = _garments(painter, rng) * shade[:, None]
    whole = _photo_texture(painter, photos, rng) * torch.from_numpy(shade.astype(np.float32))[painter.owner][..., None]
    textures = [painter.texture(worn[:, k : k + 3]) for k in (0, 3, 6)] + [whole]
    channels = _render(painter, posed.vertices, textures, camera, things)
    channels[PHOTO] = np.sqrt(np.clip(channels[PHOTO], 0, 1))
    if with_double:
        double = _double(body if rng.random() < _ALIKE else painter.body, rotations, places, betas, rng)
        blur = float(rng.uniform(*_BLUR_PX))
        blurred = [torch.from_numpy(cv2.GaussianBlur(one.numpy(), (0, 0), blur)) for one in textures]
        beside = _render(painter, double, blurred, camera, [])
        beside[PHOTO] = np.sqrt(np.clip(beside[PHOTO], 0, 1))
        channels = np.concatenate([channels, beside])
    return Figure((np.clip(channels, 0, 1) * 255).round().astype(np.uint8), smear, exposure_s, recording.name)


def _double(
    body: Body, rotations: np.ndarray, places: np.ndarray, betas: torch.Tensor, rng: np.random.Generator
) -> torch.Tensor:
    """Return vertices (S, V, 3) of a double who covers about the same pixels: taller if further away."""
    instants, middle = len(rotations), len(rotations) // 2
    at = np.round(middle + rng.uniform(*_MOTION) * np.linspace(-1, 1, _DOUBLES_INSTANTS) * middle)
    at = at.astype(int).clip(0, instants - 1)
    true = torch.from_numpy(rotations).float()
    pose = matrix_to_axis_angle(true[middle][None])
    errors = pose_errors(pose, draw_turns(1, rng) * np.exp(rng.uniform(*np.log(_ERRORS))))
    erring = axis_angle_to_matrix(errors.poses_at(torch.tensor([0.5, 1.0]))[-1])
    turned = true[at] @ (true[middle].transpose(-1, -2) @ erring)
    others = _KEPT * betas + torch.from_numpy(rng.normal(0, _SHAPE, 10)).float()
    person, double = body.shape(betas), body.shape(others)
    joints = person.joints_of(true[at], torch.from_numpy(places[at]).float())
    larger = float(height_m(body, others) / height_m(body, betas))
    depth = joints[:, :1, 2:] * larger * float(np.exp(rng.normal(0, 0.005)))
    still = double.joints_of(turned, torch.zeros(len(at), 3))
    away = depth + still[..., 2:] - still[:, :1, 2:]
    seen = (joints[..., :2] / joints[..., 2:]).mean(1) + torch.from_numpy(rng.normal(0, _ASIDE, 2)).float()
    across = (seen - (still[..., :2] / away).mean(1)) / (1 / away).mean(1)
    return double.pose(turned, torch.cat([across, depth[:, 0] - still[:, 0, 2:]], -1)).vertices


def _shoot(
    painter: Painter, recordings: list[Recording], sharp: bool, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, PinholeCamera, Recording, float, float]:
    """Return rotations and positions in camera coordinates, the camera, and the longest path of a joint [px]."""
    recording = recordings[rng.integers(len(recordings))]
    exposure_s = min(0.002 if sharp else float(np.exp(rng.uniform(np.log(0.04), np.log(0.5)))), recording.seconds)
    start = rng.uniform(0, recording.seconds - exposure_s)
    rotations, places = poses_at(recording, np.linspace(start, start + exposure_s, _MOST_INSTANTS), painter.rest)
    turn = Rotation.from_euler("xyz", [rng.normal(0, 12), 0, rng.normal(0, 4)], degrees=True).as_matrix()
    turn = turn @ np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("y", rng.uniform(0, 360), degrees=True).as_matrix()
    rotations[:, 0] = turn @ rotations[:, 0]
    places = (places - places.mean(0)) @ turn.T + np.array([0, 0, rng.uniform(2.2, 6)])
    bones = painter.body.shape(torch.zeros(10)).pose(
        torch.from_numpy(rotations[::6]).float(), torch.from_numpy(places[::6] - painter.rest[0]).float()
    )
    seen = (bones.joints[..., :2] / bones.joints[..., 2:]).numpy()
    low, high = seen.min((0, 1)) - 0.18 / places[:, 2].mean(), seen.max((0, 1)) + 0.18 / places[:, 2].mean()
    focal = _FILLS * SIZE_PX / float((high - low).max())
    middle = SIZE_PX / 2 - focal * (low + high) / 2
    camera = PinholeCamera(focal, focal, float(middle[0]), float(middle[1]), SIZE_PX, SIZE_PX)
    smear = float(np.linalg.norm(np.diff(seen, axis=0), axis=-1).sum(0).max() * focal)
    return rotations, places - painter.rest[0], camera, recording, smear, exposure_s


def _garments(painter: Painter, rng: np.random.Generator) -> np.ndarray:
    """Return (F, 9): the garment of each face; rows sum to 1, things in the hands have no faces."""
    names, centre = np.array(JOINT_NAMES)[painter.joint_of_face], painter.centre_of_face
    worn = np.zeros((len(names), len(GARMENTS)))
    head = names == "head"
    bald = np.quantile(centre[head, 1], rng.uniform(0.3, 0.8))
    hair = head & (centre[:, 1] > bald) & (centre[:, 2] < centre[head, 2].max() - rng.uniform(0.03, 0.09))
    sleeves, legs = rng.random(), rng.random()
    shirt = ["pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar"]
    shirt += ["left_shoulder", "right_shoulder"] * (sleeves < 0.85) + ["left_elbow", "right_elbow"] * (sleeves < 0.5)
    trousers = ["left_hip", "right_hip"] + ["left_knee", "right_knee"] * (legs < 0.75)
    trousers += ["pelvis"] * (rng.random() < 0.5)
    shoes = [f"{side}_{part}" for side in ("left", "right") for part in ("ankle", "foot")]
    for column, parts in ((3, shirt), (5, trousers), (2, shoes)):
        share = _pattern(centre, rng) if column != 2 else np.zeros(len(names))
        here = np.isin(names, parts)
        worn[here] = 0
        worn[here, column], worn[here, column + 1] = 1 - share[here], share[here]
    worn[hair, 1] = 1
    worn[:, 0] = 1 - worn[:, 1:].sum(1)
    return worn


def _pattern(centre_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the share of the second colour: none, stripes, checks, spots, clouds or grain, in rest coordinates."""
    kind = rng.choice(list(_PATTERNS), p=list(_PATTERNS.values()))
    direction = rng.normal(size=3) if rng.random() < 0.3 else np.eye(3)[rng.integers(2)]
    phase = 2 * np.pi / np.exp(rng.uniform(np.log(0.03), np.log(0.25))) * centre_m
    along = np.sin(phase @ (direction / np.linalg.norm(direction)) + rng.uniform(0, 6))
    if kind == "stripes":
        return (along > rng.uniform(-0.5, 0.9)).astype(float)
    if kind == "soft":
        return (1 + along) / 2
    if kind == "checks":
        return (np.sin(phase[:, 0]) * np.sin(phase[:, 1]) > 0).astype(float)
    if kind == "spots":
        return (np.sin(phase).prod(1) > rng.uniform(0.1, 0.5)).astype(float)
    if kind == "clouds":
        waves = rng.normal(size=(8, 3)) / np.exp(rng.uniform(np.log(0.02), np.log(0.15)))
        return np.clip(0.5 + 0.5 * np.sin(centre_m @ waves.T + rng.uniform(0, 6, 8)).mean(1) * 3, 0, 1)
    return rng.uniform(0, 1, len(centre_m)) if kind == "grain" else np.zeros(len(centre_m))


def _shade(painter: Painter, vertices: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return (F,): light from one direction and ambient light, at the middle of the exposure."""
    corners = vertices[painter.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    light = rng.normal(size=3) + np.array([0, -1, -0.5])
    ambient = rng.uniform(0.25, 1.0)
    grain = 1 + rng.normal(0, 0.04, len(normals))
    return np.clip((ambient + (1 - ambient) * np.clip(normals @ light / np.linalg.norm(light), 0, 1)) * grain, 0, 1)


def _photo_texture(painter: Painter, photos: list[np.ndarray], rng: np.random.Generator) -> torch.Tensor:
    if not photos or rng.random() < 0.3:
        return clothes_texture(painter.body, TEXTURE_PX, rng)
    photo = photos[rng.integers(len(photos))]
    side = int(min(photo.shape[:2]) * rng.uniform(0.3, 1))
    top, left = (int(rng.integers(0, room + 1)) for room in (photo.shape[0] - side, photo.shape[1] - side))
    cut = np.ascontiguousarray(photo[top : top + side, left : left + side])
    return torch.from_numpy(cv2.resize(cut, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_AREA))


def _draw_things(joints_px: np.ndarray, rng: np.random.Generator) -> list[tuple[bool, np.ndarray]]:
    """Draw skirts, hair, hats, bags, wide trousers, balls and sticks: (in front, coverage (S, H, W)) each.

    Args:
        joints_px: (S, 24, 2).
        rng: of the figure.
    """
    at = {name: joints_px[:, index] for index, name in enumerate(JOINT_NAMES)}
    size = float(np.linalg.norm(at["neck"] - at["pelvis"], axis=-1).mean()) + 5
    drawn = []
    for kind in rng.choice(_THINGS, rng.integers(1, 3), replace=False):
        polygons = _thing(str(kind), at, size, rng)
        often = 0.0 if kind == "cape" else 0.85 if kind in ("skirt", "legs") else 0.5
        front = rng.random() < often
        coverage = np.stack([_fill(list(instant)) for instant in zip(*polygons, strict=True)])
        drawn.append((front, coverage))
    return drawn


def _thing(kind: str, at: dict[str, np.ndarray], size: float, rng: np.random.Generator) -> list[np.ndarray]:
    """Return polygons, each (S, corners, 2) [px]."""
    side = str(rng.choice(["left", "right"]))
    if kind in ("skirt", "cape"):
        top, bottom = ("hip", rng.choice(["knee", "ankle"])) if kind == "skirt" else ("shoulder", "knee")
        left, right = at[f"left_{top}"], at[f"right_{top}"]
        low_left, low_right = at[f"left_{bottom}"], at[f"right_{bottom}"]
        across = (left - right) / np.maximum(np.linalg.norm(left - right, axis=-1, keepdims=True), 2)
        wide = size * rng.uniform(0.1, 0.45)
        lift = np.array([0, -size * rng.uniform(0, 0.3)])
        return [
            np.stack(
                [
                    left + across * size * 0.12 + lift,
                    low_left + across * wide,
                    low_right - across * wide,
                    right - across * size * 0.12 + lift,
                ],
                1,
            )
        ]
    if kind == "legs":
        return [_capsule(at[f"{s}_hip"], at[f"{s}_knee"], size * 0.2) for s in ("left", "right")] + [
            _capsule(at[f"{s}_knee"], at[f"{s}_ankle"], size * rng.uniform(0.12, 0.24)) for s in ("left", "right")
        ]
    if kind == "hair":
        drop = (at["neck"] - at["head"]) * rng.uniform(-1, 2)
        return [_blob(at["head"] - 0.5 * (at["neck"] - at["head"]) + drop * 0.5, size * rng.uniform(0.2, 0.35), rng)]
    if kind == "bag":
        return [_blob(at[f"{side}_hip"] if rng.random() < 0.5 else at["spine2"], size * rng.uniform(0.25, 0.5), rng)]
    hand, elbow = at[f"{side}_hand"], at[f"{side}_elbow"]
    if kind == "ball":
        return [_blob(hand + rng.normal(0, 0.1 * size, 2), size * rng.uniform(0.1, 0.35), rng)]
    return [_capsule(hand, hand + (hand - elbow) * rng.uniform(0.5, 2.5), size * rng.uniform(0.02, 0.08))]


def _capsule(start: np.ndarray, end: np.ndarray, radius: float) -> np.ndarray:
    along = end - start
    along = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-3) * radius
    across = along[:, ::-1] * (1, -1)
    return np.stack([start + across, start - across, end - across, end + along * 0.5, end + across], 1)


def _blob(centre: np.ndarray, radius: float, rng: np.random.Generator) -> np.ndarray:
    angles = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    radii = radius * (1 + 0.25 * np.sin(angles * rng.integers(1, 5) + rng.uniform(0, 6))) * rng.uniform(0.8, 1.2)
    outline = np.stack([np.cos(angles) * radii, np.sin(angles) * radii * rng.uniform(0.6, 1.4)], -1)
    return centre[:, None] + outline


def _fill(polygons: list[np.ndarray]) -> np.ndarray:
    canvas = np.zeros((SIZE_PX, SIZE_PX), np.uint8)
    for polygon in polygons:
        corners = np.clip((polygon - 0.5) * 16, -30000, 30000).round().astype(np.int32)
        cv2.fillPoly(canvas, [corners], 255, cv2.LINE_AA, shift=4)
    return canvas.astype(np.float32) / 255


def _render(
    painter: Painter,
    vertices: torch.Tensor,
    textures: list[torch.Tensor],
    camera: PinholeCamera,
    things: list[tuple[bool, np.ndarray]],
) -> np.ndarray:
    """Return (CHANNELS, H, W): the mean over the instants, things before and behind the body."""
    channels = np.zeros((CHANNELS, SIZE_PX, SIZE_PX), np.float32)
    if not things:
        for number, texture in enumerate(textures):
            mean = painter.rasterizer.render_mean(vertices, texture, camera, painter.body.mesh).numpy()
            channels[0] = mean[..., 3]
            channels[1 + 3 * number : 4 + 3 * number] = np.moveaxis(mean[..., :3], -1, 0)
        return channels
    shares: list[np.ndarray] = []
    for number, texture in enumerate(textures):
        every = painter.rasterizer.render(vertices, texture, camera, painter.body.mesh).numpy()
        body, free = every[..., 3], np.ones_like(every[..., 3])
        shares = []
        for front, coverage in things:
            shares.append(coverage * free * (1 if front else 1 - body))
            free = free * (1 - coverage) if front else free
        channels[1 + 3 * number : 4 + 3 * number] += np.moveaxis((every[..., :3] * free[..., None]).mean(0), -1, 0)
        channels[0] = (body * free).mean(0)
    # Two things behind the body may cover each other; their sum never exceeds what the body leaves open.
    seen = np.stack(shares)
    seen /= np.maximum((seen.sum(0) + body * free)[None], 1)
    parts = seen.mean(1)
    channels[0] = np.clip(channels[0] + parts.sum(0), 0, 1)
    channels[8] += parts[0]
    channels[9 if len(parts) > 1 else 8] += parts[1] if len(parts) > 1 else 0
    channels[PHOTO] += parts.sum(0) * 0.3
    return channels
