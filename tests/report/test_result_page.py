"""report.html in a real browser: it moves, plays, asks for nothing, complains of nothing, and says what it should."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from markupsafe import Markup

from hfb.body.assets import load_default_body
from hfb.fitting.alternatives import LIMB_NAMES, Alternatives
from hfb.geometry.placement import with_floor
from hfb.io.media.video.video_writing import VideoWriter
from hfb.motion.footing import foot_contacts, stand
from hfb.motion.sampled import SampledMotion
from hfb.report.pages.page import page
from hfb.report.pages.result_page import ResultContents, result_page
from hfb.report.pages.result_unknown import alternatives_table, by_probability, reversed_text, unknown_sentences
from hfb.report.pages.viewer import ViewedMotion, viewer, viewer_scripts
from tests.browser import Opened, assert_body_moves, assert_film_plays, browser, new_tab, opened, shows
from tests.interop.writers.motions import motion_of

pytestmark = pytest.mark.integration

BODY = load_default_body()
NASTY = """</script><script>alert(1)</script><b>"'"""
WIDTHS = (600, 1400)


def short_film(path: Path) -> bytes:
    """Two seconds in which something happens."""
    with VideoWriter(path, 30.0, small=True) as writer:
        for number in range(60):
            picture = np.full((120, 160, 3), 0.2)
            picture[20:40, number : number + 30] = 0.9
            writer.write(picture)
    return path.read_bytes()


