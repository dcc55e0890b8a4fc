"""Charts of curves.json for a result's page.

``losses``: term -> a value per iteration, of a fit of one problem. ``windows``: per window of a clip its ``frames`` and
``total``, the weighted sum per iteration. ``frames``: figure -> [frame, value] pairs.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hfb.errors import InputError
from hfb.io.json_file import read_json
from hfb.report.pages.charts import frames_chart, loss_chart, window_chart

_LABELS = {"matte_iou": "IoU with the matte", "psnr_db": "PSNR of the re-blurred frame [dB]", "mpjpe_mm": "error [mm]"}

_MOST_TERMS, _MOST_FIGURES, _MOST_STAGES = 200, 20, 100
_MOST_VALUES = 1 << 24  # of all windows: a table of windows times iterations
_Value = Annotated[float, Field(ge=-1e30, le=1e30)]
_Name = Annotated[str, Field(max_length=80)]
_Loss = Annotated[list[_Value | None], Field(max_length=10**6)]
_FrameValue = tuple[Annotated[int, Field(ge=0, le=10**9)], _Value]


class _Stored(BaseModel):
    model_config = ConfigDict(extra="ignore")


class _Window(_Stored):
    total: list[_Value] = []


class _Curves(_Stored):
    losses: Annotated[dict[_Name, _Loss], Field(max_length=_MOST_TERMS)] = {}
    windows: list[_Window] = []
    frames: Annotated[
        dict[_Name, Annotated[list[_FrameValue], Field(max_length=10**6)]], Field(max_length=_MOST_FIGURES)
    ] = {}


def read_curves(path: Path) -> dict[str, Any]:
    """Read and validate a curves.json.

    Args:
        path: the file.

    Raises:
        InputError: it is missing, damaged, or holds no curves.
    """
    content = read_json(path)
    try:
        curves = _Curves.model_validate(content)
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"]))[:80]
        raise InputError(
            f"{path} holds no curves of hfb ({where or 'it'} is something else): make the result again"
        ) from None
    if len(curves.windows) * max((len(one.total) for one in curves.windows), default=0) > _MOST_VALUES:
        raise InputError(f"{path} holds no curves of hfb (windows of too many iterations): make the result again")
    return curves.model_dump()


def curve_charts(curves: Mapping[str, Any], facts: Mapping[str, Any]) -> list[tuple[bytes, str]]:
    """Return charts of the losses and of the scores per frame, each with its caption.

    Args:
        curves: content of curves.json.
        facts: content of result.json; its configuration gives the stages.
    """
    shown = []
    if curves.get("losses"):
        caption = (
            "Every term of the objective as it is, and their weighted sum; dotted where the pictures become larger."
        )
        shown.append((loss_chart(curves["losses"], _iterations(facts)), caption))
    windows = [one["total"] for one in curves.get("windows", ()) if one.get("total")]
    if windows:
        caption = f"The weighted sum of the objective in the {len(windows)} windows of the clip."
        shown.append((window_chart(windows), caption))
    for name, pairs in sorted(curves.get("frames", {}).items()):
        values = {int(frame): float(value) for frame, value in pairs}
        if len(values) > 1:
            label = _LABELS.get(name, name)
            shown.append((frames_chart(values, label), f"{label}, frame by frame."))
    return shown


def _iterations(facts: Mapping[str, Any]) -> list[int]:
    """Return the iterations of every stage in the configuration."""
    config = facts.get("config")
    fit = config.get("fit") if isinstance(config, Mapping) else None
    stages = fit.get("stages") if isinstance(fit, Mapping) else None
    counts = [one.get("iterations") for one in stages if isinstance(one, Mapping)] if isinstance(stages, list) else []
    known = [count for count in counts if isinstance(count, int) and 0 <= count <= 10**6]
    return known if len(known) == len(counts) <= _MOST_STAGES else []
