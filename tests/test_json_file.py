"""JSON from anywhere: read, or one sentence."""

import os
from pathlib import Path

import pytest

from hfb.errors import InputError
from hfb.io.json_file import JSON_LIMIT_BYTES, read_json
from hfb.io.safe_folder import NotOrdinary


def test_plain_content_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"a": [1, 2.5, null, {"b": "c"}]}')
    assert read_json(tmp_path / "a.json") == {"a": [1, 2.5, None, {"b": "c"}]}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "is damaged"),
        ("{", "is damaged"),
        ("[" * 100_000, "without end"),
        ("[" * 40 + "]" * 40, "without end"),
        ('{"a": NaN}', "NaN is not a finite number"),
        ("[1e999]", "1e999 is not a finite number"),
        ("9" * 5000, "is damaged"),
        ("\xff", "is damaged"),
    ],
)
def test_what_is_no_json_is_one_sentence(content: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(InputError, match=says) as raised:
        read_json(tmp_path / "a.json")
    assert str(tmp_path / "a.json") in str(raised.value)
    assert "make the result again" in str(raised.value)


def test_what_is_no_file_is_said_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.json")
    (tmp_path / "folder.json").mkdir()
    with (tmp_path / "large.json").open("wb") as file:
        file.truncate(JSON_LIMIT_BYTES + 1)
    (tmp_path / "mine").write_text("{}")
    (tmp_path / "link.json").symlink_to(tmp_path / "mine")
    kinds = {
        "pipe": "named pipe",
        "folder": "another kind",
        "none": "missing",
        "large": "far more than",
        "link": "symbolic",
    }
    for name, says in kinds.items():
        with pytest.raises(InputError, match=says):
            read_json(tmp_path / f"{name}.json")


def test_a_link_above_a_file_is_followed_only_where_the_user_named_it(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "a.json").write_text("{}")
    (tmp_path / "link").symlink_to(tmp_path / "inner")
    assert read_json(tmp_path / "link" / "a.json") == {}
    with pytest.raises(NotOrdinary, match="link is a symbolic link"):
        read_json(tmp_path / "link" / "a.json", root=tmp_path)
