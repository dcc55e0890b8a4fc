"""The paper's tables as data: every digit as in its source, consistent in themselves, and ours set beside them."""

import re
from importlib import resources
from pathlib import Path

import pytest

from hfb.datasets.blur_bins import bins_of, paper_counts
from hfb.errors import InputError
from hfb.evaluation.baselines.method_spec import method_spec
from hfb.evaluation.experiment_files import experiment_names
from hfb.evaluation.experiments import (
    beside_paper,
    find_experiment,
    load_experiment,
    papers_ratios,
)
from hfb.evaluation.tables import summarize

SOURCE = Path(__file__).parents[3] / "shared/paper/human-from-blur.tex"
NAMES = experiment_names()
TABLES = [name for name in NAMES if name.startswith("table")]


def _experiment(name: str):
    return find_experiment(name)


def _row(experiment, name: str):
    return next(row for row in experiment.rows if row.name == name)


def test_there_is_a_file_for_every_table_and_figure_of_the_paper():
    assert [f"figure{k}" for k in range(1, 7)] + [f"table{k}" for k in range(1, 6)] == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_file_loads_and_says_what_differs(name):
    experiment = _experiment(name)
    assert experiment.place.lower().replace(" ", "") == name
    assert bool(experiment.rows) == name.startswith("table")
    assert bool(experiment.strips) == name.startswith("figure")
    assert all(sentence.endswith(".") for sentence in experiment.differs)
    assert all(method_spec(method).name == method for method in experiment.methods)


@pytest.mark.parametrize(
    ("name", "row", "mpjpe_mm", "iou"),
    [
        ("table1", "METRO", 104.3, 0.555),
        ("table1", "HfB (ours)", 85.9, 0.778),
        ("table1", "HfB w/o AMP", 90.2, None),
        ("table2", "METRO", 86.6, 0.574),
        ("table2", "HfB (ours)", 77.4, 0.776),
    ],
)
def test_means_over_the_papers_cases_are_those_of_its_reading(name, row, mpjpe_mm, iou):
    experiment = _experiment(name)
    found = _row(experiment, row)
    assert round(experiment.mean(found.mpjpe_mm), 1) == mpjpe_mm
    assert iou is None or round(experiment.mean(found.iou), 3) == iou


@pytest.mark.parametrize(("name", "ratio"), [("table1", 0.823), ("table2", 0.894)])
def test_the_papers_ratios_are_those_of_its_reading(name, ratio):
    experiment = _experiment(name)
    fitted, start = _row(experiment, "HfB (ours)"), experiment.start_row()
    assert experiment.mean(fitted.mpjpe_mm) / experiment.mean(start.mpjpe_mm) == pytest.approx(ratio, abs=5e-4)


def test_the_papers_ratios_stand_beside_ours_where_the_intervals_are_the_same():
    experiment = _experiment("table1")
    start = {"case": 1, "method": "static", "blur_rate": 0.15, "failed": None, "initial_mpjpe_mm": 9.0, "mpjpe_mm": 9.0}
    ratios = papers_ratios(experiment, summarize([start], "bt-amass", 1, {}, 0, experiment.bins()))
    assert ratios is not None
    assert len(ratios) == len(experiment.columns) + 1
    assert ratios[0] == pytest.approx(56.3 / 70.0)
    assert ratios[-1] == pytest.approx(0.823, abs=5e-4)
    assert papers_ratios(experiment, summarize([start], "bt-amass", 1, {}, 0, [(0.1, 0.5)])) is None


@pytest.mark.parametrize(("name", "total"), [("table1", 1124), ("table2", 305)])
def test_the_papers_counts_add_up(name, total):
    experiment = _experiment(name)
    assert sum(column.n for column in experiment.columns) == experiment.count == total
    assert tuple(column.n for column in experiment.columns) == paper_counts(experiment.set, experiment.frames)


