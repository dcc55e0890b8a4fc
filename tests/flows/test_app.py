"""`hfb app`: what is dropped on its page becomes a run like any other; nobody else's request is answered."""

import io
import json
import os
import shutil
import signal
import socket
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import httpx
import numpy as np
import psutil
import pytest

from hfb.errors import InputError
from hfb.flows.app.request import MOST_BYTES, MOST_PICTURES, check_request
from hfb.flows.cli import app_cli
from hfb.flows.cli.cli import main
from tests.flows.app_pages import ENDLESS, SHORT, Served, body, served
from tests.orchestration import Problem, mlflow_rows
from tests.small_clips import FRAMES, SMALL_OPTIONS, small_clip

PNG = b"\x89PNG\r\n\x1a\n"
PAIR = [("recording", "frame.png", PNG), ("plate", "plate.png", PNG)]


def pair(problem: Problem) -> list[tuple[str, str, bytes]]:
    return [
        ("recording", "jump shot.PNG", problem.frame.read_bytes()),
        ("plate", "plate.png", problem.background.read_bytes()),
    ]


def folders(out: Path) -> list[str]:
    return sorted(one.name for one in out.iterdir() if one.name != ".lock")


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Served, Path]]:
    """The app without jobs but one that an earlier start made, whose files are known."""
    out = tmp_path_factory.mktemp("app")
    earlier_job(out, "20260101-000000-00000000")
    with served(out) as page:
        yield page, out


def earlier_job(out: Path, name: str, **record: object) -> Path:
    """A finished job's folder."""
    folder = out / name
    (folder / "result").mkdir(parents=True)
    files = [{"role": role, "name": name, "size": len(data)} for role, name, data in PAIR]
    known = {"request": {"files": files}, "state": "done"} | record
    (folder / "job.json").write_text(json.dumps(known))
    (folder / "result" / "result.json").write_text('{"matte_iou": 0.9, "mlflow_link": "javascript:alert(1)"}')
    (folder / "result" / "report.html").write_text("<p>report")
    (folder / "result" / "motion.bvh").write_text("HIERARCHY")
    (folder / "result" / "secret.txt").symlink_to("/etc/hostname")
    return folder


