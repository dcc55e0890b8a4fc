"""Where parameters of a deployment may point, spelled in many ways."""

from pathlib import Path

import pytest

from hfb.config import RunConfig
from hfb.errors import InputError
from hfb.flows.runtime import places


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("data", "models", "secrets", "database"):
        (tmp_path / name).mkdir()
    (tmp_path / "models" / "net.pt").touch()
    (tmp_path / "data" / "out").symlink_to(tmp_path / "secrets")
    allowed = [str(tmp_path / "models"), "dask:tcp://scheduler:8786", "s3://bucket/hfb", "memory://"]
    monkeypatch.setenv("HFB_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("HFB_ALLOWED", " , ".join(allowed))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "data"


def test_below_the_folder(data: Path) -> None:
    for path in (
        data,
        data / "a.png",
        data / "new" / "a.png",
        data / "x" / ".." / "a.png",
        data.parent / "models" / "m",
    ):
        places.check_files("frames", path)
    places.check_files("frames", data.parent / "models" / "m")
    places.check_files("frames", [data / "a.png", data / "b.png"])
    places.check_files("frames", None)


@pytest.mark.parametrize(
    "spelled",
    [
        "/etc/passwd",
        "{data}/../secrets/a",
        "{data}/out/a",
        "{data}base/a",
        "data/../secrets",
        "a.png",
        "~/a",
        "file://{data}/a.png",
        "https://example.org/a.png",
        "/proc/self/environ",
        "{data}/../models.toml",
        "",
    ],
)
def test_outside_of_the_folder(spelled: str, data: Path) -> None:
    path = Path(spelled.format(data=data))
    with pytest.raises(InputError, match="HFB_ALLOWED") as refused:
        places.check_files("frames", [data / "good.png", path])
    assert "\n" not in str(refused.value)


def test_programs_come_from_the_administrators_list_alone(data: Path) -> None:
    places.check_programs("chains", data.parent / "models" / "net.pt")
    (data / "linked.pt").symlink_to(data.parent / "models" / "net.pt")
    places.check_programs("chains", data / "linked.pt")  # it is the one of the list
    (data.parent / "models" / "link.pt").symlink_to(data / "net.pt")
    for path in (data / "net.pt", Path("/net.pt"), data.parent / "models" / "link.pt"):
        with pytest.raises(InputError, match="is a program"):
            places.check_programs("chains", path)


@pytest.mark.parametrize("workers", [1, "4", "threads:2", "processes:2", "dask:tcp://scheduler:8786"])
def test_workers_that_may_be_named(workers: int | str, data: Path) -> None:
    places.check_addresses(workers, None)


@pytest.mark.parametrize(
    "workers",
    [
        "dask:tcp://scheduler:87860",
        "dask:tcp://scheduler:8786/x",
        "dask:tls://scheduler:8786",
        "ray:auto",
        " ray:auto",
        "dask:tcp://scheduler:8786@evil:1",
        "ray:ray://evil:10001",
    ],
)
def test_workers_that_may_not(workers: str, data: Path) -> None:
    with pytest.raises(InputError, match=r"workers: .* is an address"):
        places.check_addresses(workers, None)


@pytest.mark.parametrize(
    ("store", "good"),
    [
        ("s3://bucket/hfb", True),
        ("s3://bucket/hfb/", True),
        ("s3://bucket/hfb/deeper/x_1", True),
        ("s3://bucket/hfb2", False),
        ("s3://bucket", False),
        ("s3://bucket/hfb/../other", False),
        ("s3://bucket/hfb/x?endpoint=http://evil", False),
        ("s3://bucket/hfb/%2e%2e/other", False),
        ("/srv/shared", False),
        ("file:///srv", False),
        ("gs://bucket/hfb", False),
        ("s3://bucket/hfb@evil", False),
        ("", False),
    ],
)
def test_stores(store: str, good: bool, data: Path) -> None:
    if good:
        places.check_addresses("dask:tcp://scheduler:8786", store)
        return
    with pytest.raises(InputError, match=r"store: .*is an address"):
        places.check_addresses("dask:tcp://scheduler:8786", store)


@pytest.mark.parametrize(
    "name",
    ["body.model", "init.file", "init.weights", "init.mesh_sampling", "matting.weights", "prior.pose", "prior.motion"],
)
def test_every_option_that_names_a_file_is_looked_at(name: str, data: Path) -> None:
    room, _, field = name.partition(".")
    config = RunConfig.model_validate({room: {field: "/elsewhere"}})
    with pytest.raises(InputError, match=f"options.{name}: /elsewhere"):
        places.check_config(config)


def test_no_option_that_names_a_file_is_left_out() -> None:
    found = {
        f"{room}.{name}"
        for room, record in RunConfig.model_fields.items()
        for name, field in getattr(record.annotation, "model_fields", {}).items()
        if "Path" in str(field.annotation)
    }
    assert found == {
        "body.model",
        "init.file",
        "init.weights",
        "init.mesh_sampling",
        "matting.weights",
        "prior.pose",
        "prior.motion",
    }


def test_without_settings_it_is_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HFB_DATA", raising=False)
    monkeypatch.delenv("HFB_ALLOWED", raising=False)
    places.check_files("out", Path("/data/results"))
    with pytest.raises(InputError, match="lies outside /data"):
        places.check_files("out", Path("/srv/results"))
