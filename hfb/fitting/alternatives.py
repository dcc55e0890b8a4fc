"""Alternative motions with the same images: their terms and probabilities, and the remaining ambiguity."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hfb.errors import InputError
from hfb.io.array_files import read_arrays
from hfb.motion.motion_file import write_arrays
from hfb.priors.motion_columns import LIMBS
from hfb.typing import Array, Bool, Float

LIMB_NAMES: tuple[str, ...] = tuple(LIMBS)
LIMB_JOINTS: tuple[tuple[int, ...], ...] = tuple(tuple(c for c in columns if c < 24) for columns in LIMBS.values())
MOVES_M = 0.015
"""A path that differs less from its reverse has no direction."""

_UNSURE = 0.75
_UNPACKED_LIMIT, _LARGEST = 128 << 20, 1e6
_KINDS = {"reversed_limbs": "b", "chosen": "iu", "frame_index": "iu", "score_names": "U", "feature_names": "U"}
_FRONT = ("front_poses", "front_trans", "front_joints", "front_probability")
_ARRAYS = ("reversed_limbs", "poses", "trans", "joints", "probability", "chosen", "frame_index")


@dataclass(frozen=True)
class FrontMotion:
    """The motion that was fitted with the person facing the other way.

    Attributes:
        poses: axis-angle [rad].
        trans: SMPL's translation [m].
        joints: camera coordinates [m].
        probability: that this front is the right one.
    """

    poses: Float[Array, "R 72"]
    trans: Float[Array, "R 3"]
    joints: Float[Array, "R 24 3"]
    probability: float


@dataclass(frozen=True)
class Alternatives:
    """A alternative motions of R = frames x sub-frames rows each, one of which is the result.

    Attributes:
        reversed_limbs: per frame which limbs (`LIMB_NAMES`) run backwards compared with what was first fitted.
        poses: axis-angle [rad].
        trans: SMPL's translation [m].
        joints: camera coordinates [m].
        scores: per motion, the objective's terms by name, their weighted sum ``loss`` and the motion prior's evidence.
        probability: probability of each motion, given that one of them is right; adds up to 1.
        chosen: the number of the result.
        frame_index: the frame each row belongs to.
        other_front: where both fronts were fitted, the one that was not kept; all other motions have the kept one.
    """

    reversed_limbs: Bool[Array, "A T 5"]
    poses: Float[Array, "A R 72"]
    trans: Float[Array, "A R 3"]
    joints: Float[Array, "A R 24 3"]
    scores: Mapping[str, Float[Array, "A"]]
    probability: Float[Array, "A"]
    chosen: int
    frame_index: Array
    other_front: FrontMotion | None = None

    def joint_right(self) -> Float[Array, "T 24"]:
        """Return P(the joint moved in the result's direction), camera coordinates; NaN for one that hardly moved."""
        return np.stack([self.agrees(self.joints, (joint,)) @ self.probability for joint in range(24)], 1)

    def limb_right(self) -> Float[Array, "T 5"]:
        """Return `joint_right` of each limb's joints together, in the order of `LIMB_NAMES`."""
        return np.stack([self.agrees(self.joints, joints) @ self.probability for joints in LIMB_JOINTS], 1)

    def body_right(self) -> Float[Array, "T"]:
        """Return P(direction right) of the whole body about its pelvis (`hfb.evaluation.metrics.wrong_direction`)."""
        return self.body_agrees() @ self.probability

    def limb_right_given_body(self) -> Float[Array, "T 5"]:
        """Return P(limb's direction right) if the whole body's is: the uncertainty beyond the arrow of time."""
        weights = np.nan_to_num(self.body_agrees(), nan=1.0) * self.probability
        limbs = np.stack([self.agrees(self.joints, joints) for joints in LIMB_JOINTS], 1)
        return np.einsum("tla,ta->tl", limbs, weights / weights.sum(1, keepdims=True))

    def spread_m(self) -> Float[Array, "R 24"]:
        """Return the root mean square distance of the alternatives from the result, weighted, about the pelvis [m]."""
        centred = self.joints - self.joints[:, :, :1]
        squared = ((centred - centred[self.chosen]) ** 2).sum(-1)
        return np.sqrt(np.tensordot(self.probability, squared, 1))

    def body_agrees(self) -> Float[Array, "T A"]:
        """Return `agrees` of the whole body about its pelvis."""
        return self.agrees(self.joints - self.joints[:, :, :1], tuple(range(24)))

    def agrees(self, joints: Float[Array, "A R 24 3"], chosen: tuple[int, ...]) -> Float[Array, "T A"]:
        """Return per frame and motion whether some joints follow the result's path rather than its reverse.

        A tie counts half. NaN where the joints hardly moved.

        Args:
            joints: joints of every motion [m].
            chosen: numbers of the joints to compare.
        """
        out = np.full((int(self.frame_index.max()) + 1, len(joints)), np.nan)
        for frame in range(len(out)):
            paths = joints[:, self.frame_index == frame][:, :, list(chosen)]
            result = paths[self.chosen]
            if np.linalg.norm(result - result[::-1], axis=-1).max() >= MOVES_M:
                forwards = np.linalg.norm(paths - result, axis=-1).sum((1, 2))
                backwards = np.linalg.norm(paths - result[::-1], axis=-1).sum((1, 2))
                out[frame] = np.where(np.isclose(forwards, backwards, rtol=1e-6), 0.5, forwards < backwards)
        return out


Record = dict[str, dict[str, float | None]]


def direction_record(alternatives: Alternatives) -> list[Record]:
    """Return P(direction right) per frame as plain numbers, None where hardly anything moved.

    ``right`` has the whole body's and every limb's probability, ``given_body`` every limb's if the whole body's is
    right.

    Args:
        alternatives: motions with their probabilities.
    """

    def numbers(names: tuple[str, ...], values: Array) -> dict[str, float | None]:
        return {n: round(float(p), 4) if np.isfinite(p) else None for n, p in zip(names, values, strict=True)}

    everything = np.column_stack([alternatives.body_right(), alternatives.limb_right()])
    return [
        {"right": numbers(("body", *LIMB_NAMES), row), "given_body": numbers(LIMB_NAMES, limbs)}
        for row, limbs in zip(everything, alternatives.limb_right_given_body(), strict=True)
    ]


def what_is_unknown(record: Sequence[Record]) -> str:
    """Return one or two sentences on the directions of motion that the images do not determine.

    Args:
        record: per frame, see `direction_record`.
    """
    said = []
    for number, frame in enumerate(record, 1):
        body = frame["right"]["body"]
        limbs = [
            f"the {name} {100 * p:.0f} %" for name, p in frame["given_body"].items() if p is not None and p < _UNSURE
        ]
        parts = [f"the whole body moved the way shown with a probability of {100 * body:.0f} %"] if body else []
        if limbs:
            parts.append(f"{'even then unsure' if body else 'unsure'}: {', '.join(limbs)}")
        if parts:
            said.append((f"in frame {number} " if len(record) > 1 else "") + "; ".join(parts))
    if not said:
        return "Nothing moved far enough to have a direction."
    first = "One blurred picture does not tell which way time ran: " if len(record) == 1 else "Directions: "
    return first + "; ".join(said) + "."


def save_alternatives(
    path: Path, alternatives: Alternatives, joint_features: Mapping[str, Float[Array, "R 24"]]
) -> None:
    """Write alternatives.npz, whole or not at all, without a pickled member; positions and angles in single precision.

    Args:
        path: the file.
        alternatives: motions with their probabilities.
        joint_features: features behind the joints' radii; calibrations read them.
    """
    arrays = {name: np.asarray(getattr(alternatives, name)) for name in _ARRAYS}
    arrays |= {name: arrays[name].astype(np.float32) for name in ("poses", "trans", "joints")}
    names = tuple(alternatives.scores)
    arrays |= {
        "limbs": np.array(LIMB_NAMES),
        "score_names": np.array(names),
        "scores": np.stack([alternatives.scores[name] for name in names], 1),
        "joint_right": alternatives.joint_right(),
        "limb_right": alternatives.limb_right(),
        "body_right": alternatives.body_right(),
        "feature_names": np.array(tuple(joint_features)),
        "features": np.array([joint_features[name] for name in joint_features], np.float32),
    }
    if (front := alternatives.other_front) is not None:
        motions = (np.asarray(one, np.float32) for one in (front.poses, front.trans, front.joints))
        arrays |= dict(zip(_FRONT, (*motions, np.array(front.probability)), strict=True))
    write_arrays(path, arrays)


def load_alternatives(path: Path) -> tuple[Alternatives, dict[str, Float[Array, "R 24"]]]:
    """Read what `save_alternatives` wrote: the alternatives, and the joints' features by name.

    Args:
        path: the file.

    Raises:
        InputError: no such file, or another one.
    """
    try:
        found = read_arrays(path, limit=_UNPACKED_LIMIT)
        read = {name: found[name] for name in _ARRAYS}
        _check(found)
        scores = dict(zip(found["score_names"].tolist(), found["scores"].T, strict=True))
        features = dict(zip(found["feature_names"].tolist(), found["features"].astype(np.float64), strict=True))
        front = None
        if _FRONT[0] in found:
            poses, trans, joints = (found[name].astype(np.float64) for name in _FRONT[:3])
            front = FrontMotion(poses, trans, joints, float(found[_FRONT[3]]))
    except FileNotFoundError:
        raise InputError(f"there is no file of alternatives at {path}; `hfb fit` leaves one") from None
    except (KeyError, ValueError, TypeError, OSError) as error:
        raise InputError(f"{path} holds no alternatives of hfb ({error}); make one with `hfb fit`") from None
    read |= {name: read[name].astype(np.float64) for name in ("poses", "trans", "joints")}
    return Alternatives(**read | {"chosen": int(read["chosen"]), "scores": scores, "other_front": front}), features


def _check(found: Mapping[str, Array]) -> None:
    """Raise ValueError where arrays do not match or hold values that no fit produces, KeyError where one is missing.

    A frame's number is used as an index, so it has to be as small as those of a fit.
    """
    several, rows = found["poses"].shape[:2] if found["poses"].ndim == 3 else (0, 0)
    frames = found["reversed_limbs"].shape[1] if found["reversed_limbs"].ndim == 3 else 0
    scores, features = (len(np.atleast_1d(found[name])) for name in ("score_names", "feature_names"))
    shapes = {
        "poses": (several, rows, 72),
        "trans": (several, rows, 3),
        "joints": (several, rows, 24, 3),
        "reversed_limbs": (several, frames, len(LIMB_NAMES)),
        "probability": (several,),
        "chosen": (),
        "frame_index": (rows,),
        "scores": (several, scores),
        "features": (features, rows, 24),
        "score_names": (scores,),
        "feature_names": (features,),
    }
    motions = ["poses", "trans", "joints", "probability"]
    if _FRONT[0] in found:
        shapes |= dict(zip(_FRONT, ((rows, 72), (rows, 3), (rows, 24, 3), ()), strict=True))
        motions += _FRONT
    for name, shape in shapes.items():
        array = found[name]
        if array.shape != shape or array.dtype.kind not in _KINDS.get(name, "f"):
            raise ValueError(f"its {name} is {str(array.dtype)[:20]} {array.shape}, not {shape}")
    for name in motions:
        if not (np.abs(found[name]) <= _LARGEST).all():
            raise ValueError(f"its {name} has a number beyond {_LARGEST:g}, or one that is not finite")
    if not rows or not 0 <= found["chosen"] < several or not (found["probability"] >= 0).all():
        raise ValueError("it has no motion that was chosen")
    if sorted(set(found["frame_index"].tolist())) != list(range(frames)):
        raise ValueError("its frames are not numbered from 0 on")
