"""What `import hfb` offers, and what it costs."""

import inspect
import subprocess
import sys

import pytest

import hfb

SIGNATURES = {
    "compose": "(foreground, plate_linear)",
    "evaluate": "(result, truth)",
    "first_body": "(frame, background, *, init=None, matting=None, clip=None, config=None, **options)",
    "fit": "(frames, background, *, init=None, matting=None, prior=None, extra_terms=None, clip=None, config=None, "
    "on_progress=None, **options)",
    "fit_clip": "(video, /, background=None, *, init=None, matting=None, prior=None, extra_terms=None, clip=None, "
    "config=None, on_progress=None, **options)",
    "load_body": "(model=None)",
    "load_result": "(folder)",
    "matte": "(frame, background, *, matting=None, clip=None, config=None, **options)",
    "render": "(result, rows=None, size=None)",
}
"""A change here is a change for everyone who uses hfb as a library: it belongs into CHANGELOG.md."""

RESULT = {
    "alternatives", "betas", "betas_space", "body", "export", "facts", "frame_index", "gaps", "joints", "mattes",
    "missed", "motion", "poses", "radii_mm", "report", "save", "show", "texture_linear", "times_s", "trans", "warnings",
}  # fmt: skip

CLASSES = {
    "Alternatives",
    "Body",
    "FirstBody",
    "Initializer",
    "InputError",
    "Matting",
    "PinholeCamera",
    "PosePrior",
    "Result",
    "TermInputs",
}


def test_the_names_and_signatures() -> None:
    assert set(hfb.__all__) == {*SIGNATURES, *CLASSES, "__version__"}
    assert {name: _plain(getattr(hfb, name)) for name in SIGNATURES} == SIGNATURES
    assert all(inspect.isclass(getattr(hfb, name)) for name in CLASSES)
    assert set(hfb.__all__) <= set(dir(hfb))
    names = {name for name in dir(hfb.Result) if not name.startswith("_")}
    assert names | set(inspect.signature(hfb.Result).parameters) - {"_files", "_folder", "_fit", "_lacks"} == RESULT


def _plain(function: object) -> str:
    """A signature without types."""
    parameters = inspect.signature(function).parameters.values()  # type: ignore[arg-type]
    bare = [one.replace(annotation=inspect.Parameter.empty) for one in parameters]
    return str(inspect.Signature(bare))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="'hfb' has no attribute 'fitt'"):
        hfb.fitt  # noqa: B018


PROGRAM = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"prefect", "mlflow", "rich"} or name == "hfb.flows":
            raise ModuleNotFoundError(f"{name} is not there")
sys.meta_path.insert(0, Absent())
import hfb
print(sorted({"numpy", "torch", "pydantic", "PIL"} & sys.modules.keys()))
result = hfb.fit(
    sys.argv[1], sys.argv[2], init="matte", stages=[{"size_px": 32, "iterations": 1}], subframes=2, texture_px=16,
    settle=1, both_fronts=False, directions={"search": False},
)
result.save("saved")
hfb.load_result("saved").report()
result.export("glb", "amass", "bvh", "csv", "trc")
result.show()
print(sorted({"sympy", "torch._dynamo", "scipy.stats"} & sys.modules.keys()))  # a second and a half for nothing
from PIL import Image
short, frame = [{"size_px": 32, "iterations": 1}], Image.open(sys.argv[1])
clip = hfb.fit_clip(
    [frame, frame], sys.argv[2], init="matte", stages=short, subframes=2, texture_px=16, settle=0, both_fronts=False,
    video={"stages": short, "settle": 0, "person_windows": 1},
)
clip.save("clip")
hfb.load_result("clip").report()
print(sorted({"prefect", "mlflow", "rich", "hfb.flows"} & sys.modules.keys()))
"""


@pytest.mark.integration
def test_nothing_of_prefect_and_mlflow_is_needed(problem, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Where they do not even exist fits run, are saved, read, exported and shown; the import itself loads nothing."""
    words = [sys.executable, "-W", "error::ResourceWarning", "-c", PROGRAM, str(problem.frame), str(problem.background)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:3] == ["[]", "[]", "[]"]
    assert {path.name for path in tmp_path.iterdir()} == {"saved", "export", "clip"}
