"""The files that bring up services: valid for Docker Compose and Kubernetes, and as closed as README.md there says."""

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from compose_spec import PyCompose

_INFRA = Path(__file__).parents[2] / "infra"
_COMPOSE = yaml.safe_load((_INFRA / "compose" / "compose.yaml").read_text())
_HIGH = yaml.safe_load((_INFRA / "compose" / "compose.ha.yaml").read_text())
_SECRET = re.compile(r"(?i)password|secret|auth_string|token|api_key|_url$")


def _services() -> dict[str, dict[str, Any]]:
    """All of both files, complete: what one extends is in it."""
    merged = dict(_COMPOSE["services"])
    for name, one in _HIGH["services"].items():
        base = merged.get(name) or merged.get(one.get("extends", {}).get("service"), {})
        both = {key: [*base[key], *one[key]] for key in ("secrets",) if key in base and key in one}
        merged[name] = {**base, **one, **both}
    return merged


def _manifests() -> list[dict[str, Any]]:
    files = sorted((_INFRA / "kubernetes").glob("*.yaml"))
    return [one for file in files if file.stem != "kustomization" for one in yaml.safe_load_all(file.read_text())]


def _pods() -> dict[str, dict[str, Any]]:
    found = {one["metadata"]["name"]: one["spec"] for one in _manifests()}
    specs = {name: spec.get("jobTemplate", {}).get("spec", spec) for name, spec in found.items()}
    return {name: spec["template"]["spec"] for name, spec in specs.items() if "template" in spec}


@pytest.mark.parametrize("name", ["compose.yaml", "compose.ha.yaml", "compose.notify.yaml"])
def test_compose_files_keep_to_the_specification(name: str) -> None:
    plain = yaml.safe_load((_INFRA / "compose" / name).read_text())  # anchors and merge keys are YAML's, not Compose's
    text = yaml.safe_dump({key: value for key, value in plain.items() if not key.startswith("x-")}, width=1000)
    text = re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text)  # a variable that is not set, as Compose puts it in
    PyCompose.from_yaml(re.sub(r"\$\{\w+[^}]*\}", "/srv", text))


def test_a_misspelt_key_is_no_compose_file() -> None:
    with pytest.raises(ValueError, match="imag"):
        PyCompose.from_yaml("services: {one: {imag: x}}")


def _leaves(tree: dict[str, Any], above: str = "") -> list[str]:
    return [
        leaf
        for name, value in tree.items()
        for leaf in (_leaves(value, f"{above}{name}.") if isinstance(value, dict) else [f"{above}{name}"])
    ]


def test_dask_knows_the_settings_of_its_workers() -> None:
    import dask.config
    import distributed  # noqa: F401 (brings the defaults)

    settings = yaml.safe_load((_INFRA / "settings" / "dask.yaml").read_text())
    unknown = object()
    assert _leaves(settings)
    assert [name for name in _leaves(settings) if dask.config.get(name, default=unknown) is unknown] == []


@pytest.mark.parametrize("manifest", _manifests(), ids=lambda one: f"{one['kind']}-{one['metadata']['name']}")
def test_manifests_keep_to_the_schemas(manifest: dict[str, Any]) -> None:
    import kubernetes_validate

    kubernetes_validate.validate(manifest, "1.34", strict=True)


@pytest.mark.parametrize("name", _services())
def test_a_service_can_do_no_more_than_its_work(name: str) -> None:
    service = _services()[name]
    assert service["user"] == "${HFB_UID:-1000}:${HFB_GID:-1000}"
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert not {"privileged", "network_mode", "pid", "ipc", "cap_add", "devices"} & set(service)
    assert not any("docker.sock" in str(one) for one in service.get("volumes", ()))
    if name != "setup":  # which ends
        assert service.get("healthcheck") or "worker" in name  # whose image has one
    assert ("ports" in service) == (name == "proxy")
    assert ("outside" in service["networks"]) == (name == "proxy")
    assert _COMPOSE["networks"]["inside"] == {"internal": True}


@pytest.mark.parametrize("name", _services())
def test_a_service_cannot_take_the_whole_machine(name: str) -> None:
    service = _services()[name]
    assert re.fullmatch(r"\d+[gm]|\$\{HFB_MEMORY:-8g\}", service["mem_limit"])
    assert service["cpus"] == "${HFB_CPUS:-2.0}" if "worker" in name or name == "setup" else 0 < service["cpus"] <= 1
    assert 0 < service["pids_limit"] <= 2048


