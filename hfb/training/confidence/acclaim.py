"""Convert CMU's own recordings, a skeleton (.asf) and its takes (.amc), to BVH, which `hfb benchmark --motions` reads.

hfb train acclaim --skeletons DIR --out DIR        # every SUBJECT.asf below DIR with its SUBJECT_TAKE.amc
"""

import argparse
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hfb.errors import InputError
from hfb.training.flags import folder
from hfb.training.schedule import Counter

_CM = 2.54 / 0.45
"""The database's unit of length in centimetres."""

_RATE_HZ = 120.0
_AXES = {"rx": 0, "ry": 1, "rz": 2}


@dataclass
class Bone:
    """A bone of the skeleton; it rotates about its upper end, in its own axes.

    Attributes:
        offset: from its upper to its lower end in the rest pose [cm].
        axes: rotation from the database's axes to the bone's.
    """

    name: str
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    axes: Rotation = field(default_factory=Rotation.identity)
    free: tuple[str, ...] = ()
    children: list["Bone"] = field(default_factory=list)


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    parser.add_argument("--skeletons", type=folder, required=True, metavar="DIR", help="SUBJECT.asf, SUBJECT_TAKE.amc")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where the BVH files go")


def run(options: argparse.Namespace) -> None:
    """Convert all takes below a folder.

    Args:
        options: the parsed options.
    """
    options.out.mkdir(parents=True, exist_ok=True)
    counter = Counter("takes", 10)
    takes = [
        (skeleton, take)
        for skeleton in sorted(options.skeletons.rglob("*.asf"))
        for take in sorted(skeleton.parent.glob(f"{skeleton.stem}_*.amc"))
    ]
    if not takes:
        raise InputError(f"{options.skeletons} has no SUBJECT.asf with a SUBJECT_TAKE.amc beside it")
    for number, (skeleton, take) in enumerate(takes, 1):
        root = read_skeleton(skeleton.read_text())
        (options.out / f"cmu_{take.stem}.bvh").write_text(bvh(root, read_take(take.read_text())))
        counter.reached(number)


def read_skeleton(text: str) -> Bone:
    """Parse the tree of bones from an .asf file.

    Args:
        text: content of the file.
    """
    root = Bone("root", free=("tx", "ty", "tz", "rx", "ry", "rz"))
    bones, section, bone = {"root": root}, "", root
    for words in (line.split() for line in text.splitlines() if line.strip()):
        match section, words:
            case _, [name, *_] if name.startswith(":"):
                section = name
            case ":bonedata", ["name", name]:
                bone = bones[name] = Bone(name)
            case ":bonedata", ["direction", *numbers]:
                bone.offset = np.array(numbers[:3], float)
            case ":bonedata", ["length", length]:
                bone.offset = bone.offset * float(length) * _CM
            case ":bonedata", ["axis", x, y, z, _]:
                bone.axes = Rotation.from_euler("xyz", [float(x), float(y), float(z)], degrees=True)
            case ":bonedata", ["dof", *free]:
                bone.free = tuple(free)
            case ":hierarchy", [parent, *children] if parent in bones:
                bones[parent].children += [bones[name] for name in children]
    return root


def read_take(text: str) -> list[dict[str, list[float]]]:
    """Parse the frames of an .amc file into the numbers of every moving bone.

    Args:
        text: content of the file.
    """
    frames: list[dict[str, list[float]]] = []
    for words in (line.split() for line in text.splitlines() if line.strip() and line[0] not in "#:"):
        if len(words) == 1:
            frames.append({})
        else:
            frames[-1][words[0]] = [float(word) for word in words[1:]]
    return frames


def bvh(root: Bone, frames: list[dict[str, list[float]]]) -> str:
    """Return the text of a BVH file; a bone's joint is its upper end in the rest pose.

    Args:
        root: of the skeleton.
        frames: per frame the numbers of every moving bone.
    """
    lines, columns = ["HIERARCHY"], []
    rows = np.array([frame["root"][:3] for frame in frames]) * _CM
    columns.append(rows)

    def write(bone: Bone, at: np.ndarray, depth: int) -> None:
        pad = "  " * depth
        lines.extend([f"{pad}{'JOINT' if depth else 'ROOT'} {bone.name}", f"{pad}{{"])
        lines.append(f"{pad}  OFFSET {at[0]:.4f} {at[1]:.4f} {at[2]:.4f}")
        places = "" if depth else "Xposition Yposition Zposition "
        lines.append(f"{pad}  CHANNELS {3 if depth else 6} {places}Zrotation Yrotation Xrotation")
        columns.append(_turns(bone, frames))
        for child in bone.children:
            write(child, bone.offset, depth + 1)
        if not bone.children:
            end = " ".join(f"{one:.4f}" for one in bone.offset)
            lines.extend([f"{pad}  End Site", f"{pad}  {{", f"{pad}    OFFSET {end}", f"{pad}  }}"])
        lines.append(f"{pad}}}")

    write(root, np.zeros(3), 0)
    lines += ["MOTION", f"Frames: {len(frames)}", f"Frame Time: {1 / _RATE_HZ:.7f}"]
    lines += [" ".join(f"{value:.4f}" for value in row) for row in np.concatenate(columns, 1)]
    return "\n".join(lines) + "\n"


def _turns(bone: Bone, frames: list[dict[str, list[float]]]) -> np.ndarray:
    """Return a bone's angles about z, y and x relative to its parent, per frame [degrees]."""
    angles = np.zeros((len(frames), 3))
    for place, name in enumerate(bone.free):
        if name in _AXES:
            angles[:, _AXES[name]] = [frame[bone.name][place] for frame in frames]
    turned = bone.axes * Rotation.from_euler("xyz", angles, degrees=True) * bone.axes.inv()
    return turned.as_euler("ZYX", degrees=True)