def weighed(motion: SampledMotion) -> Alternatives:
    """The motion, and two in which limbs run backwards."""
    flipped = np.zeros((3, 3, len(LIMB_NAMES)), bool)
    flipped[1, 0, 4] = flipped[2] = True
    back = slice(None, None, -1)
    return Alternatives(
        reversed_limbs=flipped,
        poses=np.stack([motion.poses, motion.poses, motion.poses[back]]),
        trans=np.stack([motion.trans, motion.trans, motion.trans[back]]),
        joints=np.stack([motion.joints, motion.joints, motion.joints[back]]),
        scores={"loss": np.array([0.5, 0.7, 0.6]), "matte": np.array([0.01, 0.02, 0.03])},
        probability=np.array([0.3, 0.2, 0.5]),
        chosen=0,
        frame_index=motion.frame_index,
    )


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with everything on it, and names that want to break it."""
    folder = tmp_path_factory.mktemp(NASTY.replace("/", "_"))
    motion = motion_of(BODY)
    texture = np.zeros((8, 8, 3), np.uint8) + np.array([40, 90, 200], np.uint8)
    cv2.imwrite(str(folder / "strip.png"), np.full((60, 3000, 3), 128, np.uint8))
    facts = {
        "matte_iou": 0.61,
        "frames": 3,
        "fit_seconds": 3.25,
        "remarks": [NASTY],
        "gaps": [[5, 9]],
        "filled": [1, 2, 4],
        "mlflow_link": "javascript:alert(1)",
        "mlflow_run_id": NASTY,
        "unknown": NASTY,
        "inputs": {NASTY: NASTY},
        "config": {"init": {"file": NASTY}, "fit": {"stages": [{"iterations": 3}, {"iterations": 2}]}},
        "directions": [{"right": {"body": 0.61}}],
        "warnings": [{"code": "matte_iou", "value": 0.5, "frames": [1], "message": f"the body is off {NASTY}"}],
    }
    contents = ResultContents(
        title=NASTY,
        facts=facts,
        motion=motion,
        body=BODY,
        texture_png=cv2.imencode(".png", texture)[1].tobytes(),
        strip=folder / "strip.png",
        alternatives=weighed(motion),
        curves={
            "losses": {"total": [3.0, 2.0, 4.0, 1.0, 0.5], NASTY: [1.0, None, 0.0, 2.0, 1.0]},
            "windows": [{"total": [2.0, 1.0]}, {"total": [3.0]}],
            "frames": {NASTY: [[0, 1.0], [2, 0.5]]},
        },
        film=short_film(folder / "film.mp4"),
        film_caption=NASTY,
        environment={NASTY: NASTY},
        repeat=f"hfb {NASTY}",
    )
    path = folder / f"{NASTY.replace('/', '_')}.html"
    path.write_text(result_page(contents))
    return path


def test_the_page_lives_at_every_width(report: Path) -> None:
    with browser() as chromium:
        for width in WIDTHS:
            shown = opened(chromium, report.as_uri(), width)
            assert shown.tab.locator(".viewer").get_attribute("data-drawing") == "surface"
            assert_body_moves(shown.tab)
            assert_film_plays(shown.tab)
            assert_readable(shown)
            assert_strip_is_whole(shown)
            assert shown.requests == []
            assert shown.errors == []
            assert shown.tab.locator("script:not([type])").count() == len(viewer_scripts())
            assert shown.tab.title() == NASTY
            shown.tab.close()


def assert_readable(shown: Opened) -> None:
    """Nothing is wider than the page but what scrolls by itself, and letters have a size."""
    wide = shown.tab.evaluate("[document.documentElement.scrollWidth, document.documentElement.clientWidth]")
    assert wide[0] <= wide[1]
    sizes = shown.tab.evaluate(
        "[...document.querySelectorAll('p, li, td, th, summary')]"
        ".map((one) => parseFloat(getComputedStyle(one).fontSize))"
    )
    assert min(sizes) >= 13


def assert_strip_is_whole(shown: Opened) -> None:
    """Both halves of the strip lie within the page, undistorted: side by side, or one below the other."""
    halves = [half.bounding_box() for half in shown.tab.locator(".halves > *").all()]
    width = shown.tab.evaluate("document.documentElement.clientWidth")
    assert len(halves) == 2
    for half in halves:
        assert 0 <= half["x"] < half["x"] + half["width"] <= width
        assert half["width"] / half["height"] == pytest.approx(1500 / 60, rel=0.1)
    assert (halves[0]["y"] == halves[1]["y"]) == (width > 700)


def test_nested_figures_are_readable() -> None:
    """No brackets and braces of Python: every figure has a name of its own, and as many digits as a reader needs."""
    facts = {
        "fronts": [{"right": {"body": 0.123456789, "left arm": None}}, {"right": {"body": 1.0}}],
        "gaps": [[5, 9]],
        "edges": [],
        "world": {"doubtful": True, "tilt_deg": 2.5},
    }
    motion = motion_of(BODY)
    text = result_page(ResultContents(title="a", facts=facts, motion=motion, body=None))
    rows = dict(re.findall(r'<tr><td class="name">([^<]*)</td><td>([^<]*)</td></tr>', text))
    assert rows["fronts.0.right.body"] == "0.123457"
    assert rows["fronts.0.right.left arm"] == "-"
    assert rows["fronts.1.right.body"] == "1"
    assert rows["gaps"] == "5, 9"
    assert rows["edges"] == "-"
    assert rows["world.doubtful"] == "yes"


def test_it_shows_the_world_and_when_feet_stand() -> None:
    """Of 8 sub-frames at a height of the soles above a floor; what is not text is left out."""
    motion = motion_of(BODY)
    level = stand(replace(motion, world=with_floor(None, "estimate")))
    standing = foot_contacts(level)
    facts = {"world": {"says": "height 0 is the <floor>"}}
    text = result_page(ResultContents(title="a", facts=facts, motion=level, body=None))
    assert "Height 0 is the &lt;floor&gt;" in text
    paths = re.findall(r'aria-label="when this foot stands"><path d="([^"]*)"', text)
    shown = [[f"M{row} 0h" in path for row in range(len(standing))] for path in paths]
    assert shown == standing.T.tolist()
    assert "None" not in result_page(ResultContents(title="a", facts={"world": {"says": 3}}, motion=level, body=None))


def test_it_links_to_the_files_beside_it() -> None:
    motion = motion_of(BODY)
    alone = ResultContents(title="a", facts={}, motion=motion, body=None)
    text = result_page(replace(alone, beside=("motion.glb", "joints.trc")))
    assert re.findall(r'<li><a href="([^"]+)">', text) == ["motion.glb", "joints.trc"]
    assert "Files beside this page" not in result_page(alone)


def test_what_it_says(report: Path) -> None:
    said = report.read_text()
    for words in (
        "Warning: the body is off",
        "frames 5\u20139",
        "In frames 1\u20132, 4 the pose",
        "1.",
        "80 % interval",
        "right arm the other way",
        "One picture leaves the direction open: a second frame of the same camera tells it",
        "agree to 0.61 only",
        "3.2 s",
    ):
        assert words in said, words
    assert "61 %" not in said  # the sentence of what is unknown has the number, and no other place repeats it
    assert "javascript:alert(1)</p>" in said  # a word, not a link
    assert 'href="javascript' not in said
    assert "alert(1)</script>" not in said.replace("&lt;", "<<")


def test_a_height_that_was_told_is_said() -> None:
    motion = motion_of(BODY)
    unknown, told, damaged = (
        " ".join(unknown_sentences(motion, BODY, {"config": {"fit": {"height_m": height}}}))
        for height in (None, 1.8, NASTY)
    )
    assert "give it with --fit.height-m" in unknown
    assert "m tall and" in unknown
    assert damaged == unknown == " ".join(unknown_sentences(motion, BODY, {}))
    assert "height, 1.80 m, was given" in told
    assert "--fit.height-m" not in told


def test_the_condition_of_odds_is_said_beside_them() -> None:
    motion = motion_of(BODY)
    facts = {"unknown": "UNKNOWN", "confidence": {"holds_for": "RADII", "directions": {"holds_for": "ODDS"}}}
    said = " ".join(unknown_sentences(motion, BODY, facts))
    assert said.index("UNKNOWN") < said.index("ODDS")
    assert "ODDS" not in " ".join(unknown_sentences(motion, BODY, facts | {"unknown": None}))  # nothing moved
    for damaged in (None, "x", {"directions": 3}, {"directions": {"holds_for": [1]}}):
        assert "UNKNOWN" in unknown_sentences(motion, BODY, facts | {"confidence": damaged})


def test_a_front_that_was_in_doubt_is_said_to_be() -> None:
    motion = motion_of(BODY)

    def said(front: object) -> str:
        return " ".join(unknown_sentences(motion, BODY, {"front": front}))

    assert "both ways were fitted: 89 % for the way shown" in said({"probability": 0.886, "turn_deg": 92.3})
    for other in (None, {"probability": 0.886, "turn_deg": 20.0}, {"probability": "x", "turn_deg": 92}, {}, [1], "x"):
        assert "faces" not in said(other)  # seen from the side, or damaged


def test_what_told_the_direction_is_shown_where_it_counted() -> None:
    found = weighed(motion_of(BODY))  # three frames: what they say of time is in their loss
    scores = found.scores | {"path": np.full(3, 0.1234), "network_backwards": np.array([0.53, 0.6, 0.88])}
    several = alternatives_table(replace(found, scores=scores))
    single = alternatives_table(replace(found, scores=scores, reversed_limbs=found.reversed_limbs[:, :1]))
    assert several is not None
    assert single is not None
    assert "0.1234" in several["rows"][0]
    assert "network against it" not in several["head"]
    assert "network against it" in single["head"]
    assert "0.88" in single["rows"][1]


def test_the_body_stands_where_the_motion_says() -> None:
    motion = motion_of(BODY, frames=5, missing=(2,))
    whole = page("base.html", "x", content=viewer([ViewedMotion("one", motion)], BODY), scripts=viewer_scripts())
    with browser() as chromium:
        tab = new_tab(chromium, 700)
        tab.set_content(whole)
        rows = [0, 5, 15]
        found = np.array(
            tab.evaluate("rows => rows.map((row) => [...hfb.viewers[0].motion.pose(row).places])", rows)
        ).reshape(-1, 24, 3)
        assert np.abs(found - motion.joints[rows]).max() < 5e-4
        assert tab.evaluate("hfb.viewers[0].motion.absentAfter(15)") is True
        assert tab.evaluate("hfb.viewers[0].motion.absentAfter(7)") is False
        assert tab.evaluate("hfb.viewers[0].motion.at(hfb.viewers[0].motion.timeAt(3.25))") == pytest.approx(3.25)
        bones = np.array(tab.evaluate("[...hfb.viewers[0].motion.pose(5).bones]")).reshape(24, 3, 4)
        carried = skinned(bones, motion)
        assert np.abs(carried - posed(motion, 5)).max() < 1e-3


def skinned(bones: np.ndarray, motion: SampledMotion) -> np.ndarray:
    """The rest pose's vertices, as the vertex shader carries them."""
    import torch

    rest = BODY.shape(torch.from_numpy(motion.betas).float()).vertices.double().numpy()
    mixed = np.einsum("vj,jab->vab", BODY.skinning_weights.double().numpy(), bones)
    return np.einsum("vab,vb->va", mixed, np.pad(rest, ((0, 0), (0, 1)), constant_values=1))


