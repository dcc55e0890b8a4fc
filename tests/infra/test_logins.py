"""Guesses at a login are counted and held up; who has a right one is not."""

import httpx
import pytest

from tests.infra.asking import api
from tests.infra.team import Team, missing

pytestmark = pytest.mark.skipif(missing() is not None, reason=missing() or "")
_GUESSES = 40


def test_guesses_at_prefect_are_held_up(here: Team, anybody: httpx.Client) -> None:
    asked = f"{here.url('prefect')}/api/admin/version"
    codes = [anybody.get(asked, auth=("hfb", f"guess {number}")).status_code for number in range(_GUESSES)]
    assert set(codes) == {401, 429}
    assert codes.count(401) <= 15
    with api(here) as member, api(here, "prefect_admin") as administrator:
        assert member.get("/admin/version").status_code == 200
        assert administrator.get("/admin/version").status_code == 200
    assert anybody.get(f"{here.url('prefect')}/api/health").status_code == 200


def test_guesses_at_mlflow_are_held_up(here: Team, anybody: httpx.Client) -> None:
    asked = f"{here.url('mlflow')}/api/2.0/mlflow/users/current"
    right = ("admin", here.secret("mlflow_admin"))
    assert anybody.get(asked, auth=right).status_code == 200
    codes = [anybody.get(asked, auth=("admin", f"guess {number}")).status_code for number in range(_GUESSES)]
    assert set(codes) == {401, 403}
    assert codes.count(401) <= 25  # the rest was not even looked at
    assert anybody.get(asked, auth=right).status_code == 200
