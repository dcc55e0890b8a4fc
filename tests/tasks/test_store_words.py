"""What a store's library says becomes the beginning of a sentence: its reason, without what surrounds it."""

import pytest

from hfb.tasks.tracking.store_client import StoreLost, store_losses

_RETRIES = (
    "API request to http://a:5 failed with exception HTTPConnectionPool(host='a', port=5): Max retries exceeded with"
)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "(raised as a result of Query-invoked autoflush; consider using a session.no_autoflush block)\n"
            "(sqlite3.OperationalError) attempt to write a readonly database\n[SQL: insert]",
            "attempt to write a readonly database",
        ),
        ("(psycopg2.OperationalError) server closed the connection\n\tat once", "server closed the connection"),
        (
            f"{_RETRIES} url: /b (Caused by NewConnectionError(\"HTTPConnection(host='a', port=5): Failed to "
            'establish a new connection: [Errno 111] Connection refused"))',
            "[Errno 111] Connection refused",
        ),
        (
            f"{_RETRIES} url: /b (Caused by ResponseError('too many 500 error responses'))",
            "too many 500 error responses",
        ),
        (
            f'{_RETRIES} url: /b (Caused by ReadTimeoutError("Pool: Read timed out. (read timeout=9)"))',
            "Read timed out",
        ),
        ("x" * 5000, "x" * 160),
        ("", "OSError"),
    ],
)
def test_the_reason_alone(text: str, reason: str) -> None:
    with pytest.raises(StoreLost) as lost, store_losses():
        raise OSError(text)
    assert str(lost.value) == reason
