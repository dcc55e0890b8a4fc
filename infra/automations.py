"""Automations of Prefect's server for runs of hfb: an end for those that died, a message about those that crashed."""

from __future__ import annotations

import sys
from datetime import timedelta
from urllib.parse import urlsplit

from apprise import Apprise
from prefect.blocks.core import Block
from prefect.blocks.notifications import CustomWebhookNotificationBlock, SlackWebhook
from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.objects import StateType
from prefect.events.actions import ChangeFlowRunState, SendNotification
from prefect.events.schemas.automations import AutomationCore, EventTrigger, Posture
from prefect.events.schemas.events import ResourceSpecification
from prefect.types import SecretDict

_BEAT = "prefect.flow-run.heartbeat"
_ENDS = ("Completed", "Failed", "Cancelled", "Crashed", "Paused", "Suspended")
_BEATS_MISSED = 3
_ANY_RUN = ResourceSpecification({"prefect.resource.id": ["prefect.flow-run.*"]})
_SUBJECT = "hfb: {{ flow_run.name }} crashed"
_BODY = """flow run {{ flow_run.name }} of {{ flow.name }} crashed: {{ flow_run.state.message }}
Nothing of it is lost: started again with the same parameters, it goes on. {{ flow_run|ui_url }}"""


def end_dead_runs(client: SyncPrefectClient, beat_s: int) -> None:
    """Crashed for a run that was heard of once and then neither beats nor ends: its worker or its machine is gone."""
    patience_s = _BEATS_MISSED * beat_s
    dead = AutomationCore(
        name="hfb: end runs that died",
        description=f"a flow run without a heartbeat for {patience_s} s is Crashed; started again, it goes on",
        trigger=EventTrigger(
            after={_BEAT},
            expect={_BEAT, *(f"prefect.flow-run.{end}" for end in _ENDS)},
            match=_ANY_RUN,
            for_each={"prefect.resource.id"},
            posture=Posture.Proactive,
            threshold=1,
            within=timedelta(seconds=patience_s),
        ),
        actions=[ChangeFlowRunState(state=StateType.CRASHED, message="no heartbeat: its worker or machine is gone")],
    )
    _put(client, dead)


def tell_of_crashes(client: SyncPrefectClient, addresses: list[str]) -> None:
    """A message to every address when a flow run has crashed; none, and the automation is taken away."""
    name = "hfb: tell of crashed runs"
    if not addresses:
        for old in client.read_automations_by_name(name):
            client.delete_automation(old.id)
        return
    blocks = [_block(address).save(f"hfb-notify-{place}", overwrite=True) for place, address in enumerate(addresses)]
    told = AutomationCore(
        name=name,
        description="set up by infra/deploy.py from HFB_NOTIFY",
        trigger=EventTrigger(
            expect={"prefect.flow-run.Crashed"},
            match=_ANY_RUN,
            for_each={"prefect.resource.id"},
            posture=Posture.Reactive,
            threshold=1,
        ),
        actions=[SendNotification(block_document_id=one, subject=_SUBJECT, body=_BODY) for one in blocks],
    )
    _put(client, told)


def addresses_of(words: str) -> list[str]:
    """The addresses of HFB_NOTIFY, which commas or blanks separate; the program ends at one that cannot be used."""
    addresses = words.replace(",", " ").split()
    for place, address in enumerate(addresses, 1):
        if not _is_webhook(address) and not Apprise().add(address):
            scheme = urlsplit(address).scheme
            sys.exit(
                f"HFB_NOTIFY: address {place} ({scheme or 'without a scheme'}:...) is none that can be told: give a "
                "webhook (https://...), Slack's (https://hooks.slack.com/services/...) or an address of Apprise "
                "(mailtos://...)"
            )
    return addresses


def _is_webhook(address: str) -> bool:
    parts = urlsplit(address)
    return parts.scheme in ("http", "https") and bool(parts.hostname) and not _is_slack(parts.hostname or "")


def _is_slack(host: str) -> bool:
    return host in ("hooks.slack.com", "hooks.slack-gov.com")


def _block(address: str) -> Block:
    """Slack's block hands every address that is not Slack's to Apprise: e-mail and a hundred other services."""
    if not _is_webhook(address):
        return SlackWebhook(url=address)
    message = {"subject": "{{subject}}", "text": "{{body}}"}
    secrets = SecretDict({"address": address})  # it may hold a token, and the field `url` is shown
    return CustomWebhookNotificationBlock(name="hfb", url="{{address}}", json_data=message, secrets=secrets)


def _put(client: SyncPrefectClient, automation: AutomationCore) -> None:
    for old in client.read_automations_by_name(automation.name):
        client.delete_automation(old.id)
    client.create_automation(automation)