def posed(motion: SampledMotion, row: int) -> np.ndarray:
    """The vertices that the method itself finds."""
    import torch

    from hfb.geometry.rotations import axis_angle_to_matrix

    turns = axis_angle_to_matrix(torch.from_numpy(motion.poses[row : row + 1]).unflatten(1, (24, 3))).float()
    shaped = BODY.shape(torch.from_numpy(motion.betas).float())
    return shaped.pose(turns, torch.from_numpy(motion.trans[row : row + 1]).float()).vertices[0].double().numpy()


def test_without_webgl_there_is_a_skeleton_and_viewers_of_a_group_move_together() -> None:
    motion = motion_of(BODY)
    both = [viewer([ViewedMotion("one", motion)], BODY, label=NASTY, group="runs") for _ in range(2)]
    with browser("--disable-3d-apis") as chromium:
        tab = new_tab(chromium, 700)
        errors: list[str] = []
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.set_content(page("base.html", "x", content=Markup("").join(both), scripts=viewer_scripts()))
        kinds = tab.evaluate("[...document.querySelectorAll('.viewer')].map((one) => one.dataset.drawing)")
        assert kinds == ["skeleton", "skeleton"]
        assert_body_moves(tab)
        tab.locator("input.when").nth(1).fill("9")
        assert tab.evaluate("hfb.viewers.map((one) => one.position)") == pytest.approx([9, 9])
        before = tab.locator("canvas").nth(1).screenshot()
        tab.locator("canvas").nth(0).scroll_into_view_if_needed()
        box = tab.locator("canvas").nth(0).bounding_box()
        assert box is not None
        tab.mouse.move(box["x"] + 200, box["y"] + 100)
        tab.mouse.down()
        tab.mouse.move(box["x"] + 300, box["y"] + 100)
        tab.mouse.up()
        assert shows(tab.locator("canvas").nth(1), lambda now: now != before) != before  # turned with the first
        assert errors == []


