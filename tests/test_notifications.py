"""`hfb batch --notify`: a real receiver hears of clips that fail, nobody else learns its address."""

import json
import logging
import socket
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from hfb.errors import InputError
from hfb.flows.batch import batch
from hfb.flows.cli.cli import main
from hfb.flows.deployed import batch as deployed_batch
from hfb.tasks.batch import notifications
from hfb.tasks.batch.notifications import ClipTrouble, addresses_of, enable_notifications, notify
from tests.orchestration import mlflow_rows
from tests.small_clips import small_config

SECRET = "T000SECRET/B000SECRET/xoxSECRET"


class Receiver(ThreadingHTTPServer):
    """An HTTP server that keeps what is posted to it. Attributes: status: its answer. delay_s: before it."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.posts: list[tuple[str, dict[str, Any]]] = []
        self.status, self.delay_s, self.location = 200, 0.0, ""

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/services/{SECRET}?token=SECRET"


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        server: Any = self.server
        body = self.rfile.read(int(self.headers["Content-Length"]))
        server.posts.append((self.path, json.loads(body)))
        time.sleep(server.delay_s)
        self.send_response(server.status)
        if server.location:
            self.send_header("Location", server.location)
        self.end_headers()

    do_GET = do_POST

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    server = Receiver()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """A folder with one clip that is none."""
    (tmp_path / "clips").mkdir()
    (tmp_path / "clips" / "<!channel>.mp4").write_text("no video")
    return tmp_path / "clips"


TROUBLE = ClipTrouble("walk", "set aside", "it is no video")
COUNTS = {"clips": 3, "done": 2, "set_aside": 1, "waiting": 0, "out": "/out", "page": "/out/summary.html"}


def test_a_batch_tells_a_webhook_once_and_keeps_its_address(
    receiver: Receiver, clips: Path, store: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    config = small_config().model_dump(mode="json")
    with enable_notifications(addresses_of([receiver.address])):
        batch(clips, tmp_path / "out", config, workers=1, wait_s=0.1)
        batch(clips, tmp_path / "out", config, workers=1, wait_s=0.1)  # it was told
    ((path, told),) = receiver.posts
    assert SECRET in path
    assert told["event"] == "clips failed"
    assert (told["clips"], told["set_aside"], told["folder"]) == (1, 1, "clips")
    assert told["page"] == str(tmp_path / "out" / "summary.html")
    (failed,) = told["failed"]
    assert (failed["name"], failed["state"]) == ("<!channel>", "set aside")
    assert "1 of 1 clips failed or were set aside" in told["text"]
    assert "<!channel>: set aside" in told["text"]
    assert "SECRET" not in caplog.text
    written = b"".join(path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())
    assert b"SECRET" not in written, "no record, log, page or database holds it"
    assert mlflow_rows(store, "select count(*) from runs")


def test_flow_parameters_hold_no_address(receiver: Receiver, clips: Path, store: Path, tmp_path: Path) -> None:
    from prefect import get_client

    with enable_notifications(addresses_of([receiver.address])):
        batch(clips, tmp_path / "out", small_config().model_dump(mode="json"), workers=1)
    with get_client(sync_client=True) as client:
        assert "SECRET" not in "".join(run.model_dump_json() for run in client.read_flow_runs())


def test_slack_gets_a_text_that_calls_nobody(receiver: Receiver) -> None:
    with enable_notifications(addresses_of([f"slack:{receiver.address}"])):
        notify("a & b", [ClipTrouble("<!channel>", "failed", "<https://x|click>")], COUNTS)
    ((_, told),) = receiver.posts
    assert told.keys() == {"text"}
    assert "&lt;!channel&gt;: failed: &lt;https://x|click&gt;" in told["text"]
    assert "a &amp; b" in told["text"]


def test_a_prefect_block_is_used_by_its_name(
    receiver: Receiver, store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from prefect.blocks.notifications import CustomWebhookNotificationBlock
    from prefect.blocks.system import Secret

    CustomWebhookNotificationBlock(name="team", url=receiver.address, json_data={"said": "{{body}}"}, secrets={}).save(
        "hfb-team", overwrite=True
    )
    Secret(value="x").save("hfb-none", overwrite=True)
    with enable_notifications(
        addresses_of(["block:custom-webhook/hfb-team", "block:custom-webhook/none", "block:secret/hfb-none"])
    ):
        notify("clips", [TROUBLE], COUNTS)
    ((_, told),) = receiver.posts
    assert "walk: set aside: it is no video" in told["said"]
    assert "SECRET" not in "".join(capsys.readouterr())


def test_mail_goes_by_apprise(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small SMTP server in place of a provider's."""
    heard: list[str] = []
    listening = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = listening.accept()
        with connection, connection.makefile("rw", newline="\r\n") as lines:

            def say(line: str) -> None:
                lines.write(line + "\n")
                lines.flush()

            say("220 here")
            for line in lines:
                heard.append(line)
                if line.strip() == "DATA":
                    say("354 go on")
                elif line.strip() == ".":
                    say("250 taken")
                elif line.upper().startswith("QUIT"):
                    say("221 bye")
                    return
                elif heard.count("DATA\r\n") + heard.count("DATA\n") <= heard.count(".\r\n") + heard.count(".\n"):
                    say("250 yes")

    threading.Thread(target=serve, daemon=True).start()
    port = listening.getsockname()[1]
    with enable_notifications(
        addresses_of([f"mailto://127.0.0.1:{port}?from=hfb@example.org&to=team@example.org&mode=insecure"])
    ):
        notify("clips", [TROUBLE], COUNTS)
    listening.close()
    assert any("team@example.org" in line for line in heard)


