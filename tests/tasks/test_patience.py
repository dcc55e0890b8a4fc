"""Waiting for servers ends, by the wall clock."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from hfb.errors import InputError
from hfb.tasks.tracking.addresses import check_address, no_answer
from hfb.tasks.tracking.patience import Patience, within


def test_a_result_or_an_error_or_an_end() -> None:
    assert within(5, lambda: 3) == 3
    with pytest.raises(ZeroDivisionError):
        within(5, lambda: 1 / 0)
    began = time.monotonic()
    with pytest.raises(TimeoutError, match="no answer"):
        within(0.2, lambda: time.sleep(30))
    assert time.monotonic() - began < 5


def test_patience_is_used_up_once_and_renewed_by_success() -> None:
    waiting = Patience(total_s=1.0, call_s=0.6)

    def wait(seconds: float) -> None:
        began = time.monotonic()
        with pytest.raises(TimeoutError):
            waiting.call(lambda: time.sleep(30))
        assert time.monotonic() - began == pytest.approx(seconds, abs=0.3)

    wait(0.6)
    wait(0.0)  # what is left is too short to be worth a try
    with pytest.raises(TimeoutError, match="did not answer before"):
        waiting.call(lambda: 3)
    waiting.another_try()
    assert waiting.call(lambda: 3) == 3
    wait(0.6)


def test_a_long_upload_is_not_cut_off() -> None:
    waiting = Patience(total_s=1.0, call_s=0.5)
    assert waiting.call(lambda: time.sleep(0.9) or 3, least_s=5) == 3


@contextmanager
def listener(says: bytes, every_s: float = 0.0) -> Iterator[str]:
    """A server that takes connections and sends something, byte by byte; nothing else."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    taken, _ = server.accept()
                except OSError:
                    return
                open_connections.append(taken)
                for byte in says:
                    try:
                        taken.sendall(bytes([byte]))
                    except OSError:
                        break
                    time.sleep(every_s)

        open_connections: list[socket.socket] = []
        threading.Thread(target=serve, daemon=True).start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}/health"
        for one in open_connections:
            one.close()


@pytest.mark.parametrize(
    ("says", "every_s"), [(b"", 0), (b"HTTP/1.1 200 OK\r\n" + b"X-A: b\r\n" * 900, 0.3)], ids=["silent", "byte by byte"]
)
def test_a_server_that_hangs(says: bytes, every_s: float) -> None:
    with listener(says, every_s) as address:
        began = time.monotonic()
        assert "does not answer" in (no_answer(address, 1) or "")
        assert time.monotonic() - began < 5


def test_a_server_of_another_kind() -> None:
    with listener(b"SSH-2.0-OpenSSH_9.2p1\r\n\r\n") as address:
        assert "does not answer" in (no_answer(address, 2) or "")


def test_a_dead_port() -> None:
    assert "refused" in (no_answer("http://127.0.0.1:9/health", 3) or "")


@pytest.mark.parametrize(
    "given",
    [
        "notaurl",
        "localhost:4200/api",
        "127.0.0.1:4200",
        "http//host/api",
        "http:host",
        "ftp://host/api",
        "http://",
        "http:///api",
        "http://host:notaport/api",
        "http://host:70000/api",
        "http://[::1/api",
        "http://a b/api",
        "http://host/api\n",
        " http://host/api",
        "file:///x",
        "http://\x00/api",
        "http://..:1/",
        "http://" + "a" * 80,
    ],
)
def test_malformed_addresses(given: str) -> None:
    with pytest.raises(InputError, match=r"PREFECT_API_URL is .* like http://127.0.0.1:4200/api, or unset it"):
        check_address("PREFECT_API_URL", given, "http://127.0.0.1:4200/api")


@pytest.mark.parametrize(
    "given",
    [
        "http://127.0.0.1:4200/api",
        "https://me:pass@host.example/api",
        "http://[::1]:4200/api",
        "http://bücher.example/api",
    ],
)
def test_addresses(given: str) -> None:
    check_address("PREFECT_API_URL", given, "")


def test_no_password_is_shown() -> None:
    with pytest.raises(InputError) as told:
        check_address("PREFECT_API_URL", "ftp://me:s3cret-word@host/api", "http://127.0.0.1:4200/api")
    assert "s3cret-word" not in str(told.value)