def test_a_graphics_card_that_was_taken_away_comes_back(report: Path) -> None:
    with browser() as chromium:
        tab = opened(chromium, report.as_uri(), WIDTHS[0]).tab
        canvas = tab.locator(".viewer canvas").first
        tab.wait_for_function("() => hfb.viewers[0].drawing.textured")
        canvas.scroll_into_view_if_needed()
        before = shows(canvas, lambda shown: True)
        tab.wait_for_function(
            """() => {
              const { gl } = hfb.viewers[0].drawing;
              window.taken = gl.getExtension("WEBGL_lose_context"); // null while it is lost anyhow
              if (!window.taken) return false;
              gl.canvas.addEventListener("webglcontextlost", () => { window.gone = true; });
              window.taken.loseContext();
              return true;
            }"""
        )
        tab.wait_for_function("() => window.gone")
        tab.evaluate("taken.restoreContext()")
        tab.wait_for_function("() => hfb.viewers[0].drawing.textured && !hfb.viewers[0].drawing.gl.isContextLost()")
        assert shows(canvas, lambda shown: shown == before) == before
        assert_body_moves(tab)


def test_controls(report: Path) -> None:
    with browser() as chromium:
        shown = opened(chromium, report.as_uri(), WIDTHS[1])
        tab = shown.tab
        canvas = tab.locator(".viewer canvas")

        seen: list[bytes] = []
        for action in [
            lambda: canvas.focus(),
            lambda: tab.locator("select.colours").select_option("time"),
            lambda: tab.locator("select.colours").select_option("sureness"),
            lambda: tab.locator("input.ghosts").uncheck(),
            lambda: canvas.press("ArrowRight"),
            lambda: canvas.press("+"),
            lambda: tab.get_by_role("button", name="above").click(),
            lambda: tab.locator("select.motions").select_option("1"),
        ]:
            action()
            seen.append(shows(canvas, lambda now: now not in seen))
        assert len(set(seen)) == len(seen)
        assert tab.locator("select.motions option").all_inner_texts() == [
            "as fitted",
            "everything the other way (50 %)".replace("everything", "all"),
            "frame 1: right arm the other way (20 %)",
        ]
        tab.locator("button.play").click()
        tab.wait_for_function("() => hfb.viewers[0].position > 0 && hfb.viewers[0].playing")
        at = tab.evaluate("hfb.viewers[0].position")
        tab.wait_for_function("at => hfb.viewers[0].position !== at", arg=at)
        tab.locator("button.play").click()
        assert tab.evaluate("hfb.viewers[0].playing") is False
        assert shown.errors == []


