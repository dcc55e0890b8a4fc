"""A list of everything that can be plugged into hfb: shipped or not, its licence, and its source.

Light to import, offline.
"""

from dataclasses import asdict, dataclass

from hfb.networks.mediapipe_files import list_networks

_SMPL_LICENCE = "free for research, by registration (SMPL-Model licence)"


@dataclass(frozen=True)
class KnownModel:
    """One row of `hfb models list`.

    Attributes:
        use: the option that takes it.
        present: None where it is a file of the user's, named at each run.
    """

    name: str
    role: str
    use: str
    licence: str
    get: str
    present: bool | None

    def as_dict(self) -> dict[str, str | bool | None]:
        """Return the row as plain values, for `--json`."""
        return asdict(self)


_SHIPPED = (
    KnownModel("hfb matting", "matte", "--matting network", "Apache-2.0", "shipped with hfb", True),
    KnownModel("hfb joints", "joints in the blur", "--fit.weights.joints", "Apache-2.0", "shipped with hfb", True),
    KnownModel("hfb body", "body", "no option", "CC0-1.0 (MakeHuman's assets)", "shipped with hfb", True),
)
_BROUGHT = (
    KnownModel(
        "SMPL", "body", "--body.model FILE", _SMPL_LICENCE, "https://smpl.is.tue.mpg.de, a .npz or .pkl as it is", None
    ),
    KnownModel(
        "BackgroundMattingV2",
        "matte, the paper's",
        "--matting bgmv2 --matting-weights FILE",
        "MIT",
        "https://github.com/PeterL1n/BackgroundMattingV2, its TorchScript, weights (.pth) or .onnx as released",
        None,
    ),
    KnownModel(
        "Robust Video Matting",
        "matte",
        "--matting rvm --matting-weights FILE",
        "GPL-3.0",
        "https://github.com/PeterL1n/RobustVideoMatting, its .torchscript or .onnx as released",
        None,
    ),
    KnownModel(
        "METRO",
        "first body, the paper's",
        "--init metro --init-weights FILE",
        "MIT (its code)",
        "https://github.com/microsoft/MeshTransformer, exported with torch.jit.trace(model, picture).save(FILE)",
        None,
    ),
    KnownModel(
        "RTMPose, RTMW",
        "first body",
        "--init keypoints --init-weights FILE",
        "Apache-2.0",
        "https://github.com/open-mmlab/mmpose, projects/rtmpose: its ONNX with outputs simcc_x and simcc_y",
        None,
    ),
    KnownModel(
        "ViTPose",
        "first body",
        "--init keypoints --init-weights FILE",
        "Apache-2.0",
        "https://github.com/ViTAE-Transformer/ViTPose, exported as ONNX with its heatmaps as the output",
        None,
    ),
    KnownModel(
        "SMPLify's GMM",
        "pose prior",
        "--prior.pose FILE",
        "free for research, by registration",
        "https://smplify.is.tue.mpg.de, gmm_08.pkl",
        None,
    ),
    KnownModel(
        "VPoser",
        "pose prior",
        "--prior.pose FILE",
        "free for research, by registration",
        "https://smpl-x.is.tue.mpg.de, a checkpoint of version 1 or 2",
        None,
    ),
    KnownModel(
        "results of PyMAF, HybrIK, PHALP / 4D-Humans, WHAM, TRAM, GVHMR, SAM 3D Body, NLF, AMASS, 3D joints, hfb",
        "first body",
        "--init FILE",
        "those of the systems",
        "run the system; give the file that it writes",
        None,
    ),
)


def list_models() -> list[KnownModel]:
    """List the usable models, the shipped ones first."""
    fetched = [
        KnownModel(f"MediaPipe {one.name}", "first body", "--init mediapipe", one.licence, one.get, one.present)
        for one in list_networks()
    ]
    return [*_SHIPPED, *fetched, *_BROUGHT]
