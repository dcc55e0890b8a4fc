"""What hfb does with a file of each kind before it believes anything of it."""

from collections.abc import Callable
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

from hfb.body.assets import load_default_body
from hfb.body.smpl_file import read_smpl
from hfb.config import CameraConfig, RunConfig
from hfb.datasets.case import Case, load_case
from hfb.datasets.motions.folder import FolderMotions
from hfb.datasets.real.markers import read_joints_npz, read_trc
from hfb.datasets.real.source_videos import _timing
from hfb.datasets.synthetic.sharp import load_sharp
from hfb.datasets.truth import load_truth_of
from hfb.evaluation.baselines.chain_spec import read_chains
from hfb.evaluation.baselines.stored_poses import read_estimates
from hfb.initialization.network_body import read_samplings
from hfb.interop.readers.sniff import read_tracks
from hfb.io.clip import ClipCamera, read_clip
from hfb.io.media.footage import open_footage
from hfb.io.media.images.image_io import picture_size, read_matte, read_picture_srgb, recorded_exposure
from hfb.io.media.lens.camera_files import read_calibration
from hfb.io.media.lens.camera_pose import clip_world
from hfb.io.media.lens.clip_lens import clip_lens
from hfb.io.media.video.video_reading import read_frames
from hfb.io.toml_file import read_toml, to_record
from hfb.matting.user_networks.external import weights_of
from hfb.motion.motion_file import load_motion
from hfb.motion.static_pose import load_first_body
from hfb.networks.runtimes import load_network
from hfb.priors.load import load_pose_prior
from hfb.priors.motion_weights import read_networks
from hfb.tasks.batch.batch_ledger import Ledger
from hfb.tasks.inputs.clip_places import resolve_source
from hfb.tasks.results.stored_runs import _id_in
from hfb.tasks.tracking.recipe import read_recipe
from hfb.tracking.tracks import ClipFrames, read_track, read_track_names
from tests.fuzz.results import RESULT_READERS

_SHARP = {"sharp": [[0, 0, 32, 24]], "camera": {"height": 48, "width": 64}}
_body = lru_cache(maxsize=1)(load_default_body)


def _footage(path: Path) -> None:
    footage = open_footage(path)
    for _ in footage.frames(0, min(3, footage.count)):
        pass
    for _ in footage.chosen(sorted({0, footage.count - 1})):
        pass


def _frames(path: Path) -> None:
    for _ in islice(read_frames(path), 3):
        pass


def _motions(path: Path) -> None:
    source = FolderMotions(path.parent)
    for number in range(len(source.names())):
        source.load(number)


def _markers(path: Path) -> Any:
    return read_trc(path) if path.suffix == ".trc" else read_joints_npz(path)


def _pose(path: Path) -> Any:
    return clip_world(CameraConfig(), ClipCamera(calibration=path), "cam01_walk.mp4")


def _lens(path: Path) -> Any:
    return clip_lens(ClipCamera(calibration=path), "cam01_walk.mp4", 480, 640)


_CLIP = ClipFrames(12, height=90, width=160)

READERS: dict[str, tuple[Callable[[Path], Any], ...]] = {
    "picture": (read_picture_srgb, picture_size, recorded_exposure, read_matte),
    "sharp": (lambda path: load_sharp(Case(path.parent, 1, 1, 0.0, _SHARP), 0),),
    "video": (_footage, _frames, lambda path: _timing(path, None)),
    "clip": (read_clip, lambda path: resolve_source(path, None)),
    "options": (lambda path: to_record(RunConfig, read_toml(path), str(path)),),
    "calibration": (read_calibration, _lens, _pose),
    "tracks": (
        lambda path: read_track(path, None, ClipFrames(12)),
        lambda path: read_track_names(path, ClipFrames(12)),
    ),
    "chains": (read_chains,),
    "markers": (_markers,),
    "motion": (load_motion,),
    "motions": (_motions,),
    "first body": (load_first_body,),
    "truth": (load_truth_of,),
    "stored poses": (lambda path: read_estimates(path, 1, _body()),),
    "result": (lambda path: read_tracks([path], 480, 640),),
    "body": (read_smpl,),
    "sampling": (read_samplings,),
    "pose prior": (load_pose_prior,),
    "motion prior": (read_networks,),
    "weights": (weights_of,),
    "network": (load_network,),
    "recipe": (lambda path: read_recipe(path, "abcd"),),
    "ledger": (Ledger,),
    "own result": (lambda path: _id_in(path.parent),),
    "case": (lambda path: load_case(path.parent),),
    **RESULT_READERS,
}
"""Kind of file -> everything that opens one."""