def test_the_store_shows_nothing_but_s3() -> None:
    """SeaweedFS's master, volume server and filer ask nobody for a login."""
    (store,) = _pods()["store"]["containers"]
    for command in (_COMPOSE["services"]["store"]["command"], store["command"]):
        assert "-ip.bind=127.0.0.1" in command
        assert "-ip=127.0.0.1" in command
        assert not any("0.0.0.0" in one for one in command)
        (bound,) = [one for one in command if one.startswith("-s3.ip.bind=")]
        assert bound.partition("=")[2] in ("store", "$(POD_IP)")


@pytest.mark.parametrize("name", _services())
def test_an_image_is_one_version(name: str) -> None:
    _one_version(_services()[name]["image"])


def test_base_images_are_one_version() -> None:
    text = (_INFRA / "compose" / "Dockerfile").read_text()
    images, stages = re.findall(r"^FROM (\S+)", text, re.M), re.findall(r" AS (\S+)", text)
    for image in images:
        if image not in stages:
            _one_version(image)
    users = re.findall(r"^USER (\S+)", text, re.M)
    assert users == ["1000:1000"] * (len(stages) - 1)  # all but the first, which is nothing by itself


def _one_version(image: str) -> None:
    if image.startswith("hfb-"):
        return  # built here
    if image.startswith("redis:"):  # of HA alone: its digest is not known here, and the reader is told how to pin it
        assert re.fullmatch(r"redis:\d+\.\d+\.\d+-\w+", image), f"{image} is not one version"
        assert f"RepoDigests 0}}}}' {image}\n" in (_INFRA / "compose" / "README.md").read_text()
    else:
        assert re.search(r"@sha256:[0-9a-f]{64}$", image), f"{image} has no digest"
    assert re.search(r":\d+\.\d+(\.\d+)?(-|$)|@sha256:", image), f"{image} is not pinned"


def test_secrets_come_from_files() -> None:
    settings = sorted((_INFRA / "settings").glob("*.env"))
    pairs = [line.split("=", 1) for one in settings for line in one.read_text().splitlines() if "=" in line[:80]]
    for service in _services().values():
        environment = service.get("environment", {})
        pairs += list(environment.items()) if isinstance(environment, dict) else []
    for name, value in pairs:
        if _SECRET.search(name) and not name.endswith(("_API_URL", "_ENDPOINT_URL", "UI_API_URL")):
            assert name.endswith("_FILE"), name
            assert value.startswith("/run/secrets/"), name
        assert "://" not in value or "@" not in value or re.search(r"//hfb@", value), f"{name} holds a password"
    for file in {**_COMPOSE["secrets"], **_HIGH["secrets"]}.values():
        assert file["file"].startswith("${HFB_STATE}/secrets/")


def test_every_secret_that_a_service_reads_is_given_to_it() -> None:
    for name, service in _services().items():
        files = [_INFRA / "compose" / one for one in service.get("env_file", ())]
        text = "".join(one.read_text() for one in files)
        text += f"{service.get('environment', '')} {service.get('command', '')}"
        needed = set(re.findall(r"/run/secrets/([\w.]+)", text))
        assert needed <= set(service.get("secrets", ())), name
        assert set(service.get("secrets", ())) <= {*_COMPOSE["secrets"], *_HIGH["secrets"]}


@pytest.mark.parametrize("name", _pods())
def test_a_pod_can_do_no_more_than_its_work(name: str) -> None:
    pod = _pods()[name]
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["automountServiceAccountToken"] is False
    assert pod["enableServiceLinks"] is False
    (container,) = pod["containers"]
    assert container["securityContext"] == {
        "readOnlyRootFilesystem": True,
        "allowPrivilegeEscalation": False,
        "capabilities": {"drop": ["ALL"]},
    }
    _one_version(container["image"])
    assert container["resources"]["limits"]["memory"]
    if name not in ("setup", "backup"):  # which end
        assert container["livenessProbe"]
    assert not any(
        "value" in one and _SECRET.search(one["name"]) and not one["name"].endswith("_FILE")
        for one in container.get("env", ())
    )


def test_one_door_in_kubernetes() -> None:
    services = [one for one in _manifests() if one["kind"] == "Service"]
    assert [one["metadata"]["name"] for one in services if one["spec"].get("type", "ClusterIP") != "ClusterIP"] == [
        "proxy"
    ]
    policies = {one["metadata"]["name"]: one["spec"] for one in _manifests() if one["kind"] == "NetworkPolicy"}
    assert policies["inside"]["podSelector"] == {}
    assert policies["door"]["podSelector"] == {"matchLabels": {"app": "proxy"}}


