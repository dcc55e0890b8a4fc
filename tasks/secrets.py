"""Passwords are for the servers they are meant for: no log, message, record or page shows one. Light to import."""

from __future__ import annotations

import logging
import os
import re
from urllib.parse import urlsplit, urlunsplit

_HIDDEN = "***"
_IN_ADDRESS = re.compile(r"(\b[a-zA-Z][\w+.-]*://[^\s/:@'\"]*):[^\s'\"]*@")
_IN_QUERY = re.compile(r"(?i)([?&;](?:password|passwd|pwd|token|secret|api_?key|access_?key|signature)=)[^&\s'\"]+")
_SECRETS = (
    "PREFECT_API_AUTH_STRING", "PREFECT_SERVER_API_AUTH_STRING", "PREFECT_API_KEY", "MLFLOW_TRACKING_PASSWORD",
    "MLFLOW_TRACKING_TOKEN", "MLFLOW_FLASK_SERVER_SECRET_KEY", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN",
    "PGPASSWORD",
)  # fmt: skip
_SHORTEST = 4  # a shorter value would be hidden wherever its letters stand by chance


def without_secrets(text: str) -> str:
    """The text with every password hidden: those within addresses, and those that the environment holds."""
    for name in _SECRETS:
        value = os.environ.get(name, "")
        if len(value) >= _SHORTEST:
            text = text.replace(value, _HIDDEN)
    return _IN_QUERY.sub(rf"\1{_HIDDEN}", _IN_ADDRESS.sub(rf"\1:{_HIDDEN}@", text))


def without_login(address: str) -> str:
    """An http address without the name and password that may stand in it, to ask or to show: nobody's login."""
    parts = urlsplit(address)
    return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))


class SecretFormatter(logging.Formatter):
    """Hides passwords in every line, the account of an exception included."""

    def format(self, record: logging.LogRecord) -> str:
        """See the class."""
        return without_secrets(super().format(record))
