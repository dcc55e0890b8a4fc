"""Hide passwords and tokens in logs, messages, records and pages.

All text that leaves hfb goes through `without_secrets`, or through `hidden_in` where it is plain content. Light to
import.
"""

from __future__ import annotations

import logging
import os
import re
from base64 import b64encode
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import quote, unquote, urlsplit, urlunsplit

HIDDEN = "***"
_NAMES = (
    r"(?:[\w.-]*[._-])?(?:pass(?:word|wd|phrase|code)?|pwd?|token|secret|signature|sig|api[_-]?key|access[_-]?key(?:[_-]?id)?|"
    r"secret[_-]?(?:access[_-]?)?key|account[_-]?key|private[_-]?key|auth[_-]?string|credentials?|authorization)|"
    r"pgpassword|AWSAccessKeyId|GoogleAccessId|accesstoken|sessiontoken|securitytoken|sharedaccesskey|sharedaccesssignature"
)
"""Names of secret values: `sig` of Azure, `X-Amz-Signature`, `MLFLOW_TRACKING_TOKEN` ..."""
_QUERY_NAMES = r"key|code|auth|sas|hmac|jwt|sid|session(?:[_-]?id)?|ticket|assertion"  # secret in an address alone
_CERTAIN_NAMES = (
    r"(?:[\w.-]*[._-])?(?:pass(?:word|wd|phrase)|pwd|(?:api|access|secret|account|private)[_-]?key|auth[_-]?string)"
)
_ISSUED = (
    r"(?:hf|gh[pousr]|npm|pn[ub])_[A-Za-z0-9]{20,}|(?:github_pat_|glpat-|xox[abeoprs]-|sk-|pypi-|AIza)(?=[\w-]*\d)[\w-]{20,}|"
    r"dapi[0-9a-f]{32}|A[KS]IA[0-9A-Z]{16}|eyJ[\w-]+\.eyJ[\w-]+\.[\w-]*"
)
"""Tokens that begin as their services issue them: Hugging Face, GitHub, GitLab, Slack, Prefect, PyPI, JWT ..."""

_RULES: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"(\b[a-zA-Z][\w+.-]{0,30}://[^\s/:@'\"]*):[^\s'\"]{0,4096}@"), rf"\1:{HIDDEN}@"),
    (re.compile(r"(\b[a-zA-Z][\w+.-]{0,30}://)(?!\*\*\*)[^\s/:@'\"?#]+@"), rf"\1{HIDDEN}@"),
    (re.compile(r"(?i)(\b[a-z][\w+.-]{0,30}%3A%2F%2F)(?:(?!%2F|%26)[^\s'\"&]){1,4096}?%40"), rf"\1{HIDDEN}%40"),
    (  # webhooks, whose path alone lets anybody post
        re.compile(
            r"(?i)((?:hooks\.slack|discord|discordapp|telegram|(?:webhook|outlook)\.office|maker\.ifttt|events\.pagerduty)"
            r"\.(?:com|org)/)[^\s'\"?#<>*]+"
        ),
        rf"\1{HIDDEN}",
    ),
    (re.compile(r"(?i)(\bhttps?://[^\s'\"?#]{1,200}/(?:web)?hooks?/)[^\s'\"?#<>*]+"), rf"\1{HIDDEN}"),
    (  # of Apprise, whose addresses are tokens
        re.compile(
            r"(?i)\b((?:slack|discord|tgram|msteams|workflows?|pover|pbul|gotifys?|ifttt|mmosts?|ntfys?)://)[^\s'\"]+"
        ),
        rf"\1{HIDDEN}",
    ),
    (re.compile(r"(?<![\w.:+%-])([\w.+%-]+:)[^\s/\\@:'\"]+(@(?!sha256:)[a-zA-Z0-9\[])"), rf"\1{HIDDEN}\2"),
    (
        re.compile(
            r"(?i)\b((?:proxy-)?authorization\\?[\"']?\s*(?:[:=]|%3A|%3D)\s*\\?[\"']?"
            r"(?:(?:bearer|basic|digest|token|negotiate|sharedkey|api-?key|key|ntlm|oauth)(?:\s+|%20|\+))?)[^\s'\",;&\\]+"
        ),
        rf"\1{HIDDEN}",
    ),
    (re.compile(r"(?i)\b(bearer(?:\s+|%20))[\w+/=.~-]{8,}"), rf"\1{HIDDEN}"),
    (re.compile(r"(?i)\b(basic\s+)(?=\S*[\d=])[\w+/=-]{8,}"), rf"\1{HIDDEN}"),
    (re.compile(r"(?i)\b((?:set-)?cookie\\?[\"']?\s*:\s*\\?[\"']?)[^\r\n'\"\\]+"), rf"\1{HIDDEN}"),
    (re.compile(r"(?i)\b(x-[\w-]*(?:key|token|signature|credential|secret)\s*:\s*)[^\s'\",;]+"), rf"\1{HIDDEN}"),
    (
        re.compile(
            rf"(?i)(?:(?<![\w.-])|(?<=%26|%3F|%23|%3B))((?:{_NAMES})(?:\s?=\s?|%(?:25)*3D))\\?[\"']?"
            r"(?:(?!%26)[^&\s'\"<>\\])+"
        ),
        rf"\1{HIDDEN}",
    ),
    (re.compile(rf"(?i)([?&;](?:{_QUERY_NAMES})=)[^&\s'\"<>#]+"), rf"\1{HIDDEN}"),
    (re.compile(rf"(?i)(?<![\w-])(--(?:{_NAMES})(?:\s+|[\"'],\s*[\"']))(?!-)[^\s'\"]+"), rf"\1{HIDDEN}"),
    (re.compile(r"(?<![\w-])((?:--(?:proxy-)?user|-u)[\s=]+[\w.@-]+:)(?!\d+\b)[^\s'\"]+"), rf"\1{HIDDEN}"),
    (re.compile(rf"(?i)(?<![\w.-])((?:{_CERTAIN_NAMES})\s*:\s*[\"']?)(?![\"'*])[^\s'\",;]+"), rf"\1{HIDDEN}"),
    (re.compile(rf"(?i)(?<![\w.-])((?:{_NAMES})\s*:\s*[\"']?)(?=[\w+/=.~-]*\d)[\w+/=.~-]{{8,}}"), rf"\1{HIDDEN}"),
    (re.compile(rf"(?<![\w-])(?:{_ISSUED})"), HIDDEN),
    (re.compile(r"(-----BEGIN [A-Z ]*PRIVATE KEY-----)[^-]+"), rf"\1{HIDDEN}"),
    (re.compile(rf"(?i)(\\?[\"'](?:{_NAMES})\\?[\"']\s*:\s*\\?[\"'])[^'\"\\]+"), rf"\1{HIDDEN}"),
)
_SECRETS = (
    "PREFECT_API_AUTH_STRING",
    "PREFECT_SERVER_API_AUTH_STRING",
    "PREFECT_API_KEY",
    "MLFLOW_TRACKING_PASSWORD",
    "MLFLOW_TRACKING_TOKEN",
    "MLFLOW_FLASK_SERVER_SECRET_KEY",
    "AWS_SECRET_ACCESS_KEY",
    "AWS_SESSION_TOKEN",
    "PGPASSWORD",
)
_SECRET_NAME = re.compile(rf"(?i)(?:{_NAMES}|.*(?:connection_string|sas))$")
_SHORTEST, _SHORTEST_GUESSED = 4, 8  # a shorter value would be hidden wherever its letters stand by chance


