"""The services of infra/compose without Docker: settings files, scripts and secrets are the same.

PostgreSQL and nginx come from Debian; the store is moto's, which speaks S3. What differs from the containers is host
names, and who starts what.
"""

from __future__ import annotations

import os
import pwd
import random
import re
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

ROOT = Path(__file__).parents[2]
SETTINGS = ROOT / "infra" / "settings"
_SERVICES = ("postgres", "prefect", "mlflow", "store", "redis", "proxy", "worker")
_PATIENCE_S = 120


def missing() -> str | None:
    """Why the services cannot run on this machine; None where they can."""
    if postgres_programs() is None:
        return "needs PostgreSQL: the Debian package postgresql"
    if shutil.which("nginx") is None and not Path("/usr/sbin/nginx").exists():
        return "needs nginx: the Debian package nginx-light"
    if shutil.which("openssl") is None:
        return "needs openssl: the Debian package openssl"
    if os.geteuid() == 0 and "postgres" not in {user.pw_name for user in pwd.getpwall()}:
        return "PostgreSQL does not run as root, and there is no user postgres"
    return None


def postgres_programs() -> Path | None:
    """The folder of initdb and postgres, of the newest version there is."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda one: int(one.parts[-3]))
    if found:
        return found[-1].parent
    on_path = shutil.which("initdb")
    return Path(on_path).parent if on_path else None


@dataclass(frozen=True)
class Team:
    """Running services.

    Attributes:
        folder: logs, secrets and data.
        addresses: of each service, in place of its name.
    """

    folder: Path
    addresses: Mapping[str, str]

    def secret(self, name: str) -> str:
        """The content of a file of secrets."""
        return (self.folder / "secrets" / name).read_text()

    def url(self, service: str) -> str:
        """Where people find Prefect or MLflow: behind the proxy."""
        return f"https://{self.addresses['proxy']}:{_PORTS[service]}"

    def tls(self) -> ssl.SSLContext:
        """Trusts the proxy's certificate and no other."""
        return ssl.create_default_context(cafile=str(self.folder / "secrets" / "tls.crt"))

    def settings(self, *names: str) -> dict[str, str]:
        """The environment that settings files make, with addresses in place of names."""
        environment = {name: os.environ[name] for name in ("PATH", "LANG") if name in os.environ}
        environment |= {
            "HOME": str(self.folder),
            "PYTHONPATH": str(ROOT),
            "HFB_SECRETS": str(self.folder / "secrets"),
            "OMP_NUM_THREADS": "1",
            "XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache")),
        }
        for name in names:
            for line in (SETTINGS / name).read_text().splitlines():
                if line and not line.startswith("#"):
                    key, _, value = line.partition("=")
                    environment[key] = self.here(key, value, name.removesuffix(".env"))
        return environment

    def here(self, key: str, text: str, service: str) -> str:
        """A setting, or a whole file, as it is on this machine."""
        for name, address in self.addresses.items():
            text = re.sub(rf"(?<![\w.]){name}(?=:\d)", address, text)
        if key.endswith("HOST"):
            text = self.addresses.get(text, text.replace("0.0.0.0", self.addresses.get(service, "127.0.0.1")))
        places = {"/run/secrets/": "secrets/", "/etc/hfb/": "etc/", "/tmp/": f"tmp-{service}-", "/home/hfb/": "home-"}
        return re.sub("|".join(places), lambda found: f"{self.folder}/{places[found[0]]}", text)

    def run(self, command: list[str], environment: Mapping[str, str], name: str) -> subprocess.Popen[bytes]:
        """Start a program with the secrets that its settings name; its words go to NAME.log."""
        with (self.folder / f"{name}.log").open("ab") as log:
            return subprocess.Popen(
                [str(SETTINGS / "with-secrets.sh"), *command],
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                cwd=self.folder,
            )

    def log(self, name: str) -> str:
        """The end of what a service said."""
        return (self.folder / f"{name}.log").read_text(errors="replace")[-4000:]


_PORTS = {"prefect": 4200, "mlflow": 5000, "postgres": 5432, "store": 8333, "redis": 6379}


@contextmanager
def team() -> Iterator[Team]:
    """Database, store, Prefect, MLflow and the proxy; all of them end with the block."""
    network = (
        f"127.{random.randrange(16, 250)}.{random.randrange(1, 250)}"  # of Linux's loopback; tests may run at once
    )
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hfb-team-", ignore_cleanup_errors=True)))
        folder.chmod(0o755)
        here = Team(folder, {name: f"{network}.{number}" for number, name in enumerate(_SERVICES, 2)})
        prepare = [str(ROOT / "infra" / "compose" / "prepare.sh"), str(folder), here.addresses["proxy"]]
        subprocess.run(prepare, check=True)
        (folder / "etc").mkdir()
        (folder / "etc" / "mlflow-auth.ini").write_text(
            here.here("", (SETTINGS / "mlflow-auth.ini").read_text(), "mlflow")
        )
        stack.enter_context(_postgres(here))
        python = [sys.executable, "-m"]
        store = [*python, "moto.server", "-H", here.addresses["store"], "-p", str(_PORTS["store"])]
        stack.enter_context(_service(here, "store", store, here.settings()))
        stack.enter_context(
            _service(here, "prefect", [*python, "prefect", "server", "start"], here.settings("prefect.env"))
        )
        hosts = ",".join(f"{here.addresses[name]}:{_PORTS['mlflow']}" for name in ("proxy", "mlflow"))
        mlflow = here.settings("mlflow.env", "store.env") | {
            "MLFLOW_SERVER_ALLOWED_HOSTS": hosts,
            "MLFLOW_SERVER_CORS_ALLOWED_ORIGINS": here.url("mlflow"),
            "MLFLOW_WORKERS": "1",
        }
        stack.enter_context(_service(here, "mlflow", [*python, "mlflow", "server", "--app-name", "basic-auth"], mlflow))
        wait_for(f"http://{here.addresses['prefect']}:{_PORTS['prefect']}/api/health", here, "prefect")
        wait_for(f"http://{here.addresses['mlflow']}:{_PORTS['mlflow']}/health", here, "mlflow")
        stack.enter_context(_proxy(here))
        wait_for(f"{here.url('prefect')}/api/health", here, "proxy")
        yield here


