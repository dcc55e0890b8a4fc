"""A motion in viser's live viewer: the textured body, the camera with the plate, and joints as large as their radii.

viser listens on every network, goes to another port where its own is taken, takes messages from any page, and can make
a public address. Here it gets a socket of this machine, takes messages from its own page alone, and shares nothing.
"""

import io
import math
import socket
import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from PIL import Image

from hfb.body.model import Body
from hfb.body.skeleton import JOINT_NAMES
from hfb.evaluation.protocol import pose_rows
from hfb.geometry.placement import z_up
from hfb.interop.writers.skin import skin_of
from hfb.report.pages.viewer import ViewedMotion
from hfb.typing import Array, Float

_KEPT = 48  # meshes of a few hundred kilobytes in the browser
_LOOKS_EVERY_S = 1 / 60
_FPS, _FASTEST_FPS = 8, 30
_BEHIND_M = 0.6  # the plate, behind the person
_UNKNOWN_M = 0.015
_KNOWN, _GRAY = (220, 120, 40), (90, 90, 90)


class LiveView:
    """A scene, and the controls that move it; the slider of a page is that of all pages."""

    def __init__(
        self,
        listening: socket.socket,
        motions: Sequence[ViewedMotion],
        body: Body | None,
        texture_png: bytes | None = None,
        plate_srgb: Float[Array, "H W 3"] | None = None,
    ) -> None:
        """Start the server and build the scene, in camera coordinates.

        Args:
            listening: a socket that listens on 127.0.0.1; the server closes it.
            motions: of one person; the first is shown, a menu offers the others.
            body: the model they were fitted with; None for joints alone.
            texture_png: the body's texture.
            plate_srgb: the background.
        """
        self._server = _serve(listening)
        self._server.request_share_url = lambda *_: None
        self._server.gui.configure_theme(show_share_button=False, show_logo=False)
        self._motions, self._body = {one.name: one.motion for one in motions}, body
        self._skin = skin_of(body, torch.from_numpy(motions[0].motion.betas).to(body.template.dtype)) if body else None
        self._texture = Image.open(io.BytesIO(texture_png)).convert("RGB") if texture_png else None
        self._meshes: OrderedDict[tuple[str, int], Any] = OrderedDict()
        self._shown: Any = None
        self._state: tuple[object, ...] = ()
        self._ended = threading.Event()
        names = [f"/joints/{name}" for name in JOINT_NAMES]
        self._joints = [self._server.scene.add_icosphere(name, _UNKNOWN_M, visible=False) for name in names]
        self._add_camera(motions[0].motion, plate_srgb)
        self._add_controls(motions[0].motion)
        self._update()

    def run(self) -> None:
        """Show what the controls say, until `close`."""
        due_s = time.monotonic()
        while not self._ended.wait(_LOOKS_EVERY_S):
            if self._play.value and time.monotonic() >= due_s:
                self._slider.value = (int(self._slider.value) + 1) % (int(self._slider.max) + 1)
                due_s = time.monotonic() + 1 / self._fps.value
            self._update()

    def close(self) -> None:
        """End the server."""
        self._ended.set()
        self._server.stop()

    def _add_camera(self, motion: Any, plate_srgb: Float[Array, "H W 3"] | None) -> None:
        K, scene = motion.K, self._server.scene
        width, height = motion.size or (plate_srgb.shape[1::-1] if plate_srgb is not None else 2 * K[:2, 2])
        depth = float(motion.joints[..., 2].max()) + _BEHIND_M
        pixels = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]])
        corners = depth * pixels @ np.linalg.inv(K).T
        edges = [[np.zeros(3), one] for one in corners] + [[corners[at - 1], corners[at]] for at in range(4)]
        scene.add_line_segments("/camera/edges", np.array(edges), _GRAY, thickness=0.004)
        if plate_srgb is not None:
            image = np.uint8(np.round(255 * np.clip(plate_srgb, 0, 1)))
            size = corners[2] - corners[0]
            scene.add_image("/camera/plate", image, size[0], size[1], position=corners.mean(0), cast_shadow=False)
        up, middle = z_up(motion.export_world).R[2], motion.joints[:, 0].mean(0)
        self._server.scene.set_up_direction(tuple(up))
        start = self._server.initial_camera
        start.position, start.look_at = tuple(0.25 * middle + [-0.35 * middle[2], 0, 0] + 0.3 * up), tuple(middle)

        through = self._server.gui.add_button("Look through the camera")

        @through.on_click
        def _(event: Any) -> None:
            camera = event.client.camera
            camera.position, camera.look_at, camera.up_direction = (0, 0, 0), (0, 0, depth), (0, -1, 0)
            camera.fov = 2 * math.atan(height / 2 / K[1, 1])

    def _add_controls(self, motion: Any) -> None:
        gui, last = self._server.gui, len(motion.times_s) - 1
        self._menu = gui.add_dropdown("Motion", tuple(self._motions), visible=len(self._motions) > 1)
        self._slider = gui.add_slider("Sub-frame", 0, max(last, 1), 1, 0, disabled=last == 0)
        self._text = gui.add_markdown("")
        self._play = gui.add_checkbox("Play", False, disabled=last == 0)
        self._fps = gui.add_slider("Sub-frames per second", 1, _FASTEST_FPS, 1, _FPS)
        self._surface = gui.add_checkbox("Body", True, visible=self._skin is not None)
        self._balls = gui.add_checkbox("Joints, as large as their radii", self._skin is None)

    def _update(self) -> None:
        """Bring the scene to what the controls say, if they say something new."""
        motion, row = self._motions[self._menu.value], int(self._slider.value)
        row = min(row, len(motion.times_s) - 1)
        state = (self._menu.value, row, self._surface.value, self._balls.value)
        if state == self._state:
            return
        self._state = state
        if self._skin is not None:
            mesh = self._mesh(row)
            mesh.visible = self._surface.value
            if self._shown not in (None, mesh):
                self._shown.visible = False
            self._shown = mesh
            for ahead in range(row + 1, min(row + 4, len(motion.times_s))):
                self._mesh(ahead)  # the browser has read it when its turn comes
        self._show_joints(motion, row)
        self._text.content = f"frame {motion.frame_index[row]}, {1000 * motion.times_s[row]:.1f} ms"  # it is shown now

    def _mesh(self, row: int) -> Any:
        """Return the body of a row in the scene; where it is new it is not visible."""
        import trimesh

        key = (self._menu.value, row)
        if key not in self._meshes:
            assert self._skin is not None
            assert self._body is not None
            vertices = pose_rows(self._motions[key[0]], np.array([row]), self._body).vertices[0].numpy()
            uv = self._skin.uv * [1, -1] + [0, 1]  # trimesh counts rows from below
            material = trimesh.visual.material.PBRMaterial(
                baseColorTexture=self._texture, metallicFactor=0.0, roughnessFactor=0.9
            )
            visual = trimesh.visual.TextureVisuals(uv, material=material)
            surface = trimesh.Trimesh(
                vertices[self._skin.points], self._skin.corners.reshape(-1, 3), visual=visual, process=False
            )
            name = f"/body/{list(self._motions).index(key[0])}/{row}"
            self._meshes[key] = self._server.scene.add_mesh_trimesh(name, surface, visible=False)
        self._meshes.move_to_end(key)
        while len(self._meshes) > _KEPT:
            self._meshes.popitem(last=False)[1].remove()
        return self._meshes[key]

    def _show_joints(self, motion: Any, row: int) -> None:
        radii = motion.joint_radius_mm
        known = np.full(len(self._joints), np.nan) if radii is None else radii[row] / 1000
        for ball, place, radius in zip(self._joints, motion.joints[row], known, strict=True):
            ball.visible = self._balls.value
            ball.position = tuple(place)
            ball.radius, ball.color = (float(radius), _KNOWN) if radius > 0 else (_UNKNOWN_M, _GRAY)


def _serve(listening: socket.socket) -> Any:
    """Start a server of viser's on a socket; it refuses sockets of other pages, and to be shared."""
    import viser
    from websockets.asyncio import server

    serve, port = server.serve, listening.getsockname()[1]
    origins = [f"http://{name}:{port}" for name in ("127.0.0.1", "localhost")]

    def serve_here(handler: Any, _host: str, _port: int, **options: Any) -> Any:
        return serve(handler, sock=listening, origins=origins, **options)  # type: ignore[arg-type]

    server.serve = serve_here  # type: ignore[assignment, misc]
    try:
        started: Any = viser.ViserServer("127.0.0.1", port, "Human from Blur", verbose=False)
    finally:
        server.serve = serve  # type: ignore[misc]
    return started