def without_secrets(text: str) -> str:
    """Hide every secret of a text: in addresses and headers, by its name, and values of the environment.

    Args:
        text: any text.
    """
    for value in _held():
        text = text.replace(value, HIDDEN)
    for pattern, shown in _RULES:
        text = pattern.sub(shown, text)
    return text


def hidden_in(content: Any) -> Any:
    """Return plain content with `without_secrets` applied to each of its texts; texts named as secrets are hidden.

    Args:
        content: of JSON.
    """
    if isinstance(content, dict):
        return {name: hidden_in(value) if _is_shown(name, value) else HIDDEN for name, value in content.items()}
    if isinstance(content, list | tuple):
        return [hidden_in(one) for one in content]
    return without_secrets(content) if isinstance(content, str) else content


def secret_entry(content: Mapping[str, Any]) -> str | None:
    """Return the name of the first entry that holds a secret; None where there is none.

    Args:
        content: of JSON.
    """
    return next((name for name, value in content.items() if hidden_in({name: value}) != {name: value}), None)


def _is_shown(name: Any, value: Any) -> bool:
    return not (isinstance(name, str) and isinstance(value, str) and value and _SECRET_NAME.match(name))


def without_login(address: str) -> str:
    """Return an http address without the user name and password in it.

    Args:
        address: of a server.
    """
    parts = urlsplit(address)
    return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))


def shown_address(address: str) -> str:
    """Return an address for display: without a login, its tokens hidden.

    Args:
        address: of a server.
    """
    return without_secrets(without_login(address))


def _held() -> Iterator[str]:
    """Yield secrets of the environment, also as encoded in addresses and headers; the longest first."""
    found: set[str] = set()
    for name, value in os.environ.items():
        least = _SHORTEST if name in _SECRETS else _SHORTEST_GUESSED
        if len(value) >= least and (name in _SECRETS or _SECRET_NAME.match(name)) and value[:1] != "/":
            found |= {value, quote(value, safe=""), b64encode(value.encode()).decode()}
        elif "://" in value and "@" in value:
            password = value.partition("://")[2].rpartition("@")[0].partition(":")[2]
            found |= {one for one in (password, unquote(password)) if len(one) >= _SHORTEST_GUESSED}
    yield from sorted(found, key=len, reverse=True)


class SecretFormatter(logging.Formatter):
    """Hides passwords in every line, tracebacks included."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record without secrets.

        Args:
            record: of the log.
        """
        return without_secrets(super().format(record))