@pytest.mark.parametrize("name", ["table1", "table2", "table4", "table5"])
def test_columns_are_the_intervals_by_which_the_sets_are_made(name):
    experiment = _experiment(name)
    assert experiment.bins() == list(bins_of(experiment.set, experiment.frames))


def test_hfb_loses_where_the_reading_says_so():
    """Single CAPE frames below .4 to Jin + METRO, four frames below .2 to BIN + HybrIK, B-AIST++ twice to AfB."""
    losses = {
        ("table4", "Jin et al. + METRO", "mpjpe_mm"): [True, True, True, False, False, False],
        ("table5", "BIN + HybrIK", "mpjpe_mm"): [True, False, False, False, False, False],
        ("table3", "AfB", "pa_mpjpe_mm"): [True, True, False],
    }
    for (name, rival, metric), lost in losses.items():
        ours, theirs = (getattr(_row(_experiment(name), row), metric) for row in ("HfB (ours)", rival))
        assert [one > other for one, other in zip(ours, theirs, strict=True)] == lost


@pytest.mark.parametrize("name", TABLES)
def test_pa_mpjpe_is_below_mpjpe_and_iou_a_share(name):
    for row in _experiment(name).rows:
        if row.mpjpe_mm and row.pa_mpjpe_mm:
            assert all(pa < plain for pa, plain in zip(row.pa_mpjpe_mm, row.mpjpe_mm, strict=True))


def _numbers_in_source(label: str) -> tuple[int, list[list[float]]]:
    """A table's number in the paper, and its numbers line by line, without citations and `N.A.`."""
    text = SOURCE.read_text(encoding="utf-8")
    tables = re.findall(r"\\begin\{table\*?\}.*?\\end\{table\*?\}", text, re.S)
    place = next(index for index, table in enumerate(tables) if f"\\label{{{label}}}" in table)
    body = tables[place].split("\\bottomrule")[0].replace("\n\\\\", "\\\\")
    lines = []
    for line in body.splitlines():
        if line.rstrip().endswith("\\\\") or "\\\\ " in line:
            plain = re.sub(r"\\cite\{[^}]*\}|\\textbf|\\phantom\{A\}|N\.A\.", "", line)
            cells = [re.fullmatch(r"\{?\s*(\d+\.\d+)\s*\}?", c.strip()) for c in plain.split("\\\\")[0].split("&")[1:]]
            if any(cells):
                lines.append([float(cell[1]) for cell in cells if cell])
    return place + 1, lines


@pytest.mark.parametrize("name", TABLES)
def test_every_digit_is_the_papers(name):
    if not SOURCE.is_file():
        pytest.skip(f"the paper's source is not at {SOURCE}")
    experiment = _experiment(name)
    place, lines = _numbers_in_source(experiment.label)
    assert experiment.place == f"Table {place}"
    if name == "table3":
        assert [float(column.label.split(", ")[1]) for column in experiment.columns] == lines.pop(0)
    typed = []
    for row in experiment.rows:
        metrics = ["mpjpe_mm", "iou"] if name in ("table1", "table2") else ["pa_mpjpe_mm", "mpjpe_mm"]
        given = [getattr(row, metric) for metric in metrics if getattr(row, metric)]
        typed.append([value for column in zip(*given, strict=True) for value in column])
    assert typed == lines


def _rows(methods: dict[str, float], pa: float = 0.8) -> list[dict]:
    """Per interval of table 1 two cases of 100 mm, a share of which each method leaves."""
    bins = bins_of("bt-amass", 1)
    return [
        {
            "case": case,
            "method": method,
            "blur_rate": bins[case // 2][0] + 0.01,
            "failed": None,
            "initial_mpjpe_mm": 100.0,
            "mpjpe_mm": share * 100,
            "initial_pa_mpjpe_mm": pa * 100,
            "pa_mpjpe_mm": pa * share * 100,
            "initial_iou": 0.5,
            "iou": 0.75,
        }
        for case in range(20)
        for method, share in methods.items()
    ]


def _lines(page: str, heading: str) -> list[list[str]]:
    lines = page.split(f"## {heading}")[1].split("\n## ")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]


