"""Small videos whose every pixel is known, and the files that belong to them."""

import json
from pathlib import Path

import av
import numpy as np

from hfb.io.media.images.image_io import write_png

HEIGHT, WIDTH, FPS = 192, 160, 50
FOCAL = 200.0
DEPTH_M = 4.0
BODY = (
    "RHip",
    "LHip",
    "RKnee",
    "LKnee",
    "RAnkle",
    "LAnkle",
    "RShoulder",
    "LShoulder",
    "RElbow",
    "LElbow",
    "RWrist",
    "LWrist",
    "Neck",
    "Nose",
)
# Where the joints are, in pixels from the figure's middle.
_PLACES = np.array(
    [[-8, 8], [8, 8], [-9, 32], [9, 32], [-9, 56], [9, 56], [-14, -38], [14, -38], [-22, -20], [22, -20], [-24, -2],
     [24, -2], [0, -44], [0, -52]], float
)  # fmt: skip


def middle(frame: int) -> tuple[float, float]:
    """Where the figure's middle is (x, y) in OpenCV's pixels: it walks and sways."""
    return 50.0 + 3.0 * frame, 96.0 + 6.0 * np.sin(frame / 3)


def room() -> np.ndarray:
    """A textured background, 8 bit."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    waves = 40 * np.sin(columns / 7.0) * np.cos(rows / 11.0) + 25 * ((columns // 16 + rows // 16) % 2)
    return np.clip(100 + waves[..., None] + np.array([0, 10, 20]), 0, 255).astype(np.uint8)


def figure(frame: int) -> np.ndarray:
    """The room with a bright red figure of trunk, head, arms and legs in it."""
    picture, (x, y) = room(), middle(frame)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    for left, right, top, bottom in ((-17, 17, -44, 12), (-27, -16, -30, 2), (16, 27, -30, 2), (-14, -4, 8, 62),
                                     (4, 14, 8, 62), (-8, 8, -60, -40)):  # fmt: skip
        inside = (columns >= x + left) & (columns < x + right) & (rows >= y + top) & (rows < y + bottom)
        picture[inside] = (230, 30, 40)
    return picture


def joints_m(frame: int) -> np.ndarray:
    """The joints of BODY in the world, which is the camera's frame here [m]."""
    pixels = _PLACES + middle(frame)
    return np.concatenate([(pixels - (WIDTH / 2, HEIGHT / 2)) / FOCAL * DEPTH_M, np.full((len(pixels), 1), DEPTH_M)], 1)


def write_video(path: Path, frames: list[np.ndarray], fps: int = FPS) -> None:
    """A lossless video."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264rgb", rate=fps, options={"qp": "0"})
        stream.height, stream.width, stream.pix_fmt = *frames[0].shape[:2], "rgb24"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def write_trc(path: Path, points: np.ndarray, names: tuple[str, ...], rate: float, unit: str = "m") -> None:
    """OpenSim's .trc with a gap wherever a point is NaN."""
    scale = {"m": 1, "mm": 1000}[unit]
    axes = "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, len(names) + 1))
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:g}\t{rate:g}\t{len(points)}\t{len(names)}\t{unit}\t{rate:g}\t0\t{len(points)}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + axes,
    ]
    for index, row in enumerate(points):
        cells = ["" if np.isnan(value) else repr(float(value * scale)) for value in row.ravel()]
        lines.append("\t".join([str(index), repr(index / rate), *cells]))
    path.write_text("\n".join(lines) + "\n")


def calibration_toml(distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)) -> str:
    """A Calib.toml of one camera that stands in the world's origin."""
    return (
        f'[cam01]\nname = "cam01"\nsize = [{WIDTH}.0, {HEIGHT}.0]\n'
        f"matrix = [[{FOCAL}, 0.0, {WIDTH / 2}], [0.0, {FOCAL}, {HEIGHT / 2}], [0.0, 0.0, 1.0]]\n"
        f"distortions = {list(distortion)}\nrotation = [0.0, 0.0, 0.0]\ntranslation = [0.0, 0.0, 0.0]\n"
        "fisheye = false\n\n[metadata]\nadjusted = false\nerror = 0.0\n"
    )


def cameras_json() -> str:
    """The same camera as cameras.json."""
    matrix = [[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]
    camera = {
        "video": "cam01_walk.mp4",
        "width": WIDTH,
        "height": HEIGHT,
        "K": matrix,
        "dist_k1k2p1p2": [0, 0, 0, 0],
        "R_world_to_cam": np.eye(3).tolist(),
        "t_world_to_cam": [0, 0, 0],
        "first_frame": 0,
    }
    return json.dumps({"cameras": {"cam01": camera}})


def write_recording(folder: Path, count: int = 24, rows_late: int = 0) -> None:
    """A video, its plate, its calibration and its joints; row n of the joints shows frame n + rows_late."""
    folder.mkdir(parents=True, exist_ok=True)
    write_video(folder / "cam01_walk.mp4", [figure(index) for index in range(count)])
    write_png(folder / "cam01_plate.png", (room() / np.float32(255)).astype(np.float32))
    (folder / "Calib.toml").write_text(calibration_toml())
    write_trc(folder / "walk.trc", np.stack([joints_m(index + rows_late) for index in range(count)]), BODY, FPS)
