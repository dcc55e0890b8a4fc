"""Training images of the matting networks: figures with colours before plates, with shadows and a camera model."""

from dataclasses import dataclass

import cv2
import numpy as np

from hfb.photometry import linear_to_srgb, srgb_to_linear
from hfb.training.matting.figures import CHANNELS, GARMENTS, PHOTO, SIZE_PX

# Tables in place of powers: eight bits are all that a camera keeps.
_ENCODED = linear_to_srgb(np.linspace(0, 1, 1 << 14)).astype(np.float32) * 255
_DECODED = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
_SKINS = np.array([(0.93, 0.76, 0.66), (0.82, 0.62, 0.48), (0.55, 0.38, 0.28), (0.36, 0.24, 0.18)])
_FIGURE_SHARE = 0.78


@dataclass(frozen=True)
class Scene:
    """Input and truth of a matting method; images in linear light.

    Attributes:
        frame: (H, W, 3).
        plate: (H, W, 3) without the person.
        alpha: (H, W) truth.
        double: (H, W, 4) premultiplied light and coverage of a substitute for a fit, where the bank has doubles.
    """

    frame: np.ndarray
    plate: np.ndarray
    alpha: np.ndarray
    double: np.ndarray | None = None


@dataclass(frozen=True)
class Difficulty:
    """Ranges of everything drawn; measurements narrow them."""

    size_px: int = 160
    photo_share: float = 0.3  # of figures wear a photograph or the project's own generated clothes
    empty_share: float = 0.05
    scale: tuple[float, float] = (0.32, 1.4)  # the blur's longer side relative to the picture's
    shadow_share: float = 0.75
    reflection_share: float = 0.15  # of floors shine
    cut_share: float = 0.25
    residual_gain: float = 0.015
    hard_share: float = 0.35  # of garments take a colour of the plate
    slide_share: float = 0.0  # of figures move as a whole besides
    longest_slide: float = 0.35  # relative to the picture's side
    picture_share: float = 0.0  # of figures wear a cut of a background, flat


