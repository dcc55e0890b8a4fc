"""The first Prefect server of a home makes its tables alone."""

import threading
from pathlib import Path

from flows.surroundings import FirstStart


def test_two_first_servers_come_one_after_the_other(tmp_path: Path) -> None:
    first = FirstStart(tmp_path / "home")
    waited: list[FirstStart] = []
    second = threading.Thread(target=lambda: waited.append(FirstStart(tmp_path / "home")))
    second.start()
    second.join(0.5)
    assert second.is_alive(), "it has to wait for the tables"
    first.there_are_tables()
    second.join(10)
    assert not second.is_alive()
    FirstStart(tmp_path / "home").there_are_tables()  # nobody waits any more


def test_a_first_server_that_fails_leaves_it_to_the_next(tmp_path: Path) -> None:
    FirstStart(tmp_path).let_go()
    FirstStart(tmp_path).there_are_tables()
