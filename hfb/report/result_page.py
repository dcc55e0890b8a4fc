"""report.html: one result on one page that opens anywhere, from the pictures to the command that repeats it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hfb.body.model import Body
from hfb.fitting.alternatives import Alternatives
from hfb.motion.sampled import SampledMotion
from hfb.report.page import Html, checked_picture, element, film, folded, joined, page, picture, section, table
from hfb.report.result_curves import curves_section
from hfb.report.result_speeds import advice_section, speeds_section
from hfb.report.result_unknown import alternative_motions, alternatives_section, unknown_section
from hfb.report.viewer import ViewedMotion, viewer, viewer_scripts

_STRIP_WIDTH_PX, _KEPT_BYTES = 2600, 1 << 20
_MOST_ROWS, _LONGEST_WORDS = 5000, 2000
_FIGURES = (
    ("IoU with the matte", "matte_iou", ".3f", ""), ("picture explained", "psnr_db", ".1f", " dB PSNR"),
    ("error (MPJPE)", "mpjpe_mm", ".1f", " mm"), ("IoU with the truth", "iou", ".3f", ""),
    ("frames", "frames", "d", ""), ("sub-frames", "sub_frames", "d", ""),
    ("fit", "fit_seconds", ".1f", " s"), ("whole run", "seconds", ".0f", " s"),
)  # fmt: skip
_PLACES = frozenset(
    {"config", "inputs", "directions", "unknown", "mlflow_link", "mlflow_run_id", "out", "strip", "report", "code"}
)


@dataclass(frozen=True)
class ResultContents:
    """What a result's page is made of; whatever is not there is left out of it, or said to be missing.

    Attributes:
        facts: the content of result.json.
        motion, body: body None where a user's model is not at hand: a skeleton is shown then.
        strip: the file of the paper's strip of pictures.
        curves: the content of curves.json.
        film: an H.264 film that browsers play, at most 640 px wide, with what it shows.
        environment: versions and machine by name.
        repeat: the command that repeats the run; None where it was not recorded.
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


def result_page(contents: ResultContents) -> str:
    """The page; everything that comes from names, options and files is escaped."""
    motions = [ViewedMotion("as fitted", contents.motion)]
    if contents.alternatives is not None:
        motions += alternative_motions(contents.motion, contents.alternatives)
    parts = [
        _head(contents),
        _strip(contents.strip),
        section("The body in 3D", _told(contents), viewer(motions, contents.body, contents.texture_png), id="body"),
        _film(contents),
        speeds_section(contents.motion),
        advice_section(contents.motion, contents.facts),
        unknown_section(contents.motion, contents.body, contents.facts),
        alternatives_section(contents.alternatives),
        curves_section(contents.curves, contents.facts),
        _made_from(contents),
    ]
    return page(contents.title, *parts, scripts=viewer_scripts())


def _head(contents: ResultContents) -> Html:
    facts = contents.facts
    items = [
        element("li", element("b", format(facts[key], form) + unit), element("span", label))
        for label, key, form, unit in _FIGURES
        if isinstance(facts.get(key), int | float)
    ]
    remarks = facts.get("remarks")
    said = [facts.get("background"), *(remarks if isinstance(remarks, list) else [])]
    lines = [element("p", f"{one}.", class_="muted") for one in said if isinstance(one, str)]
    warnings = facts.get("warnings")
    wrong = [one.get("message") for one in (warnings if isinstance(warnings, list) else []) if isinstance(one, Mapping)]
    told = [element("p", f"Warning: {one}.", class_="bad") for one in wrong if isinstance(one, str)]
    return joined([element("ul", *items, class_="figures-line"), *told, *lines])


def _strip(strip: Path | None) -> Html | None:
    if strip is None:
        return None
    content = checked_picture(strip, _STRIP_WIDTH_PX, _KEPT_BYTES)
    alt = "input, matte, sub-frames, re-blurred, residual, from the side"
    return section(
        "What was seen, and how it is explained",
        picture(content, alt, wide=True),
        element(
            "p", "Input, matte, the body at instants of the exposure (blue first, orange last), the blur that its "
            "motion makes, what that leaves unexplained, and the bodies from the side.", class_="muted",
        ),
        id="strip",
    )  # fmt: skip


def _told(contents: ResultContents) -> Html:
    words = "Drag to look from another side; the slider goes through the sub-frames."
    if contents.body is None:
        words += " The body model that was fitted is not at hand, so its skeleton is shown."
    elif contents.body.pose_directions is not None:
        words += " The surface is shown without the model's pose correctives."
    return element("p", words, class_="muted")


def _film(contents: ResultContents) -> Html:
    if contents.film is None:
        command = "hfb export RESULT --films slowmotion"
        return section("Slow motion", element("p", "There is no film here: ", element("code", command), " draws one."))
    return section("Slow motion", film(contents.film, contents.film_caption), id="film")


def _made_from(contents: ResultContents) -> Html:
    facts, parts = contents.facts, []
    if contents.repeat is not None:
        parts += [element("p", "The same again, and how far it is from this:"), element("pre", contents.repeat)]
    else:
        parts += [element("p", "This run was not recorded in MLflow, so no command repeats it.")]
    if isinstance(facts.get("mlflow_link"), str):
        link = facts["mlflow_link"]
        where = element("a", link, href=link, target="_blank", rel="noopener") if _is_page(link) else link
        parts.append(element("p", "In MLflow: ", where))
    config, inputs = facts.get("config"), facts.get("inputs")
    hashes = _flat(inputs) if isinstance(inputs, Mapping) else []
    parts += [
        folded("Inputs (sha256)", table(hashes, classes="long")),
        folded("Options", table(_flat(config if isinstance(config, Mapping) else {}), classes="long")),
        folded(
            "Versions and machine",
            table([("code", str(facts.get("code", "unknown"))), *contents.environment.items()], classes="long"),
        ),
        folded("All figures", table(_flat({k: v for k, v in facts.items() if k not in _PLACES}), classes="long")),
    ]
    return section("Made from", *parts, id="made-from")


def _is_page(link: str) -> bool:
    return link.startswith(("http://", "https://"))


def _flat(content: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested values as dotted names."""
    rows: list[tuple[str, str]] = []
    for name, value in content.items():
        if isinstance(value, Mapping) and value:
            rows += _flat(value, f"{prefix}{name}.")
        else:
            rows.append((f"{prefix}{name}", "-" if value is None else str(value)[:_LONGEST_WORDS]))
        if len(rows) > _MOST_ROWS:
            return [*rows[:_MOST_ROWS], ("...", "the rest is in result.json")]
    return rows