def test_ours_stands_beside_the_papers_numbers():
    experiment = _experiment("table1")
    summary = summarize(_rows({"static": 1.0, "best": 0.7}), "bt-amass", 20, {}, 0, experiment.bins())
    page = beside_paper(experiment, summary)
    short = next(line for line in _lines(page, "In short") if line[0] == "MPJPE [mm]")
    assert short[:9] == ["MPJPE [mm]", "HfB (ours)", "104.3", "85.9", "0.823", "`best`", "20", "100.0", "70.0"]
    assert short[9].startswith("0.700 [0.70,")
    pair = _lines(page, "MPJPE [mm]: `best` beside HfB (ours)")
    assert pair[2][:8] == ["[0.05, 0.1]", "123", "70.0", "56.3", "0.804", "2", "100.0", "70.0"]
    assert pair[-1][0] == "all"
    assert len(pair) == 2 + 10 + 1
    assert all(len(line) == len(pair[0]) for line in pair)
    assert "With the paper's cases per column: our start 100.0, `best` 70.0, ratio 0.700." in page
    every = {line[0]: line[1:] for line in _lines(page, "All rows, IoU")}
    assert every["paper: SfB"][-1] == "0.447"
    assert every["ours: `best`"] == ["0.750"] * 11
    assert all(f"- {sentence}" in page for sentence in experiment.differs)
    assert "Not run here: sfb, paper-no-adversarial, paper." in page


def test_other_intervals_leave_ours_unknown_but_for_all():
    experiment = _experiment("table4")
    summary = summarize(_rows({"best": 0.7}), "bc-cape", 20, {}, 0, [(0.0, 2.0)])
    pair = _lines(beside_paper(experiment, summary), "PA-MPJPE [mm]: `best` beside HfB (ours)")
    assert pair[2] == ["< 0.2", "–", "75.2", "–", "–", "–", "–"]
    assert pair[-1][:6] == ["all", "–", "86.8", "20", "80.0", "56.0"]


def test_two_frames_are_also_compared_with_the_interpolated_start():
    experiment = _experiment("table2")
    rows = _rows({"static": 1.0, "interpolated": 0.8, "best": 0.6})
    page = beside_paper(experiment, summarize(rows, "bt-amass", 20, {}, 0, experiment.bins()))
    assert "On the same cases, best vs interpolated: ratio of MPJPE 0.750 [0.75," in page


def test_a_figure_says_which_strips_to_look_at():
    experiment = _experiment("figure4")
    page = beside_paper(experiment, summarize([], "bc-cape", 0, {}, 0, [], methods=["best"]))
    assert "the strips of static, best, afb-metro, jin-metro for one case of blur rate 0.5–0.6" in page
    assert "Not run here: static, afb-metro, jin-metro." in page


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("n = 123", "n = 0", "n"),
        ("blur = [0.05, 0.1]", "blur = [0.1, 0.05]", "lower"),
        ("blur = [0.05, 0.1]", "blur = [0.05, 0.15]", "ascend"),
        ("0.498, ", "", "row SfB needs a number for each of the 10 columns"),
        ('start = "METRO"', 'start = "HMR"', "start names no row"),
        ('ours = ["sfb"]', 'ours = ["mfb"]', "mfb stands beside the paper"),
        ("fill =", "fillet =", "did you mean fill"),
        ("iou = [0.498", "iou = [498", "iou"),
    ],
)
def test_a_wrong_file_is_refused_with_the_reason(tmp_path, before, after, said):
    text = (resources.files("hfb.evaluation") / "data" / "table1.toml").read_text()
    assert before in text
    path = tmp_path / "wrong.toml"
    path.write_text(text.replace(before, after, 1))
    with pytest.raises(InputError, match=said):
        load_experiment(path)
