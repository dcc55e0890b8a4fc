"""A fitted motion in memory: arrays, the page, the viewer, exports, and the folder that all commands read."""

import difflib
import html
import logging
import shutil
import tempfile
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from hfb.api.call_options import name_parameters
from hfb.api.given_images import errors_of_calls, path_of
from hfb.body.assets import load_body as load_any_body
from hfb.body.model import BetasSpace, Body
from hfb.config import CsvFrame, ExportConfig, MotionFormat
from hfb.errors import InputError
from hfb.fitting.alternatives import Alternatives, load_alternatives
from hfb.interop.writers.export_names import (
    CURVES,
    FILE_NAMES,
    NEEDS_BODY,
    PLATE,
    RECORD,
    REPORT,
    RESULT,
    check_formats,
)
from hfb.interop.writers.export_world import describe_world
from hfb.interop.writers.exported import Exported
from hfb.interop.writers.motion_exports import write_motion_file
from hfb.io.atomic import write_bytes_atomic
from hfb.io.media.images.image_io import read_matte, read_picture_srgb, stored_png
from hfb.io.toml_file import to_record
from hfb.motion.motion_file import load_motion
from hfb.motion.sampled import SampledMotion
from hfb.photometry import srgb_to_linear
from hfb.report.pages.result_facts import read_facts
from hfb.report.pages.result_unknown import alternative_motions
from hfb.report.pages.viewer import ViewedMotion, viewer_page
from hfb.tasks.chains.clip_chain import ClipFit
from hfb.tasks.chains.image_chain import ImageFit
from hfb.tasks.core.environment import environment
from hfb.tasks.core.handles import FileHandle
from hfb.tasks.core.result_folder import check_result
from hfb.tasks.inputs.out_place import check_no_clip
from hfb.tasks.results.exports import write_plate
from hfb.tasks.results.resolve_result import find_named_body, load_fitted_body
from hfb.tasks.results.result_report import ReportParts, write_page, write_page_film
from hfb.tasks.results.workspace import beside_result, check_writable, publish, workspace
from hfb.tasks.telemetry.secrets import hidden_in
from hfb.tasks.tracking.run_record import RunRecord, keep_for_later, read_kept
from hfb.typing import Array, Float, Int