def test_ghosts_never_veil_the_body(report: Path) -> None:
    with browser() as chromium:
        tab = opened(chromium, report.as_uri(), WIDTHS[1]).tab
        canvas, ghosts = tab.locator(".viewer canvas"), tab.locator("input.ghosts")
        tab.get_by_role("button", name="above").click()  # from there some ghosts are nearer than the body
        shown, seen = {}, [shows(canvas, lambda now: True)]
        for wanted in (False, True):
            ghosts.set_checked(wanted)
            seen.append(shows(canvas, lambda now: now != seen[-1]))
            shown[wanted] = cv2.imdecode(np.frombuffer(seen[-1], np.uint8), cv2.IMREAD_COLOR).astype(int)
        alone, apart = shown[False], abs(shown[True] - shown[False]).max(-1)
        on_body = abs(alone - alone[:, :1]).max(-1) > 30  # the background is the same along a row
        inside = cv2.erode(on_body.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
        assert inside.sum() > 300
        assert (apart[inside] > 2).mean() < 0.005  # but for smooth edges where a fold lets the background through
        assert apart[~on_body].max() > 5


def test_a_long_clip_stays_small() -> None:
    motion = motion_of(BODY, frames=300)
    assert len(motion.times_s) == 2400
    block = viewer([ViewedMotion("clip", motion)], BODY)
    assert len(block) < 2_000_000
    content = json.loads(block.partition('class="scene">')[2].partition("</script>")[0])
    assert len(content["motions"]) == 1


def test_limbs_in_words() -> None:
    one = np.zeros((1, 5), bool)
    assert reversed_text(one, one) == "the result"
    assert reversed_text(~one, one) == "all the other way"
    arm = one.copy()
    arm[0, 3] = True
    assert reversed_text(arm, one) == "left arm the other way"
    assert reversed_text(~arm, one) == "all but left arm the other way"
    assert by_probability(weighed(motion_of(BODY))) == [0, 2, 1]
