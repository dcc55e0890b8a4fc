"""report.html: one result as one self-contained page."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hfb.body.model import Body
from hfb.fitting.alternatives import Alternatives
from hfb.interop.writers.export_names import LINKED_FILES
from hfb.io.media.images.image_decoding import decode_picture
from hfb.motion.footing import foot_contacts
from hfb.motion.sampled import SampledMotion
from hfb.report.pages.page import checked_picture, page
from hfb.report.pages.result_curves import curve_charts
from hfb.report.pages.result_speeds import advice, speeds_table
from hfb.report.pages.result_unknown import alternative_motions, alternatives_table, unknown_sentences
from hfb.report.pages.viewer import ViewedMotion, viewer, viewer_scripts

_STRIP_WIDTH_PX, _KEPT_BYTES = 2600, 1 << 20
_MOST_ROWS, _LONGEST_WORDS = 5000, 2000
_FIGURES = (
    ("IoU with the matte", "matte_iou", ".3f", ""),
    ("picture explained", "psnr_db", ".1f", " dB PSNR"),
    ("error (MPJPE)", "mpjpe_mm", ".1f", " mm"),
    ("IoU with the truth", "iou", ".3f", ""),
    ("sliding of standing feet", "foot_skate_mm", ".1f", " mm per exposure"),
    ("frames", "frames", "d", ""),
    ("sub-frames", "sub_frames", "d", ""),
    ("fit", "fit_seconds", ".1f", " s"),
    ("whole run", "seconds", ".0f", " s"),
)
_PLACES = frozenset(
    {"config", "inputs", "directions", "unknown", "mlflow_link", "mlflow_run_id", "out", "strip", "report", "code"}
)


@dataclass(frozen=True)
class ResultContents:
    """Contents of a result's page; missing parts are left out of the page or marked as missing.

    Attributes:
        facts: the content of result.json.
        motion: fitted motion.
        body: None where a user's model is not available; the page then shows a skeleton.
        strip: file of the image strip.
        curves: the content of curves.json.
        film: an H.264 film at most 640 px wide.
        film_caption: what the film shows.
        environment: versions and machine by name.
        repeat: the command that repeats the run; None where it was not recorded.
        beside: names of the files beside the page, of `LINKED_FILES`.
    """

    title: str
    facts: Mapping[str, Any]
    motion: SampledMotion
    body: Body | None
    texture_png: bytes | None = None
    strip: Path | None = None
    alternatives: Alternatives | None = None
    curves: Mapping[str, Any] = field(default_factory=dict)
    film: bytes | None = None
    film_caption: str = ""
    environment: Mapping[str, str] = field(default_factory=dict)
    repeat: str | None = None
    beside: tuple[str, ...] = ()


def result_page(contents: ResultContents) -> str:
    """Render the page; everything that comes from names, options and files is escaped.

    Args:
        contents: all parts.
    """
    motions = [ViewedMotion("as fitted", contents.motion)]
    if contents.alternatives is not None:
        motions += alternative_motions(contents.motion, contents.alternatives)
    facts = contents.facts
    return page(
        "result.html",
        contents.title,
        figures=_figures(facts),
        warnings=_warnings(facts),
        remarks=_remarks(facts),
        strip=None if contents.strip is None else _strip(contents.strip),
        body=contents.body,
        viewer=viewer(motions, contents.body, contents.texture_png),
        film=contents.film,
        film_caption=contents.film_caption,
        speeds=speeds_table(contents.motion),
        standing=foot_contacts(contents.motion).T.tolist(),
        advice=advice(contents.motion, facts),
        unknown=unknown_sentences(contents.motion, contents.body, facts),
        alternatives=alternatives_table(contents.alternatives),
        curves=curve_charts(contents.curves, facts),
        repeat=contents.repeat,
        beside=[(name, LINKED_FILES[name]) for name in contents.beside],
        link=facts["mlflow_link"] if isinstance(facts.get("mlflow_link"), str) else None,
        made_from=_made_from(contents),
        scripts=viewer_scripts(),
    )


def _strip(path: Path) -> tuple[bytes, int, int]:
    """Return the strip with the width and height of one half of it; a narrow page has one below the other."""
    content = checked_picture(path, _STRIP_WIDTH_PX, _KEPT_BYTES)
    height, width = decode_picture(path, data=content).pixels.shape[:2]
    return content, width, 2 * height


def _figures(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [
        (format(facts[key], form) + unit, label)
        for label, key, form, unit in _FIGURES
        if isinstance(facts.get(key), int | float)
    ]


def _warnings(facts: Mapping[str, Any]) -> list[str]:
    warnings = facts.get("warnings")
    said = [one.get("message") for one in (warnings if isinstance(warnings, list) else []) if isinstance(one, Mapping)]
    return [one for one in said if isinstance(one, str)]


def _remarks(facts: Mapping[str, Any]) -> list[str]:
    remarks, world = facts.get("remarks"), facts.get("world")
    says = world.get("says") if isinstance(world, Mapping) else None
    of_exports = says[:1].upper() + says[1:] if isinstance(says, str) else None
    said = [facts.get("background"), of_exports, *(remarks if isinstance(remarks, list) else [])]
    return [one for one in said if isinstance(one, str)]


def _made_from(contents: ResultContents) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return tables of options, inputs and versions under their headings."""
    facts = contents.facts
    config, inputs = facts.get("config"), facts.get("inputs")
    return [
        ("Inputs (sha256)", _flat(inputs if isinstance(inputs, Mapping) else {})),
        ("Options", _flat(config if isinstance(config, Mapping) else {})),
        ("Versions and machine", [("code", str(facts.get("code", "unknown"))), *contents.environment.items()]),
        ("All figures", _flat({name: value for name, value in facts.items() if name not in _PLACES})),
    ]


def _flat(content: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return nested values with dotted names."""
    rows: list[tuple[str, str]] = []
    for name, value in content.items():
        if isinstance(value, list) and any(isinstance(one, Mapping) for one in value):
            value = {str(number): one for number, one in enumerate(value)}
        if isinstance(value, Mapping) and value:
            rows += _flat(value, f"{prefix}{name}.")
        else:
            rows.append((f"{prefix}{name}", _shown(value)[:_LONGEST_WORDS]))
        if len(rows) > _MOST_ROWS:
            return [*rows[:_MOST_ROWS], ("...", "the rest is in result.json")]
    return rows


def _shown(value: Any) -> str:
    """Return a value as a reader writes it: no brackets, no long fractions."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return ", ".join(map(_shown, value)) or "-"
    return "-" if value is None else str(value)