_FILES = ("motion.npz", "alternatives.npz", "texture.png", PLATE, "strip.png", CURVES, "edges.json")
_VIEWER_PX = 640
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Viewer:
    """The viewer of a motion: a notebook shows it where it is the last value of a cell.

    Attributes:
        html: a page that is complete in itself.
    """

    html: str

    def _repr_html_(self) -> str:
        """Return the page within a notebook's cell."""
        style = f"width:100%;height:{_VIEWER_PX}px;border:0"
        return f'<iframe srcdoc="{html.escape(self.html)}" style="{style}"></iframe>'


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A fitted motion: R = frames x sub-frames rows in camera coordinates (OpenCV: x right, y down, z forward).

    Arrays are float64 and as in motion.npz, see docs/reference/files.md.

    Attributes:
        motion: all arrays of motion.npz.
        betas_space: whose shape coefficients they are: ``"smpl"``, or ``"hfb"`` (the embedded body's own).
        facts: figures, options, versions and warnings, as in result.json.
        alternatives: other motions that explain the images, with their probabilities; None where none were searched.
    """

    motion: SampledMotion
    betas_space: BetasSpace
    facts: Mapping[str, Any]
    alternatives: Alternatives | None
    _files: Mapping[str, Path]
    _folder: Path | None = None
    _fit: ImageFit | ClipFit | None = None
    _lacks: tuple[str, ...] = ()

    @property
    def poses(self) -> Float[Array, "R 72"]:
        """Axis-angle of 24 joints [rad], SMPL's order, the root first."""
        return self.motion.poses

    @property
    def trans(self) -> Float[Array, "R 3"]:
        """SMPL's translation [m]."""
        return self.motion.trans

    @property
    def betas(self) -> Float[Array, "10"]:
        """Shape coefficients."""
        return self.motion.betas

    @property
    def joints(self) -> Float[Array, "R 24 3"]:
        """Joint positions [m]."""
        return self.motion.joints

    @property
    def times_s(self) -> Float[Array, "R"]:
        """Time since the first shutter opened [s]."""
        return self.motion.times_s

    @property
    def frame_index(self) -> Int[Array, "R"]:
        """The frame of each row, from 0 on."""
        return self.motion.frame_index

    @property
    def radii_mm(self) -> Float[Array, "R 24"]:
        """The joints' median errors about the pelvis [mm] (``joint_radius_mm``); NaN where nothing is known."""
        known = self.motion.joint_radius_mm
        return np.full(self.joints.shape[:2], np.nan) if known is None else known

    @property
    def mattes(self) -> Float[Array, "T H W"]:
        """The person's share of each pixel, as the fit's last stage used it; of a clip none."""
        names = sorted((name for name in self._files if name.startswith("matte_")), key=lambda one: int(one[6:-4]))
        return np.stack([read_matte(self._files[name]) for name in names]) if names else np.zeros((0, 0, 0), np.float32)

    @property
    def texture_linear(self) -> Float[Array, "A A 3"]:
        """The person's texture in linear light, with 8 bits of sRGB."""
        return srgb_to_linear(read_picture_srgb(self._files["texture.png"]))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Signs that the result is wrong, one sentence each."""
        return tuple(name_parameters(one["message"]) for one in self.facts.get("warnings") or ())

    @property
    def gaps(self) -> tuple[tuple[int, int], ...]:
        """First and last frame of every stretch of a clip without a pose; they have no rows."""
        return tuple((first, last) for first, last in self.facts.get("gaps") or ())

    @property
    def missed(self) -> dict[int, str]:
        """Frame of a clip -> why no body was found in it: it lies in a gap, or its neighbours stand in."""
        return {one["frame"]: one["reason"] for one in self.facts.get("missed") or ()}

    @cached_property
    def body(self) -> Body:
        """The body model that was fitted.

        Raises:
            InputError: it is the user's own, and its file is gone or another one.
        """
        if self._fit is not None:
            own = self._fit.inputs.body
            return load_any_body(own.path if own else None)
        path = find_named_body(self._folder / RESULT) if self._folder else None
        return load_fitted_body(self.motion, self.betas_space, path)

    def save(self, folder: str | Path) -> Path:
        """Write the result's folder, which `hfb.load_result` and the commands that take a result read.

        An earlier result of hfb there is replaced; other files are never. Its record.json says what ran on which
        inputs: `hfb record` puts it into MLflow, `hfb rerun` repeats it where all inputs were files.

        Args:
            folder: a new folder, or that of an earlier result.

        Returns:
            the folder.

        Raises:
            InputError: the folder cannot be written, or files that hfb did not write are in the way.
        """
        out = path_of(folder)
        facts = {**self.facts, "out": str(out.resolve()), "strip": str(out.resolve() / "strip.png"), "report": None}
        with errors_of_calls():
            check_no_clip(out)
            with workspace(out, keep=False), tempfile.TemporaryDirectory() as private:
                files, record = dict(self._files), self._record(facts)
                if self._fit is not None:
                    files[PLATE] = write_plate(self._fit.shot.clip, Path(private) / PLATE)
                if record is not None:
                    files[RECORD] = keep_for_later(record, Path(private)).path
                publish(out, files, facts)
        return out

    def _record(self, facts: dict[str, Any]) -> RunRecord | None:
        """Return the record that waits for MLflow; None of a result that was recorded, or whose record is gone."""
        if self._fit is not None:
            return self._fit.record(self._fit.files(), facts, self._lacks)
        if self._folder is None or not (self._folder / RECORD).is_file():
            return None
        kept = read_kept(self._folder)
        return kept.model_copy(update={"name": Path(facts["out"]).name, "contents": kept.contents | {RESULT: facts}})

    def report(self, folder: str | Path | None = None) -> Path:
        """Write report.html: the result on one page that opens anywhere.

        Args:
            folder: of the page; the result's own where it was loaded, else the working directory.

        Raises:
            InputError: the folder cannot be written, or a file that hfb did not write is in the way.
        """
        target = self._beside(folder, "")
        with errors_of_calls(), beside_result(target, [REPORT]) as made, tempfile.TemporaryDirectory() as private:
            film = None
            if self._fit is not None:
                shot = self._fit.shot
                film = FileHandle.of(write_page_film(shot.load(), shot.motion.sha256, Path(private)))
            known = {name: FileHandle.of(path) for name, path in self._files.items() if name in _FILES}
            parts = ReportParts.among(known, film).in_folder(target)
            name = target.resolve().name
            write_page(parts, self.body, hidden_in(self.facts), environment(), path=made / REPORT, name=name)
        return target / REPORT

    def export(
        self, *formats: str, folder: str | Path | None = None, csv_frame: CsvFrame = "camera", fps: float = 24.0
    ) -> list[Path]:
        """Write motion files for other programs, in world coordinates; it is said where the camera is taken as level.

        Args:
            *formats: ``"glb"``, ``"bvh"``, ``"amass"``, ``"csv"``, ``"trc"``, ``"c3d"``, ``"usd"``, ``"fbx"``
                or ``"abc"``.
            folder: where they go; ``export`` in the result's own folder where it was loaded, else in the working
                directory.
            csv_frame: coordinates in joints.csv.
            fps: frames per second of the program that opens motion.glb.

        Returns:
            the files, in the order of the formats; the background that motion.glb names lies beside it.

        Raises:
            InputError: a format is unknown or its library missing, or the folder cannot be written.
        """
        if unknown := [form for form in formats if form not in FILE_NAMES]:
            close = difflib.get_close_matches(unknown[0], list(FILE_NAMES), n=1) or list(FILE_NAMES)
            raise InputError(f"unknown format {unknown[0]}; did you mean {' or '.join(close)}?")
        known = [cast(MotionFormat, form) for form in formats]
        check_formats(known)
        target = self._beside(folder, "export")
        png = stored_png(self._files["texture.png"]) if "texture.png" in self._files else None
        fps = to_record(ExportConfig, {"fps": fps}, "export").fps
        plate = [PLATE] if set(known) & set(NEEDS_BODY) and (PLATE in self._files or self._fit) else []
        exported = Exported(
            self.motion,
            self.betas_space,
            self.body,
            png,
            csv_frame=csv_frame,
            fps=fps,
            plate=plate[0] if plate else None,
        )
        with errors_of_calls(), beside_result(target, [*(FILE_NAMES[form] for form in known), *plate]) as made:
            for form in known:
                write_motion_file(made, form, exported)
            if plate and self._fit is not None:
                write_plate(self._fit.shot.clip, made / PLATE)
            elif plate:
                write_bytes_atomic(made / PLATE, stored_png(self._files[PLATE]))
        if (world := describe_world(self.motion)).doubtful:
            _log.warning(name_parameters(world.says))
        return [target / FILE_NAMES[form] for form in known]

    def show(self) -> Viewer:
        """Return the motion and its alternatives in the 3D viewer, which a notebook displays."""
        motions = [ViewedMotion("as fitted", self.motion)]
        if self.alternatives is not None:
            motions += alternative_motions(self.motion, self.alternatives)
        png = stored_png(self._files["texture.png"]) if "texture.png" in self._files else None
        return Viewer(viewer_page(motions, self.body, png, "Human from Blur"))

    def _beside(self, folder: str | Path | None, name: str) -> Path:
        """Return where further files go."""
        target = path_of(folder) if folder is not None else (self._folder or Path.cwd()) / name
        with errors_of_calls():
            check_writable(target)
        return target

    def __repr__(self) -> str:
        frames = len(set(self.frame_index.tolist()))
        figures = {"matte_iou": ".3f", "psnr_db": ".1f"}
        said = [f"{name} {self.facts[name]:{form}}" for name, form in figures.items() if self.facts.get(name)]
        said += [f"{len(self.warnings)} warnings"] if self.warnings else []
        return f"Result({', '.join([f'{frames} frames x {len(self.poses) // frames} sub-frames', *said])})"


def load_result(folder: str | Path) -> Result:
    """Read a result that `Result.save`, `hfb fit` or `hfb video` left.

    Args:
        folder: of the result.

    Raises:
        InputError: there is no finished result, or a file of it is damaged.
    """
    place = path_of(folder)
    if not place.is_dir():
        raise InputError(f"there is no folder {place}: give that of a result")
    check_result(place, _FILES)
    facts = read_facts(place / RESULT)
    motion, space = load_motion(place / "motion.npz")
    if space not in get_args(BetasSpace):
        raise InputError(
            f"{place / 'motion.npz'} has betas of {space!r}, which no body model has: make the result again"
        )
    names = [*_FILES, *(name for name in facts.get("files") or () if str(name).startswith("matte_"))]
    files = {name: place / name for name in names if (place / name).is_file()}
    others = load_alternatives(place / "alternatives.npz")[0] if "alternatives.npz" in files else None
    return Result(motion, cast(BetasSpace, space), facts, others, files, place)


def result_of(fit: ImageFit | ClipFit, private: Path, lacks: tuple[str, ...]) -> Result:
    """Return the result of a fit whose files lie in a private folder.

    Args:
        fit: the fit.
        private: the folder; it is removed with the result.
        lacks: see `hfb.tasks.tracking.recipe.Recipe`.
    """
    files = {name: file.path for name, file in fit.files().items()}
    motion, space = load_motion(files["motion.npz"])
    others = load_alternatives(files["alternatives.npz"])[0] if "alternatives.npz" in files else None
    facts = fit.facts() | describe_world(motion).entries()
    result = Result(motion, cast(BetasSpace, space), facts, others, files, None, fit, lacks)
    weakref.finalize(result, shutil.rmtree, private, ignore_errors=True)
    return result