def wait_for(url: str, here: Team, name: str) -> None:
    """Until an address answers; what the service said where it does not."""
    until = time.monotonic() + _PATIENCE_S
    while True:
        try:
            with urlopen(url, timeout=5, context=here.tls() if url.startswith("https") else None):
                return
        except (URLError, OSError) as error:
            if time.monotonic() > until:
                raise AssertionError(f"{name} does not answer ({error}): {here.log(name)}") from error
            time.sleep(0.2)


@contextmanager
def _service(
    here: Team, name: str, command: list[str], environment: Mapping[str, str], end: int = signal.SIGTERM
) -> Iterator[None]:
    process = here.run(command, environment, name)
    try:
        yield
    finally:
        stop(process, end)


def stop(process: subprocess.Popen[bytes], with_signal: int = signal.SIGTERM) -> None:
    """End a program and whatever it started."""
    for one, patience_s in ((with_signal, 10), (signal.SIGKILL, 10)):
        try:
            os.killpg(process.pid, one)
        except ProcessLookupError:
            return
        try:
            process.wait(patience_s)
        except subprocess.TimeoutExpired:
            continue
    process.wait()


@contextmanager
def _postgres(here: Team) -> Iterator[None]:
    programs, data = postgres_programs(), here.folder / "postgres"
    assert programs is not None
    as_owner: list[str] = []
    password = here.folder / "postgres" / "password"
    password.write_text(here.secret("postgres_password"))
    data = data / "15"
    if os.geteuid() == 0:
        as_owner = ["runuser", "-u", "postgres", "--"]
        for one in (data.parent, password):
            shutil.chown(one, "postgres")
    initdb = ["initdb", "--username", "hfb", "--pwfile", str(password), "--auth", "scram-sha-256", "--no-sync"]
    subprocess.run(
        [*as_owner, str(programs / initdb[0]), *initdb[1:], str(data)], check=True, stdout=subprocess.DEVNULL
    )
    server = [str(programs / "postgres"), "-D", str(data), "-h", here.addresses["postgres"], "-k", str(data)]
    with _service(here, "postgres", [*as_owner, *server, "-c", "fsync=off"], here.settings(), signal.SIGINT):
        until = time.monotonic() + _PATIENCE_S
        while subprocess.run(
            psql(here, "--command", "select 1"), env=pg_environment(here), capture_output=True
        ).returncode:
            assert time.monotonic() < until, here.log("postgres")
            time.sleep(0.1)
        made = psql(here, "--file", str(SETTINGS / "databases.sql"))
        subprocess.run(made, env=pg_environment(here), check=True, stdout=subprocess.DEVNULL)
        yield


def pg_environment(here: Team) -> dict[str, str]:
    """How PostgreSQL's own programs find the database."""
    path = f"{postgres_programs()}:{os.environ['PATH']}"
    return {"PATH": path, "PGHOST": here.addresses["postgres"], "PGPASSWORD": here.secret("postgres_password")}


def psql(here: Team, *arguments: str, database: str = "postgres") -> list[str]:
    """A command line for the database."""
    return [str((postgres_programs() or Path()) / "psql"), "--username", "hfb", "--dbname", database, *arguments]


@contextmanager
def _proxy(here: Team) -> Iterator[None]:
    """Start nginx with the template of infra/settings; the container image adds the rest of its configuration."""
    rules = here.here("", (SETTINGS / "proxy.conf.template").read_text(), "proxy")
    rules = rules.replace("${HFB_HOST}", here.addresses["proxy"])
    rules = re.sub(r"listen (\d+) ssl", rf"listen {here.addresses['proxy']}:\1 ssl", rules)
    rules = rules.replace("127.0.0.1:5001", f"{here.addresses['proxy']}:5001")
    folder = here.folder / "nginx"
    folder.mkdir()
    (folder / "rules.conf").write_text(rules)
    places = "".join(f"{kind}_temp_path {folder};" for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
    owner = "user root;" if os.geteuid() == 0 else ""
    (folder / "nginx.conf").write_text(
        f"daemon off; {owner} pid {folder}/pid; error_log stderr;\nevents {{}}\n"
        f"http {{ access_log off; {places}\ninclude {folder}/rules.conf; }}\n"
    )
    program = shutil.which("nginx") or "/usr/sbin/nginx"
    with _service(here, "proxy", [program, "-p", str(folder), "-c", str(folder / "nginx.conf")], here.settings()):
        yield


def free_of(address: str, port: int) -> bool:
    """Whether nothing listens there."""
    with socket.socket() as probe:
        return probe.connect_ex((address, port)) != 0
