"""Who is told of crashed runs: which words of HFB_NOTIFY are addresses, and which Prefect block each becomes."""

import importlib
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def automations(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "infra"))
    return importlib.import_module("automations")


@pytest.mark.parametrize("address", ["nobody", "gopher://x", "https://", "mailtos://", "slack", "://", "file:///etc"])
def test_an_address_that_cannot_be_told_ends_the_set_up(address: str, automations: ModuleType) -> None:
    with pytest.raises(SystemExit, match="HFB_NOTIFY: address 2") as ended:
        automations.addresses_of(f"https://example.org/hook {address}")
    assert "\n" not in str(ended.value)


def test_a_token_is_not_shown(automations: ModuleType) -> None:
    with pytest.raises(SystemExit) as ended:
        automations.addresses_of("odd://name:secret@host/token")
    assert "secret" not in str(ended.value)
    assert "token" not in str(ended.value)


@pytest.mark.parametrize(
    ("address", "block"),
    [
        ("https://example.org/hook?token=x", "CustomWebhookNotificationBlock"),
        ("http://127.0.0.1:8080/hook", "CustomWebhookNotificationBlock"),
        ("https://hooks.slack.com/services/T0000AAAA/B0000BBBB/cccccccccccccccccccccccc", "SlackWebhook"),
        ("mailtos://ann:password@example.org?to=bob@example.org", "SlackWebhook"),  # hands it to Apprise
    ],
)
def test_an_address_becomes_a_block(address: str, block: str, automations: ModuleType) -> None:
    assert automations.addresses_of(f" {address},") == [address]
    made = automations._block(address)
    assert type(made).__name__ == block
    if block.startswith("Custom"):
        assert made._build_request_args("body", "subject")["url"] == address
        assert address not in str(made.url)
    else:
        assert len(made._apprise_client) == 1


def test_nobody_is_told_where_nobody_is_named(automations: ModuleType) -> None:
    assert automations.addresses_of("") == []
