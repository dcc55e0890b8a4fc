"""Messages about failed clips: to a webhook, to Slack, or by one of Prefect's notification blocks.

An address is a secret: whoever knows a webhook may write to it. It is never logged, recorded or a flow's parameter.
Light to import.
"""

from __future__ import annotations

import asyncio
import contextvars
import inspect
import json
import logging
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from http.client import HTTPMessage
from typing import IO, Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from hfb.errors import InputError
from hfb.tasks.telemetry import progress

VARIABLE = "HFB_NOTIFY"
"""Environment variable of addresses that are not given on the command line, separated by blanks."""

FORMS = (
    "https://... (a JSON object is posted, to Slack's incoming webhooks a text), slack:https://... (another server "
    "that takes Slack's messages), block:TYPE/NAME (a notification block of Prefect, such as block:slack-webhook/team),"
    " or an address of Apprise, such as mailtos://USER:PASSWORD@HOST"
)
_SLACK_HOSTS = ("hooks.slack.com", "hooks.slack-gov.com")
_PATIENCE_S = 15.0
_MOST_CLIPS = 20
_LONGEST_REASON = 300
_addresses: contextvars.ContextVar[tuple[str, ...]] = contextvars.ContextVar("addresses", default=())
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ClipTrouble:
    """A clip that failed.

    Attributes:
        state: ``failed`` (it is retried) or ``set aside``.
    """

    name: str
    state: str
    reason: str


def addresses_of(words: Sequence[str]) -> tuple[str, ...]:
    """Return the addresses of the command line and of the environment, checked.

    Args:
        words: on the command line.

    Raises:
        InputError: one of them has an unknown form.
    """
    found = tuple(dict.fromkeys((*words, *os.environ.get(VARIABLE, "").split())))
    for number, address in enumerate(found, 1):
        scheme, rest = address.partition(":")[::2]
        known = "/" in rest if scheme == "block" else rest.removeprefix("https:").removeprefix("http:").startswith("//")
        if not scheme.isalnum() or not known:
            raise InputError(f"address {number} of --notify or {VARIABLE} is none: give {FORMS}")
    return found


@contextmanager
def enable_notifications(addresses: Sequence[str]) -> Iterator[None]:
    """Send messages to these addresses inside the block; they are no parameter of a flow, since Prefect records those.

    Args:
        addresses: as `addresses_of` returns them.
    """
    token = _addresses.set(tuple(addresses))
    try:
        yield
    finally:
        _addresses.reset(token)


def notify(folder: str, troubles: Sequence[ClipTrouble], counts: Mapping[str, Any]) -> None:
    """Report failed clips to every address; a failure to send is a line on the terminal and ends nothing.

    Args:
        folder: name of the folder of clips.
        troubles: clips that failed in this round.
        counts: clips in each state, and ``page``.
    """
    if not troubles:
        return
    text = _text(folder, troubles, counts)
    failed = [{"name": one.name, "state": one.state, "reason": one.reason} for one in troubles]
    _tell(text, {"event": "clips failed", "folder": folder, "failed": failed, **counts})


def notify_end(folder: str, reason: str) -> None:
    """Report to every address that a batch ended early.

    Args:
        folder: name of the folder of clips.
        reason: one sentence.
    """
    _tell(f"hfb batch {folder} ended: {reason}", {"event": "batch ended", "folder": folder, "reason": reason})


def _tell(text: str, facts: Mapping[str, Any]) -> None:
    """Send to each address in its own thread, with a time limit: a slow receiver delays no clip."""
    waiting = []
    for number, address in enumerate(_addresses.get(), 1):
        context, failed = contextvars.copy_context(), [f"no answer within {_PATIENCE_S:.0f} s"]
        thread = threading.Thread(target=context.run, args=(_send, address, text, facts, failed), daemon=True)
        thread.start()
        waiting.append((number, thread, failed))
    for number, thread, failed in waiting:
        thread.join(_PATIENCE_S)
        if failed:  # the address itself is not named: it is a secret
            _log.info("notification %d could not be sent: %s", number, failed[0])
            progress.say(f"hfb: notification {number} could not be sent: {failed[0]}")


def _send(address: str, text: str, facts: Mapping[str, Any], failed: list[str]) -> None:
    """Send to one address; sets ``failed`` to the kind of an error only, since error texts contain addresses."""
    scheme, rest = address.partition(":")[::2]
    try:
        if scheme == "block":
            _by_block(rest, text)
        elif scheme == "slack" and not rest.startswith("//"):
            _post(rest, {"text": _for_slack(text)})
        elif scheme in ("http", "https") and urlsplit(address).hostname in _SLACK_HOSTS:
            _post(address, {"text": _for_slack(text)})
        elif scheme in ("http", "https"):
            _post(address, {"text": text, **facts})
        else:
            _by_apprise(address, text)
        failed.clear()
    except HTTPError as error:
        failed[0] = f"the receiver answered {error.code}"
    except OSError as error:
        reason = getattr(error, "reason", error)
        failed[0] = getattr(reason, "strerror", None) or type(reason).__name__
    except Exception as error:
        failed[0] = type(error).__name__


class _NoRedirects(HTTPRedirectHandler):
    """Refuses redirects: a receiver must not choose other addresses."""

    def redirect_request(
        self, req: Request, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage, newurl: str
    ) -> None:
        """Refuse the redirect."""


def _post(address: str, content: Mapping[str, Any]) -> None:
    body = json.dumps(content, allow_nan=False).encode()
    request = Request(address, body, {"Content-Type": "application/json", "User-Agent": "hfb"}, method="POST")
    with build_opener(_NoRedirects).open(request, timeout=_PATIENCE_S):
        pass


def _by_block(name: str, text: str) -> None:
    from prefect.blocks.abstract import NotificationBlock
    from prefect.blocks.core import Block

    block: Any = Block.load(name)
    if not isinstance(block, NotificationBlock):
        raise TypeError("no notification block")
    with _quiet():
        sent: Any = block.notify(text, subject="hfb batch")
        if inspect.iscoroutine(sent):  # of blocks that know no other way
            asyncio.run(sent)


def _by_apprise(address: str, text: str) -> None:
    from apprise import Apprise

    with _quiet():
        messenger = Apprise()
        if not messenger.add(address) or not messenger.notify(title="hfb batch", body=text):
            raise RuntimeError


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the libraries' logging inside the block: it contains addresses."""
    loggers = [logging.getLogger(name) for name in ("apprise", "httpx", "httpcore", "urllib3", "requests")]
    levels = [one.level for one in loggers]
    for one in loggers:
        one.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for one, level in zip(loggers, levels, strict=True):
            one.setLevel(level)


def _text(folder: str, troubles: Sequence[ClipTrouble], counts: Mapping[str, Any]) -> str:
    lines = [
        f"hfb batch {folder}: {len(troubles)} of {counts['clips']} clips failed or were set aside",
        *(f"- {one.name}: {one.state}: {one.reason[:_LONGEST_REASON]}" for one in troubles[:_MOST_CLIPS]),
    ]
    if len(troubles) > _MOST_CLIPS:
        lines.append(f"- and {len(troubles) - _MOST_CLIPS} more")
    return "\n".join([*lines, f"page: {counts['page']}"])


def _for_slack(text: str) -> str:
    """Escape text for Slack: names of clips must not mention a channel, or become links."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
