"""A benchmark's page: everything in it, nothing beside it, and whatever methods and recordings are called is text."""

import re
from pathlib import Path

import numpy as np
import pytest

from hfb.evaluation.tables import summarize, table_markdown
from hfb.io.media.images.image_io import write_png
from hfb.report.pages import benchmark_page as pages
from hfb.report.pages.benchmark_page import Answer, benchmark_page
from hfb.report.pages.markdown import markdown
from tests.browser import browser, opened

METHOD, SOURCE = "mine <b>", '<script>alert(1)</script>.bvh & "more"'
BESIDE = "# Table 1: blur rates\n\n| row | paper |\n| :--- | ---: |\n| HfB | 85.9 |\n"


def rows(count: int = 6) -> list[dict]:
    made = []
    for case in range(1, count + 1):
        facts = {"case": case, "blur_rate": 0.1 * case, "source": SOURCE, "initial_mpjpe_mm": 100.0, "initial_iou": 0.5}
        made.append(facts | {"method": METHOD, "failed": None, "mpjpe_mm": 40.0 + case, "iou": 0.8, "seconds": 1.0})
        made.append(
            facts | {"method": "other", "failed": "it <i>diverged</i>" if case == 2 else None, "mpjpe_mm": 90.0}
        )
    return made


def made_page(folder: Path, **more: str) -> str:
    told = rows()
    for name in ("ratio_by_blur.png", "gallery.png", "look.png"):
        write_png(folder / name, np.full((40, 80, 3), 0.5, np.float32))
    summary = summarize(told, "bt-amass", 6, {"bad.bvh": "<u>no motion</u>"}, 3, [(0.0, 0.35), (0.35, 1.0)])
    answers = [Answer(row, folder / "look.png" if row["method"] == METHOD else None) for row in told]
    return benchmark_page(
        summary,
        table_markdown(summary, ("motions: <em>",)),
        [folder / "ratio_by_blur.png"],
        folder / "gallery.png",
        answers,
        {"spec.motions": "<img src=x>"},
        **more,
    )


def test_everything_is_there_and_is_text(tmp_path: Path) -> None:
    page = made_page(tmp_path)
    for words in (
        "mine &lt;b&gt;",
        "&lt;u&gt;no motion&lt;/u&gt;",
        "&lt;img src=x&gt;",
        "motions: &lt;em&gt;",
        "failed",
    ):
        assert words in page
    for markup in ("<script", "<b>mine", "<u>", "<em>", "<img src=x", "<i>"):
        assert markup not in page
    assert "<b>0.43</b>" in page  # 43.5 over 100
    assert "n\u00a06]" in page
    assert page.count("data:image/png") == 1
    assert page.count("data:image/jpeg") == 1 + 6  # gallery, and a picture per case
    links = set(re.findall(r'href="#([^"]+)"', page))
    assert links == {f"case-{number}" for number in range(1, 7)}
    assert all(f'id="{link}"' in page for link in links)
    assert not re.search(r"(src|href)=\"(?!data:|#)", page)


def test_beside_the_paper(tmp_path: Path) -> None:
    page = made_page(tmp_path, beside_paper=BESIDE)
    assert "<h1>Table 1: blur rates: ours beside the paper</h1>" in page
    assert '<td style="text-align:right">85.9</td>' in page


def test_a_large_benchmark_shows_cases_of_its_whole_range(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "_MOST_LOOKS", 3)
    page = made_page(tmp_path)
    assert len(re.findall(r'id="case-', page)) == 3
    assert 'id="case-1"' in page
    assert 'id="case-6"' in page
    assert "those of 3 others lie beside this page" in page


def test_markdown_is_tables_and_words_alone() -> None:
    html = markdown(
        "# Title\n\n## Part\n\n| a | b |\n|---|---|\n| [x](http://e) | <b>*c*</b> |\n\n![p](http://e/p.png)\n"
    )
    assert "Title" not in html
    assert "<h3>Part</h3>" in html
    assert "&lt;b&gt;<em>c</em>&lt;/b&gt;" in html
    assert "<a" not in html
    assert "<img" not in html


@pytest.mark.integration
def test_in_a_browser(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text(made_page(tmp_path, beside_paper=BESIDE))
    with browser() as chromium:
        for width in (1400, 600):
            page = opened(chromium, path.as_uri(), width)
            page.tab.locator("summary", has_text="all 6 cases").click()
            page.tab.locator("a", has_text="case 5").click()
            page.tab.locator("#case-5 summary").click()
            assert page.tab.locator("#case-5 img").is_visible()
            assert page.tab.evaluate("document.documentElement.scrollWidth") <= width
            assert (page.requests, page.errors) == ([], [])
