"""Read result.json back: entries that pages and commands use are checked for their types."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hfb.errors import InputError
from hfb.io.json_file import read_json

_Figure = Annotated[float, Field(ge=-1e12, le=1e12)] | None
_Frame = Annotated[int, Field(ge=0, le=10**9)]
_Count = _Frame | None
_Span = Annotated[list[_Frame], Field(min_length=2, max_length=2)]
_Text = Annotated[str, Field(max_length=20_000)]
_Share = Annotated[float, Field(ge=0, le=1)] | None


class _Stored(BaseModel):
    """A record with further entries allowed: every version adds some."""

    model_config = ConfigDict(strict=True, extra="ignore")


class _Direction(_Stored):
    right: dict[str, _Share] = {}


class _Warning(_Stored):
    message: _Text


class _Figures(_Stored):
    matte_iou: _Figure = None
    psnr_db: _Figure = None
    foot_skate_mm: _Figure = None
    mpjpe_mm: _Figure = None
    iou: _Figure = None
    seconds: _Figure = None
    fit_seconds: _Figure = None
    frames: _Count = None
    sub_frames: _Count = None
    gaps: list[_Span] | None = None
    warnings: list[_Warning] | None = None
    out: _Text | None = None
    mlflow_run_id: _Text | None = None


class _Person(_Figures):
    name: _Text
    error: _Text | None = None


class _Facts(_Figures):
    filled: list[_Frame] | None = None
    directions: list[_Direction] | None = None
    remarks: list[_Text] | None = None
    people: list[_Person] | None = None
    background: _Text | None = None
    unknown: _Text | None = None
    mlflow_link: _Text | None = None
    config: dict[str, Any] | None = None
    inputs: dict[str, str] | None = None


def read_facts(path: Path, root: Path | None = None) -> dict[str, Any]:
    """Read and validate a result.json.

    Args:
        path: the file.
        root: see `hfb.io.json_file.read_json`.

    Raises:
        InputError: it is missing, damaged, or an entry that hfb uses has another type.
    """
    content = read_json(path, root=root)
    if not isinstance(content, dict):
        raise InputError(f"{path} is not a result of hfb: give the folder of one")
    try:
        _Facts.model_validate(content)
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"]))[:80]
        raise InputError(f"{path} is damaged ({where} is not what hfb writes): make the result again") from None
    return content
