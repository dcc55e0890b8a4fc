"""Passwords: in no message, log, link or record."""

import logging
from pathlib import Path

import pytest

from hfb.errors import InputError
from hfb.flows.cli.cli import main
from hfb.tasks.telemetry.secrets import SecretFormatter, without_login, without_secrets
from hfb.tasks.tracking import tracking
from hfb.tasks.tracking.store_place import check_store, on_server

PASSWORD = "pa/ss:w@rd"


@pytest.mark.parametrize(
    "text",
    [
        f"postgresql+psycopg2://hfb:{PASSWORD}@db:5432/mlflow",
        f"http://hfb:{PASSWORD}@host:5000",
        f"see http://host/x?token={PASSWORD}&a=1",
        f"s3://bucket?access_key={PASSWORD}",
        f"postgresql://:{PASSWORD}@db",
        f"API request to https://a:{PASSWORD}@b/api/2.0 failed, then https://a:{PASSWORD}@b/c",
    ],
)
def test_what_stands_in_addresses(text: str) -> None:
    shown = without_secrets(text)
    assert PASSWORD not in shown
    assert "***" in shown
    assert shown.partition("***")[0] == text.partition(PASSWORD)[0]


def test_what_has_no_secret_stays() -> None:
    for text in ("http://127.0.0.1:5000/#/a?workflowType=b", "sqlite:////a/b.db", "a@b.c: 3", "12:30 http://h/x", ""):
        assert without_secrets(text) == text
    assert without_login("http://127.0.0.1:5000/a?b=c#d") == "http://127.0.0.1:5000/a?b=c#d"
    assert without_login("https://hfb:secret@host:5000/a") == "https://host:5000/a"


def test_what_the_environment_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PREFECT_API_AUTH_STRING", "admin:letmein")
    monkeypatch.setenv("MLFLOW_TRACKING_PASSWORD", "swordfish")
    monkeypatch.setenv("PGPASSWORD", "a")  # too short to be told from a letter
    assert without_secrets("401 for admin:letmein, swordfish, a") == "401 for ***, ***, a"


def test_a_log_hides_them_in_exceptions_too() -> None:
    address = f"http://hfb:{PASSWORD}@host"
    try:
        raise OSError(f"cannot reach {address}")
    except OSError as error:
        record = logging.LogRecord("a", logging.ERROR, "", 0, "%s", (address,), (OSError, error, error.__traceback__))
    shown = SecretFormatter("%(message)s").format(record)
    assert "Traceback" in shown
    assert PASSWORD not in shown


def test_a_server_that_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    uri = "http://hfb:s3cret-word@127.0.0.1:9"
    assert on_server(uri)
    with pytest.raises(InputError, match="does not answer") as caught:
        check_store(uri)
    assert "s3cret-word" not in str(caught.value)
    run = tracking.Run(uri, "1", "abc", 0, True)
    assert tracking.link(run).startswith("http://127.0.0.1:9/#/")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", uri)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(b"")
    words = ["fit", str(tmp_path / "a.png"), "--background", str(tmp_path / "b.png"), "--out", str(tmp_path / "out")]
    assert main([*words, "--json"]) == 2
    told = capsys.readouterr()
    assert "s3cret-word" not in told.out + told.err
    assert "does not answer" in told.err