def test_a_picture_becomes_a_run_like_any_other(problem: Problem, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "app"
    with served(out, *SHORT) as page:
        answer = page.post("jobs", body(pair(problem), {"fit.height_m": 1.8, "seed": 3}))
        assert answer.status_code == 201, answer.text
        job = page.wait(answer.json()["name"], "done")
        assert job["title"] == "jump shot.PNG"
        assert {one["label"] for one in job["steps"]} >= {"matte", "first body", "fit", "record in MLflow"}
        assert job["link"] is None or job["link"].startswith("http")
        assert {"motion.glb", "motion.bvh", "joints.trc", "joints.csv", "report.html"} <= set(job["files"])
        assert page.get(f"jobs/{job['name']}/files/motion.glb").content.startswith(b"glTF")
        packed = zipfile.ZipFile(io.BytesIO(page.get(f"jobs/{job['name']}/all").content))
        assert {Path(name).name for name in packed.namelist()} == set(job["files"])
        report = page.get(f"jobs/{job['name']}/report")
        assert "Human from Blur" in report.text

    folder = out / job["name"]
    frame, plate = (str(folder / "input" / name) for name in ("frame_0.png", "background.png"))
    given = ["--fit.height-m", "1.8", "--seed", "3", "--out", str(tmp_path / "same")]
    assert main(["fit", frame, "--background", plate, *SHORT, *given]) == 0
    (same, ours) = (json.loads((one / "result.json").read_text()) for one in (tmp_path / "same", folder / "result"))
    assert same["mlflow_run_id"] == ours["mlflow_run_id"], "the same record: same options, inputs and code"
    assert len(mlflow_rows(store, "select * from runs")) == 1
    assert (tmp_path / "same" / "motion.npz").read_bytes() == (folder / "result" / "motion.npz").read_bytes()

    with served(out, *SHORT) as page:
        (kept,) = page.jobs()
        assert (kept["name"], kept["state"]) == (job["name"], "done")
        assert page.get(f"jobs/{kept['name']}/files/motion.bvh").text.startswith("HIERARCHY")
        assert page.post(f"jobs/{kept['name']}/remove").status_code == 200
        assert page.jobs() == []
        assert folders(out) == []


@pytest.mark.usefixtures("store")
def test_a_job_that_is_cancelled_or_killed_ends_alone(problem: Problem, tmp_path: Path) -> None:
    out = tmp_path / "app"
    with served(out, *ENDLESS) as page:
        first, second = (page.post("jobs", body(pair(problem))).json()["name"] for _ in range(2))
        page.wait(first, "running", step="fit")
        assert page.get(f"jobs/{second}").json()["state"] == "waiting"
        page.post(f"jobs/{second}/cancel")
        assert page.wait(second, "cancelled")["message"] == "it was cancelled before it began"
        assert page.post(f"jobs/{first}/remove").status_code == 200
        assert page.get(f"jobs/{first}").status_code == 200, "what runs is not removed"
        page.post(f"jobs/{first}/cancel")
        assert "cancelled" in page.wait(first, "cancelled")["message"]
        assert not psutil.Process(page.process.pid).children()

        page.post(f"jobs/{first}/again")
        page.wait(first, "running", step="fit")
        (process,) = psutil.Process(page.process.pid).children()
        process.kill()
        assert "signal 9" in page.wait(first, "failed")["message"]

        page.post(f"jobs/{first}/again")
        page.wait(first, "running", step="fit")
        (process,) = psutil.Process(page.process.pid).children()
        page.process.send_signal(signal.SIGKILL)
        psutil.wait_procs([process], timeout=90)
        assert not process.is_running(), "a job ends with the app"
    with served(out, *SHORT) as page:
        states = {job["name"]: job["state"] for job in page.jobs()}
        assert states == {first: "stopped", second: "cancelled"}
        page.post(f"jobs/{first}/again")
        page.wait(first, "done")


@pytest.mark.usefixtures("store")
def test_pictures_that_cannot_be_used_are_refused_in_a_sentence(problem: Problem, tmp_path: Path) -> None:
    _, plate = pair(problem)
    with served(tmp_path / "app", *SHORT) as page:
        text = page.post("jobs", body([("recording", "frame.png", b"no picture"), plate])).json()["name"]
        told = page.wait(text, "refused")["message"]
        assert told.startswith("frame.png: is not a picture")
        other = cv2.imencode(".png", np.zeros((50, 60, 3), np.uint8))[1].tobytes()
        sizes = page.post("jobs", body([("recording", "small.png", other), plate])).json()["name"]
        told = page.wait(sizes, "refused")["message"]
        assert told.startswith("small.png is 60 x 50 px and the background plate.png 96 x 96 px")
        assert [job["state"] for job in page.jobs()] == ["refused", "refused"]


@pytest.mark.parametrize(
    ("files", "options", "sentence"),
    [
        ([("recording", "notes.txt", b"a"), PAIR[1]], {}, "notes.txt is neither a picture"),
        ([("recording", "frame.heic", b"a"), PAIR[1]], {}, "frame.heic is neither a picture"),
        ([("recording", "frame.png", b""), PAIR[1]], {}, "frame.png is empty"),
        ([PAIR[1]], {}, "no picture and no video was given"),
        ([PAIR[0]], {}, "picture of the empty scene is missing"),
        ([PAIR[0], PAIR[1], PAIR[1]], {}, "2 pictures of the empty scene"),
        ([("recording", "a.mp4", b"a"), ("recording", "b.mp4", b"b")], {}, "give one video"),
        ([("recording", "a.mp4", b"a"), ("plate", "b.mp4", b"b")], {}, "b.mp4 is no picture"),
        ([PAIR[0]] * (MOST_PICTURES + 1) + [PAIR[1]], {}, "at most 16 pictures"),
        ([PAIR[0]] * 200, {}, "at most 16 pictures"),
        (PAIR, {"fit.height_m": float("nan")}, "fit.height_m"),
        (PAIR, {"fit.height_m": 17}, "fit.height_m"),
        (PAIR, {"camera.focal_px": float("inf")}, "camera.focal_px"),
        (PAIR, {"seed": -1}, "seed"),
        (PAIR, {"preset": "--out=/tmp/x"}, "preset"),
        (PAIR, {"body.model": "/etc/passwd"}, "'body.model' is no option of the page"),
        (PAIR, {"init.weights": "x.onnx"}, "is no option of the page"),
        ([*PAIR, ("clip", "clip.toml", b"[camera\n")], {}, "clip.toml is not valid TOML"),
        ([*PAIR, ("clip", "clip.toml", b"[camera]\ncalibration='../../a.toml'\n")], {}, "does not lie in its folder"),
        ([*PAIR, ("clip", "clip.toml", b"[camera]\ncalibration='Calib.toml'\n")], {}, "names another file"),
        ([*PAIR, ("clip", "clip.toml", b"[person]\nwhich='everyone'\n")], {}, "hfb video --everyone"),
        ([*PAIR, ("clip", "clip.toml", b"#" * 70_000)], {}, "too large for a clip.toml"),
    ],
)
def test_what_cannot_be_used_is_told_and_leaves_nothing(
    app: tuple[Served, Path], files: list[tuple[str, str, bytes]], options: dict[str, object], sentence: str
) -> None:
    page, out = app
    before = folders(out)
    answer = page.post("jobs", body(files, options))
    assert answer.status_code == 400
    assert sentence in answer.json()["error"]
    assert str(out) not in answer.json()["error"]
    assert "\n" not in answer.json()["error"]
    assert folders(out) == before


@pytest.mark.parametrize("content", [b"", b"\n", b"[]\n", b"{\n", b"{}", b"[" * 60_000 + b"\n", b"a" * 200_000])
def test_a_request_that_is_none_is_refused(app: tuple[Served, Path], content: bytes) -> None:
    page, out = app
    before = folders(out)
    answer = page.post("jobs", content)
    assert answer.status_code == 400
    assert answer.json()["error"]
    assert folders(out) == before


def test_a_file_is_whole_or_absent(app: tuple[Served, Path]) -> None:
    """Fewer or more bytes than were promised, an upload that breaks off, and one that is too large."""
    page, out = app
    before = folders(out)
    whole = body(PAIR)
    for content in (whole[:-1], whole + b"more"):
        assert "changed while it was read" in page.post("jobs", content).json()["error"]
    promised = body([("recording", "a.mp4", b"")]).replace(b'"size": 0', b'"size": %d' % (MOST_BYTES + 1))
    assert "larger than 2 GB" in page.post("jobs", promised).json()["error"]
    address = urlsplit(page.url)
    head = f"POST {address.path}jobs HTTP/1.1\r\nHost: {address.netloc}\r\nOrigin: {page.origin}\r\n"
    head += f"Content-Type: application/x-hfb-upload\r\nContent-Length: {len(whole)}\r\n\r\n"
    with socket.create_connection((str(address.hostname), address.port or 0)) as broken:
        broken.sendall(head.encode() + whole[:-4])
        time.sleep(0.5)
    deadline = time.monotonic() + 20
    while folders(out) != before:
        assert time.monotonic() < deadline, folders(out)
        time.sleep(0.1)
    with socket.create_connection((str(address.hostname), address.port or 0)) as large:
        large.sendall(head.replace(str(len(whole)), "9" * 12).encode())
        assert b" 400 " in large.recv(100)


def test_names_from_the_browser_name_no_file(tmp_path: Path) -> None:
    names = ["../../etc/cron.d/x.png", "--out=/tmp.png", "/etc/passwd.PNG", "a\0b.png"]
    files = [{"role": "recording", "name": name, "size": 1} for name in names]
    request = check_request({"files": [*files, {"role": "plate", "name": "..\\..\\plate.JPG", "size": 1}]})
    assert request.stored_names() == (*(f"frame_{index}.png" for index in range(4)), "background.jpg")
    words = request.words(tmp_path)
    assert words[1:5] == [str(tmp_path / "input" / f"frame_{index}.png") for index in range(4)]
    assert "\0" not in request.title
    for name in ("png", ".png", "x.png.exe", "x.png\0"):
        with pytest.raises(InputError, match="neither a picture"):
            check_request({"files": [{"role": "recording", "name": name, "size": 1}]})


@pytest.mark.parametrize(
    ("method", "headers", "status"),
    [
        ("GET", {"Host": "evil.example"}, 421),
        ("GET", {"Host": "evil.example:{port}"}, 421),
        ("GET", {"Host": "127.0.0.1"}, 421),
        ("GET", {"Sec-Fetch-Site": "cross-site"}, 403),
        ("GET", {"Sec-Fetch-Site": "same-site"}, 403),
        ("GET", {"Sec-Fetch-Site": "same-origin"}, 200),
        ("GET", {"Host": "localhost:{port}"}, 200),
        ("POST", {}, 403),
        ("POST", {"Origin": "null"}, 403),
        ("POST", {"Origin": "http://evil.example"}, 403),
        ("POST", {"Origin": "http://127.0.0.1:1"}, 403),
        ("POST", {"Origin": "http://localhost:{port}"}, 403),
        ("POST", {"Origin": "http://127.0.0.1:{port}", "Sec-Fetch-Site": "cross-site"}, 403),
    ],
)
def test_only_its_own_page_is_answered(
    app: tuple[Served, Path], method: str, headers: dict[str, str], status: int
) -> None:
    page, out = app
    before = folders(out)
    port = urlsplit(page.url).port
    told = {name: value.format(port=port) for name, value in headers.items()}
    answer = httpx.request(
        method, page.url + "jobs", headers={"Content-Type": "text/plain", **told}, content=body(PAIR)
    )
    assert answer.status_code == status
    assert folders(out) == before


def test_without_the_key_there_is_nothing(app: tuple[Served, Path]) -> None:
    page, _ = app
    for path in ("/", "/jobs", "/favicon.ico", "/x" * 20, "/" + "a" * 32 + "/jobs"):
        assert httpx.get(page.origin + path).status_code == 404
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", urlsplit(page.url).port or 0), timeout=5)


@pytest.mark.parametrize(
    "file", ["secret.txt", "..%2Fjob.json", "%2e%2e/job.json", ".lock", "none.bvh", "report.html%00"]
)
def test_only_files_of_the_result_are_handed_out(app: tuple[Served, Path], file: str) -> None:
    page, _ = app
    assert page.get(f"jobs/20260101-000000-00000000/files/{file}").status_code == 404


def test_answers_have_safe_types(app: tuple[Served, Path]) -> None:
    page, _ = app
    job = "jobs/20260101-000000-00000000"
    index, report, file = page.get(""), page.get(f"{job}/report"), page.get(f"{job}/files/report.html")
    for answer in (index, report, file, page.get("jobs"), page.get("none")):
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    assert "frame-ancestors 'none'" in index.headers["Content-Security-Policy"]
    assert report.headers["Content-Security-Policy"].startswith("sandbox allow-scripts ")
    assert "allow-same-origin" not in report.headers["Content-Security-Policy"]
    assert file.headers["Content-Type"] == "application/octet-stream"
    assert file.headers["Content-Disposition"].startswith("attachment;")
    assert page.get(job).json()["link"] is None
    assert page.get(f"{job}/all").content == page.get(f"{job}/all").content
    assert "secret.txt" not in page.get(job).json()["files"]


def test_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    """What a record says is checked as if a browser had sent it; links are not followed."""
    out = tmp_path / "app"
    made = earlier_job(out, "20260101-000000-00000001")
    bad = json.loads((made / "job.json").read_text())
    bad["request"]["options"] = {"matting.weights": "/tmp/evil.pt"}
    earlier_job(out, "20260101-000000-00000002", **bad)
    shutil.copytree(made, tmp_path / "elsewhere", symlinks=True)
    (out / "20260101-000000-00000003").symlink_to(tmp_path / "elsewhere")
    stopped = earlier_job(out, "20260101-000000-00000004", state="running")
    (stopped / "log.txt").symlink_to(tmp_path / "mine.txt")
    (tmp_path / "mine.txt").write_text("mine")
    linked = earlier_job(out, "20260101-000000-00000006")
    (linked / "input").mkdir()
    (linked / "input" / "frame_0.png").symlink_to(tmp_path / "mine.txt")
    (out / "20260101-000000-00000005").mkdir()
    (out / "notes.txt").write_text("mine")
    (out / ".upload-0123").mkdir()
    with served(out) as page:
        assert {job["name"][-1]: job["state"] for job in page.jobs()} == {"1": "done", "4": "stopped"}
        assert not (out / ".upload-0123").exists()
        page.post(f"jobs/{stopped.name}/again")
        assert "frame.png does not exist" in page.wait(stopped.name, "refused")["message"]
        assert (tmp_path / "mine.txt").read_text() == "mine"
        assert main(["app", "--port", "0", "--out", str(out)]) == 2, "one app per folder"
        page.process.send_signal(signal.SIGINT)
        assert page.process.wait(30) == 0, "Ctrl-C is how it ends"
    assert (out / "notes.txt").exists()
    assert os.path.lexists(out / "20260101-000000-00000003")


def test_a_port_that_is_taken_is_told(
    app: tuple[Served, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    page, _ = app
    assert main(["app", "--port", str(urlsplit(page.url).port), "--out", str(tmp_path / "out")]) == 2
    assert "give another one" in capfd.readouterr().err
    assert main(["app", "--port", "70000"]) == 2


def test_who_follows_the_address_at_once_is_not_refused() -> None:
    with app_cli.listen(0) as listening, socket.create_connection(listening.getsockname(), timeout=5):
        pass


@pytest.mark.usefixtures("store")
def test_a_video_becomes_a_clip(tmp_path: Path) -> None:
    clip = small_clip(video=True)
    given = (
        ("recording", "walk.MP4", clip.source),
        ("plate", "plate.png", clip.background),
        ("clip", "a.toml", clip.clip),
    )
    files = [(role, name, Path(path).read_bytes()) for role, name, path in given]
    with served(tmp_path / "app", *SMALL_OPTIONS) as page:
        name = page.post("jobs", body(files, {"video.average": 2})).json()["name"]
        job = page.wait(name, "done")
    assert job["command"] == "video"
    assert job["figures"]["frames"] == FRAMES // 2
    assert "motion.bvh" in job["files"]
    config = json.loads((tmp_path / "app" / name / "result" / "result.json").read_text())["config"]
    assert config["video"]["average"] == 2