def test_pods_find_what_they_name() -> None:
    files: dict[str, list[str]] = {}
    for place in ("settings", "compose"):
        generator = yaml.safe_load((_INFRA / place / "kustomization.yaml").read_text())["configMapGenerator"]
        made = {one["name"]: one.get("envs", []) + one.get("files", []) for one in generator}
        assert all((_INFRA / place / one.rpartition("=")[2]).is_file() for names in made.values() for one in names)
        files |= made
    keys = {one.partition("=")[0] for name in ("files", "backup") for one in files[name]}
    claims = {one["metadata"]["name"] for one in _manifests() if one["kind"] == "PersistentVolumeClaim"}
    for name, pod in _pods().items():
        (container,) = pod["containers"]
        maps = {one["configMapRef"]["name"] for one in container.get("envFrom", ())}
        assert maps <= {*files, "site"}, name
        settings = [_INFRA / "settings" / one for each in maps & set(files) for one in files[each]]
        text = (
            "".join(one.read_text() for one in settings)
            + str(container.get("env", ""))
            + str(container.get("command", ""))
        )
        volumes = {one["name"]: one for one in pod["volumes"]}
        given = {one["key"] for one in volumes["secrets"]["secret"]["items"]} if "secrets" in volumes else set()
        assert set(re.findall(r"/run/secrets/([\w.]+)", text)) <= given, name
        assert given <= set(_COMPOSE["secrets"]), name
        for volume in volumes.values():
            assert {one["key"] for one in volume.get("configMap", {}).get("items", ())} <= keys, name
            claims |= {"data-store-0"}  # the stateful set's own
            assert "persistentVolumeClaim" not in volume or volume["persistentVolumeClaim"]["claimName"] in claims, name
        templates = _templates_of(name)
        assert {one["name"] for one in container["volumeMounts"]} == {*volumes, *templates}, name


def _templates_of(name: str) -> set[str]:
    (workload,) = [
        one
        for one in _manifests()
        if {"template", "jobTemplate"} & set(one["spec"]) and one["metadata"]["name"] == name
    ]
    return {one["metadata"]["name"] for one in workload["spec"].get("volumeClaimTemplates", ())}


def test_both_ways_run_the_same_images_and_commands() -> None:
    for name, pod in _pods().items():
        if name == "backup":  # Docker's is a command of the administrator
            continue
        service, (container,) = _COMPOSE["services"][name], pod["containers"]
        assert container["image"] == service["image"].replace(":${HFB_VERSION:-local}", ""), name
        theirs = container.get("args") or container.get("command") or []
        ours = [*service.get("entrypoint", ()), *service.get("command", ())]
        ours = [one.replace("${HFB_FITS:-2}", "2") for one in ours]
        assert [one.replace("=store", "=$(POD_IP)") for one in ours] == theirs, name  # in a pod it is no own address


def test_prepared_secrets_stay_what_they_are(tmp_path: Path) -> None:
    prepare = [str(_INFRA / "compose" / "prepare.sh"), str(tmp_path / "team"), "hfb.example.org"]
    subprocess.run(prepare, check=True)
    made = {one.name: one.read_bytes() for one in (tmp_path / "team" / "secrets").iterdir()}
    wanted = {one["file"].rpartition("/")[2] for one in {**_COMPOSE["secrets"], **_HIGH["secrets"]}.values()}
    assert set(made) == wanted | {"prefect_admin"}  # which no service reads
    assert all((tmp_path / "team" / "secrets" / one).stat().st_mode & 0o077 == 0 for one in made)
    assert len(set(made.values())) == len(made)
    subprocess.run(prepare, check=True)
    (tmp_path / "team" / "secrets" / "prefect_admin").write_text("root:another")  # the proxy's file follows
    made["prefect_admin"] = b"root:another"
    logins = made.pop("proxy_logins").decode()
    assert "cm9vdDphbm90aGVy" not in logins
    subprocess.run(prepare, check=True)
    now = tmp_path / "team" / "secrets" / "proxy_logins"
    assert "cm9vdDphbm90aGVy" in now.read_text()
    now.unlink()
    assert made == {one.name: one.read_bytes() for one in (tmp_path / "team" / "secrets").iterdir()}