@pytest.mark.parametrize("trouble", ["refused", "500", "redirect", "nobody", "slow"])
def test_a_receiver_that_fails_ends_nothing(
    trouble: str,
    receiver: Receiver,
    clips: Path,
    store: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(notifications, "_PATIENCE_S", 1.0)
    address = receiver.address
    receiver.status = {"500": 500, "redirect": 307}.get(trouble, 200)
    receiver.location = receiver.address if trouble == "redirect" else ""
    receiver.delay_s = 5.0 if trouble == "slow" else 0.0
    if trouble == "refused":
        with socket.create_server(("127.0.0.1", 0)) as free:
            address = f"http://127.0.0.1:{free.getsockname()[1]}/{SECRET}"
    if trouble == "nobody":
        address = f"http://user:SECRET@nobody.invalid/{SECRET}"
    began = time.monotonic()
    with enable_notifications(addresses_of([address])):
        told = batch(clips, tmp_path / "out", small_config().model_dump(mode="json"), workers=1)
    assert told["set_aside"] == 1
    assert time.monotonic() - began < 60
    assert "notification 1 could not be sent" in caplog.text
    assert "SECRET" not in caplog.text
    assert len(receiver.posts) <= 1, "nothing is sent twice, or after a redirection"


def test_addresses_come_from_the_environment_too(
    receiver: Receiver, clips: Path, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(notifications.VARIABLE, f"{receiver.address}  slack:{receiver.address}")
    assert len(addresses_of([receiver.address])) == 2
    deployed_batch(clips, tmp_path / "out", attempts=1)
    assert len(receiver.posts) == 2


@pytest.mark.parametrize("address", ["SECRET", "block:SECRET", "https:SECRET", "", "//SECRET", "c:\\SECRET"])
def test_what_is_no_address_is_said_before_work_begins(
    address: str, clips: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match="address 1 of --notify"):
        addresses_of([address])
    assert main(["batch", str(clips), "--out", str(tmp_path / "out"), "--notify", address]) == 2
    said = "".join(capsys.readouterr())
    assert "mailtos://USER" in said
    assert "SECRET" not in said
    assert not (tmp_path / "out").exists()


def test_a_batch_that_ends_early_is_told(receiver: Receiver, clips: Path, store: Path, tmp_path: Path) -> None:
    with enable_notifications(addresses_of([receiver.address])):
        notifications.notify_end("clips", "the server went away")
    ((_, told),) = receiver.posts
    assert told["event"] == "batch ended"
    assert "the server went away" in told["text"]
