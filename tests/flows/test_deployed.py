"""The flows that a server starts: what a form asks for reaches the chain, and what is wrong is one sentence."""

from pathlib import Path
from typing import Any

import pytest

from hfb.errors import InputError
from hfb.flows import deployed
from hfb.flows.deployed import Options
from hfb.flows.train_prior import TrainingPlan


def test_a_folder(store: Path, tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    (tmp_path / "clips" / "broken.mp4").write_text("no video")
    told = deployed.batch(tmp_path / "clips", tmp_path / "out", attempts=1, wait_s=0.1)
    assert (told["clips"], told["set_aside"], told["waiting"]) == (1, 1, 0)


def test_a_benchmark(store: Path, tmp_path: Path) -> None:
    told = deployed.benchmark(tmp_path / "out", count=1, methods=["static"], seed=3)
    assert told["count"] == 1
    assert list(told["methods"]) == ["static"]


_MISSING = Path("/nowhere")
_WRONG: dict[str, tuple[Any, dict[str, Any]]] = {
    "/nowhere does not exist": (deployed.fit, {"frames": [_MISSING], "background": _MISSING}),
    "/nowhere": (deployed.video, {"source": _MISSING}),
    "/nowhere is": (deployed.batch, {"folder": _MISSING}),
    "b-aist is made from real video": (deployed.benchmark, {"set": "b-aist"}),
    "safetensors": (deployed.train, {"plan": TrainingPlan(motions=_MISSING, kind="pose")}),
    "unknown option fit.subframe;": (
        deployed.fit,
        {"frames": [_MISSING], "background": _MISSING, "options": Options(fit={"subframe": 3})},
    ),
}


@pytest.mark.parametrize("sentence", _WRONG)
def test_what_is_wrong_is_said_and_nothing_is_left(sentence: str, store: Path, tmp_path: Path) -> None:
    flow, given = _WRONG[sentence]
    with pytest.raises(InputError, match=sentence) as raised:
        flow(out=tmp_path / "out", **given)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "out").exists()
