"""Check addresses of servers: their form, and whether the server answers. Light to import."""

from __future__ import annotations

import re
from http.client import HTTPException
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import urlopen

from hfb.errors import InputError
from hfb.tasks.telemetry.secrets import without_login, without_secrets
from hfb.tasks.tracking.patience import within

_ASKS_FOR_A_LOGIN = (401, 403)
_HOST = re.compile(r"[^\s/\\@<>\"'`{}|^%]+")


def check_address(variable: str, address: str, example: str) -> None:
    """Check that an address has the form of a server's; nothing is sent.

    Args:
        variable: environment variable that holds it.
        address: as the user set it.
        example: a correct address.

    Raises:
        InputError: it is no http or https address with a host.
    """
    if reason := _fault(address):
        shown = without_secrets(address)
        raise InputError(f"{variable} is {shown!r}, {reason}: set it to an address like {example}, or unset it")


def no_answer(address: str, patience_s: float) -> str | None:
    """Return why a server is unusable; None where it answers, including with a request to log in.

    Args:
        address: an http address that answers to GET.
        patience_s: for the whole answer, however slowly its bytes come.
    """

    def request() -> None:
        with urlopen(without_login(address), timeout=patience_s):
            pass

    try:
        within(patience_s, request)
    except HTTPError as error:
        return None if error.code in _ASKS_FOR_A_LOGIN else f"answers {error.code}"
    except (URLError, OSError) as error:
        return f"does not answer ({getattr(error, 'reason', error)})"
    except (HTTPException, ValueError) as error:
        return f"does not answer as such a server does ({type(error).__name__})"
    return None


def _fault(address: str) -> str | None:
    if re.search(r"[\s\x00-\x1f\x7f]", address):
        return "which has a space or a control character in it"
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        return f"which is no address ({error})"
    if parts.scheme not in ("http", "https") or not parts.netloc:
        return "which does not begin with http:// or https://"
    if not host or not _HOST.fullmatch(host):
        return "which names no host"
    try:
        host.encode("idna")
    except UnicodeError:
        return "which names no host that there can be"
    return "whose port is 0" if port == 0 else None