def draw_scene(
    figures: np.ndarray, plates: list[list[np.ndarray]], rules: Difficulty, rng: np.random.Generator
) -> Scene:
    """Draw one composite.

    Args:
        figures: a bank (N, CHANNELS, H, W).
        plates: families of uint8 sRGB images, chosen with equal chances.
        rules: ranges of everything drawn.
        rng: of the scene.
    """
    size = rules.size_px
    plate = _draw_plate(plates, size, rng)
    worn = _draw_plate(plates, size, rng) if rng.random() < rules.picture_share else None
    if rng.random() < 0.06:
        (colour, alpha), *_ = _place(figures, plate, None, rules, rng)
        plate = colour + (1 - alpha[..., None]) * plate  # somebody who is in both pictures
    if rng.random() < rules.empty_share:
        colour, alpha = np.zeros_like(plate), np.zeros((size, size), np.float32)
        shade, doubles = np.ones_like(plate), []
    else:
        (colour, alpha), *doubles = _place(figures, plate, worn, rules, rng)
        shade = cast_shadows(alpha, rng) if rng.random() < rules.shadow_share else np.ones_like(plate)
    lit = plate * shade
    if rng.random() < rules.reflection_share:
        lit = _reflected(lit, colour, alpha, rng)
    if rng.random() < 0.08:
        lit = _flutter(lit, rng)
    frame = colour + (1 - alpha[..., None]) * lit
    beside = [np.dstack(double) for double in doubles]
    if rng.random() < 0.35:
        sigma = rng.uniform(0.3, 1.2)
        frame, plate, alpha, *beside = (cv2.GaussianBlur(one, (0, 0), sigma) for one in (frame, plate, alpha, *beside))
    if rng.random() < 0.4:
        move = np.array([[1, 0, rng.normal(0, 0.25)], [0, 1, rng.normal(0, 0.25)]])
        plate = cv2.warpAffine(plate, move, (size, size), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    gain = np.exp(rng.normal(0, rules.residual_gain) + rng.normal(0, rules.residual_gain / 2, 3))
    frame = frame * gain.astype(np.float32)
    noise, compressed = np.exp(rng.uniform(np.log(0.002), np.log(0.02))), rng.random() < 0.4
    plate_noise = noise * (1 if rng.random() < 0.3 else 0.3)
    frame, plate = take_picture(frame, noise, compressed, rng), take_picture(plate, plate_noise, compressed, rng)
    alpha = np.clip(alpha, 0, 1).astype(np.float32)
    if not beside:
        return Scene(frame, plate, alpha)
    tint = np.append(gain * np.exp(rng.normal(0, 0.03, 3)), 1).astype(np.float32)
    return Scene(frame, plate, alpha, np.clip(beside[0] * tint, 0, 1))


def _draw_plate(plates: list[list[np.ndarray]], size: int, rng: np.random.Generator) -> np.ndarray:
    family = plates[rng.integers(len(plates))]
    picture = family[rng.integers(len(family))]
    shorter = min(picture.shape[:2])
    side = int(shorter * rng.uniform(min(1.0, max(0.35, 120 / shorter)), 1))
    top, left = (int(rng.integers(0, room + 1)) for room in (picture.shape[0] - side, picture.shape[1] - side))
    cut = picture[top : top + side, left : left + side]
    cut = cut[:, ::-1] if rng.random() < 0.5 else cut
    how = cv2.INTER_AREA if side > size else cv2.INTER_LINEAR
    linear = _DECODED[cv2.resize(cut, (size, size), interpolation=how)]
    tint = np.exp(rng.normal(0, 0.3) + rng.normal(0, 0.08, 3)).astype(np.float32)
    return np.clip(linear * tint, 0, 1).astype(np.float32)


def _place(
    figures: np.ndarray, plate: np.ndarray, picture: np.ndarray | None, rules: Difficulty, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return premultiplied colour and coverage of a figure at a random place, then of its double where there is one.

    Args:
        figures: a bank (N, CHANNELS, H, W).
        plate: (H, W, 3) linear light.
        picture: what the figure wears instead of its own colours.
        rules: ranges of everything drawn.
        rng: of the scene.
    """
    size = rules.size_px
    channels = figures[rng.integers(len(figures))]
    while not channels[0].any():  # a bank that is still being rendered
        channels = figures[rng.integers(len(figures))]
    worn = rng.random() < rules.photo_share
    people = [channels[start : start + CHANNELS] for start in range(0, len(channels), CHANNELS)]
    layers = np.concatenate(
        [np.concatenate([one[:1], one[PHOTO]]) if worn else one[: 1 + len(GARMENTS)] for one in people]
    )
    layers = layers[..., :: (-1 if rng.random() < 0.5 else 1)]
    longer = size * np.exp(rng.uniform(*np.log(rules.scale)))
    scale = longer / (_FIGURE_SHARE * SIZE_PX)
    wide = max(8, round(SIZE_PX * scale))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    layers = np.stack([cv2.resize(layer, (wide, wide), interpolation=how) for layer in layers], -1)
    layers = layers.astype(np.float32) / 255
    room = abs(size - longer) / 2 if rng.random() > rules.cut_share else 0.5 * size
    down, right = (round((size - wide) / 2 + rng.uniform(-1, 1) * room) for _ in range(2))
    placed = np.zeros((size, size, layers.shape[-1]), np.float32)
    top, left, bottom, end = max(0, down), max(0, right), min(size, down + wide), min(size, right + wide)
    if bottom > top and end > left:
        placed[top:bottom, left:end] = layers[top - down : bottom - down, left - right : end - right]
    colours = None
    if picture is None and not worn:
        colours = draw_colours(plate[max(0, top) : bottom, max(0, left) : end], rules, rng)
    light = np.exp(rng.normal(0, 0.3) + rng.normal(0, 0.06, 3)).astype(np.float32)
    slides = rng.random() < rules.slide_share
    path = draw_path(size * np.exp(rng.uniform(np.log(0.015), np.log(rules.longest_slide))), rng) if slides else None
    coloured = []
    for one in np.split(placed, len(people), -1):
        alpha: np.ndarray = one[..., 0]
        if picture is not None:
            colour = picture * alpha[..., None]
        elif colours is None:
            colour = one[..., 1:] ** 2
        else:
            colour = (one[..., 1:].reshape(-1, len(GARMENTS)) @ colours).reshape(size, size, 3)
        colour = colour * light
        if path is not None:
            colour = cv2.filter2D(colour, -1, path, borderType=cv2.BORDER_CONSTANT)
            alpha = cv2.filter2D(alpha, -1, path, borderType=cv2.BORDER_CONSTANT)
        coloured.append((np.clip(colour, 0, alpha[..., None]).astype(np.float32), np.clip(alpha, 0, 1)))
    return coloured


def draw_path(length_px: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a blur kernel along an arc, with speed changing towards its end.

    Args:
        length_px: of the path.
        rng: of the path.
    """
    steps = max(32, int(8 * length_px))
    time = (np.arange(steps) + 0.5) / steps
    along = time + rng.uniform(-0.4, 0.4) * (time**2 - time)
    angle = rng.uniform(0, 2 * np.pi) + rng.normal(0, 0.3) * (along - 0.5)
    points = np.stack([np.cos(angle), np.sin(angle)], -1) * length_px / steps
    return path_kernel(np.cumsum(points, 0))


def path_kernel(points_px: np.ndarray) -> np.ndarray:
    """Return the blur kernel of a path around its mean; it sums to 1.

    Args:
        points_px: (N, 2) positions at equally spaced instants.
    """
    points = points_px - points_px.mean(0)
    half = int(np.ceil(np.abs(points).max())) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    columns, rows = half + points.T
    left, top = np.floor(columns).astype(int), np.floor(rows).astype(int)
    right, low = columns - left, rows - top
    for down, share_down in ((0, 1 - low), (1, low)):
        for across, share_across in ((0, 1 - right), (1, right)):
            np.add.at(kernel, (top + down, left + across), share_down * share_across)
    return kernel / kernel.sum()


def draw_colours(behind: np.ndarray, rules: Difficulty, rng: np.random.Generator) -> np.ndarray:
    """Draw colours (GARMENTS, 3) in linear light: from the plate behind the figure, dark, bright, skin, or random.

    Args:
        behind: (n, 3) colours of the plate behind the figure.
        rules: ranges of everything drawn.
        rng: of the scene.
    """
    count = len(GARMENTS)
    colours = srgb_to_linear(rng.uniform(0.02, 0.98, (count, 3)))
    kind = rng.random(count)
    if behind.size:
        places = behind.reshape(-1, 3)[rng.integers(0, behind.size // 3, count)]
        near = np.clip(places * np.exp(rng.normal(0, 0.15, (count, 1)) + rng.normal(0, 0.05, (count, 3))), 0, 1)
        colours = np.where((kind < rules.hard_share)[:, None], near, colours)
    dark, bright = rng.uniform(0.003, 0.05, (2, count, 1)) * rng.uniform(0.7, 1.3, (2, count, 3))
    colours = np.where(((kind > 0.72) & (kind < 0.85))[:, None], dark, colours)
    colours = np.where((kind > 0.92)[:, None], 0.9 - 5 * bright, colours)
    if rng.random() < 0.7:
        colours[0] = srgb_to_linear(_SKINS[rng.integers(4)] * rng.uniform(0.8, 1.1))
    if rng.random() < 0.6:
        colours[1] = srgb_to_linear(rng.uniform(0.03, 0.3) * rng.uniform(0.6, 1.2, 3))
    for base, pattern in ((3, 4), (5, 6), (7, 8)):
        if rng.random() < 0.4:
            colours[pattern] = colours[base] * np.exp(rng.normal(0, 0.4) + rng.normal(0, 0.1, 3))
    if rng.random() < 0.08:
        colours[3:7] = colours[3] * np.exp(rng.normal(0, 0.1, (4, 1)))
    return np.clip(colours, 0.001, 1).astype(np.float32)


def cast_shadows(alpha: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the share of its light that every pixel of the plate keeps (H, W, 3): shadows and contact shade.

    Args:
        alpha: (H, W) matte of the figure.
        rng: of the scene.
    """
    size = len(alpha)
    keeps = np.ones((size, size), np.float32)
    rows, columns = np.flatnonzero((alpha > 0.2).any(1)), np.flatnonzero((alpha > 0.2).any(0))
    if not rows.size:
        return np.repeat(keeps[..., None], 3, -1)
    foot, middle, tall = float(rows[-1]), float(columns.mean()), float(rows[-1] - rows[0] + 1)
    for _ in range(rng.integers(0, 4)):  # lamps: the figure's outline, laid on the floor or upright on a wall behind
        wall = rng.random() < 0.35
        lean, squash = (rng.normal(0, 0.1), 1.0) if wall else (rng.normal(0, 0.9), rng.uniform(-0.5, 0.5))
        shift = rng.normal(0, 0.12, 2) * tall if wall else rng.normal(0, 0.03, 2) * tall
        matrix = np.array([[1, lean, shift[0] - lean * foot], [0, squash, shift[1] + foot - squash * foot]])
        mask = cv2.warpAffine(alpha, matrix, (size, size))
        mask = cv2.GaussianBlur(mask, (0, 0), max(0.6, tall * np.exp(rng.uniform(np.log(0.005), np.log(0.1)))))
        keeps = keeps * (1 - rng.uniform(0.05, 0.6) * mask)
    for _ in range(rng.integers(0, 4)):
        mask = np.zeros((size, size), np.float32)
        axes = (max(1, int(tall * rng.uniform(0.05, 0.35))), max(1, int(tall * rng.uniform(0.02, 0.12))))
        place = (int(middle + rng.normal(0, 0.15) * tall), int(foot + rng.normal(0.02, 0.08) * tall))
        cv2.ellipse(mask, place, axes, float(rng.normal(0, 15)), 0, 360, 1.0, -1)
        keeps = keeps * (1 - rng.uniform(0.05, 0.6) * cv2.GaussianBlur(mask, (0, 0), max(1.0, axes[1] / 1.5)))
    if rng.random() < 0.4:
        near = cv2.GaussianBlur(alpha, (0, 0), tall * rng.uniform(0.1, 0.4))
        keeps = keeps * (1 - rng.uniform(-0.12, 0.3) * near)
    tint = 1 + rng.normal(0, 0.06, 3) * (1 - keeps[..., None])
    return (keeps[..., None] * tint).astype(np.float32)


def _reflected(lit: np.ndarray, colour: np.ndarray, alpha: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Add the reflection of a glossy floor: the figure upside down below its feet, blurred and faint."""
    rows = np.flatnonzero((alpha > 0.2).any(1))
    if not rows.size:
        return lit
    foot, tall, size = float(rows[-1]), float(rows[-1] - rows[0] + 1), len(alpha)
    squash = rng.uniform(-1, -0.5)
    matrix = np.array([[1, rng.normal(0, 0.1), 0], [0, squash, foot * (1 - squash)]])
    share, sigma = rng.uniform(0.05, 0.4), max(0.6, tall * rng.uniform(0.005, 0.05))
    mirrored = cv2.GaussianBlur(cv2.warpAffine(np.dstack([colour, alpha]), matrix, (size, size)), (0, 0), sigma)
    fades = np.exp(-np.maximum(np.arange(size, dtype=np.float32) - foot, 0) / (tall * rng.uniform(0.1, 0.6)))
    mirrored *= np.float32(share) * fades[:, None, None]
    return (1 - mirrored[..., 3:]) * lit + mirrored[..., :3]


def _flutter(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Move a patch of the background by a pixel or two: leaves, curtains, water."""
    size = len(picture)
    grain = rng.normal(0, 1, (size, size, 2)).astype(np.float32)
    field: np.ndarray = cv2.GaussianBlur(grain, (0, 0), rng.uniform(2, 6))
    field *= rng.uniform(0.3, 1.2) / max(field.std(), 1e-6)
    patch = np.zeros((size, size), np.float32)
    centre = tuple(int(value) for value in rng.uniform(0, size, 2))
    cv2.circle(patch, centre, int(size * rng.uniform(0.1, 0.35)), 1.0, -1)
    field *= cv2.GaussianBlur(patch, (0, 0), 0.03 * size)[..., None]
    rows, columns = np.mgrid[:size, :size].astype(np.float32)
    return cv2.remap(picture, columns + field[..., 0], rows + field[..., 1], cv2.INTER_LINEAR, None, cv2.BORDER_REFLECT)


def take_picture(linear: np.ndarray, noise: float, compressed: bool, rng: np.random.Generator) -> np.ndarray:
    """Simulate a camera: shot and read noise, 8 bits, optionally JPEG; returns linear light.

    Args:
        linear: (H, W, 3) linear light.
        noise: standard deviation at white, in linear light.
        compressed: whether through JPEG.
        rng: of the scene.
    """
    light = np.clip(linear, 0, 1)
    grain: np.ndarray = rng.standard_normal(linear.shape, np.float32)
    if compressed:
        grain = cv2.GaussianBlur(grain, (0, 0), 0.7) * 2
    seen = light + np.float32(noise) * np.sqrt(0.15 + 0.85 * light) * grain
    levels = _ENCODED[(np.clip(seen, 0, 1) * (len(_ENCODED) - 1)).astype(np.uint16)].round().astype(np.uint8)
    if compressed:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(55, 97))]
        stored = cv2.imencode(".jpg", levels[..., ::-1], quality)[1]
        levels = np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR))[..., ::-1]
    return _DECODED[levels]
