"""The page of `hfb app` and its routes, for one visitor on this machine.

Every address begins with a key that is new at each start, so that other users of the machine find nothing. Requests are
refused whose Host is not this server (DNS rebinding), and those that another page sends (Origin, Sec-Fetch-Site).
"""

from __future__ import annotations

import asyncio
import tempfile
import zipfile
from collections.abc import AsyncIterator, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hfb.config import RunConfig
from hfb.errors import InputError
from hfb.flows.app.jobs import Job, Jobs
from hfb.flows.app.request import MOST_BYTES, MOST_PICTURES, MOST_PIXELS, OPTIONS, RESULTS
from hfb.flows.app.upload import KIND, MOST_UPLOAD, receive
from hfb.interop.writers.export_names import REPORT
from hfb.io.media.footage_names import PICTURE_SUFFIXES
from hfb.io.safe_folder import open_file
from hfb.report.pages.page import page, page_file
from hfb.tasks.inputs.out_place import VIDEOS

_ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_NOTHING = "default-src 'none'; frame-ancestors 'none'"
_PAGE_POLICY = (
    "default-src 'none'; img-src 'self' blob: data:; media-src blob:; connect-src 'self'; frame-src 'self'; "
    "style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)  # the page's own policy, which holds besides, names its script by sha256
_REPORT_POLICY = (
    "sandbox allow-scripts allow-popups allow-popups-to-escape-sandbox; default-src 'none'; img-src data: blob:; "
    "media-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'self'"
)  # an origin of its own: a report that somebody changed reaches neither the page nor a network
_READ_BYTES = 1 << 18


class Guard:
    """Refuses what did not come from this server's own page, and adds the headers that every answer has."""

    def __init__(self, app: ASGIApp, hosts: frozenset[str]) -> None:
        """Wrap an application.

        Args:
            app: the application.
            hosts: names and ports under which it may be asked for.
        """
        self._app, self._hosts = app, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _ALWAYS.items():
                    headers[name] = value
                headers.setdefault("Content-Security-Policy", _NOTHING)
            await send(message)

        refusal = self._refusal(scope["method"], Headers(scope=scope))
        await (refusal or self._app)(scope, receive, with_headers)

    def _refusal(self, method: str, headers: Headers) -> Response | None:
        hosts = headers.getlist("host")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return PlainTextResponse("this server has another name", 421)
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return PlainTextResponse("another page asks: open the address that `hfb app` printed", 403)
        if method not in ("GET", "HEAD") and headers.getlist("origin") != [f"http://{hosts[0]}"]:
            return PlainTextResponse("another page asks: open the address that `hfb app` printed", 403)
        return None


def site(jobs: Jobs, config: RunConfig, key: str, port: int) -> Starlette:
    """Return the application.

    Args:
        jobs: of the folder.
        config: options that jobs have where the page says nothing else.
        key: first part of every address.
        port: of the server.
    """
    shown = _page(config)
    two_uploads = asyncio.Semaphore(2)

    def index(_: Request) -> Response:
        return HTMLResponse(shown, headers={"Content-Security-Policy": _PAGE_POLICY})

    def listed(_: Request) -> Response:
        return JSONResponse(jobs.summaries())

    async def upload(request: Request) -> Response:
        length = request.headers.get("content-length", "")
        if request.headers.get("content-type") != KIND or not length.isdecimal() or int(length[:12]) > MOST_UPLOAD:
            raise InputError(f"the files are larger than {MOST_BYTES >> 30} GB together, or there are none")
        chunks = _chunks(request)
        try:
            async with two_uploads:
                jobs.check_room()
                name, wanted = await receive(chunks, int(length), jobs.out)
        except InputError:
            async for _ in chunks:  # a browser reads an answer only once it has sent everything
                pass
            raise
        return JSONResponse(jobs.add(name, wanted).summary(), 201)

    def details(request: Request) -> Response:
        return JSONResponse(_job(jobs, request).details())

    def change(request: Request) -> Response:
        name = _job(jobs, request).folder.name
        what = {"again": jobs.again, "cancel": jobs.cancel, "remove": jobs.remove}.get(request.path_params["what"])
        if what is None:
            return _absent(request, KeyError())
        what(name)
        return JSONResponse({})

    def file(request: Request) -> Response:
        job, name = _job(jobs, request), request.path_params["file"]
        size = job.files()[name]
        return _download(_pieces(job, name), name, size)

    def report(request: Request) -> Response:
        job = _job(jobs, request)
        headers = {"Content-Length": str(job.files()[REPORT]), "Content-Security-Policy": _REPORT_POLICY}
        return StreamingResponse(_pieces(job, REPORT), media_type="text/html", headers=headers)

    def strip(request: Request) -> Response:
        job = _job(jobs, request)
        headers = {"Content-Length": str(job.files()["strip.png"])}
        return StreamingResponse(_pieces(job, "strip.png"), media_type="image/png", headers=headers)

    def everything(request: Request) -> Response:
        packed, size = _packed(_job(jobs, request))
        return _download(_read(packed), f"{request.path_params['job']}.zip", size)

    routes = [
        Route("/", index),
        Route("/jobs", listed, methods=["GET"]),
        Route("/jobs", upload, methods=["POST"]),
        Route("/jobs/{job}", details),
        Route("/jobs/{job}/report", report),
        Route("/jobs/{job}/strip", strip),
        Route("/jobs/{job}/all", everything),
        Route("/jobs/{job}/files/{file}", file),
        Route("/jobs/{job}/{what}", change, methods=["POST"]),
    ]
    handlers: Mapping[Any, Any] = {
        InputError: lambda _, error: JSONResponse({"error": str(error)}, 400),
        KeyError: _absent,
        FileNotFoundError: _absent,
    }
    hosts = frozenset({f"127.0.0.1:{port}", f"localhost:{port}"})
    guard = Middleware(Guard, hosts=hosts)
    return Starlette(routes=[Mount(f"/{key}", routes=routes)], middleware=[guard], exception_handlers=handlers)


def _page(config: RunConfig) -> str:
    given = config.model_dump(mode="json")
    values = {}
    for name in OPTIONS:
        section, _, key = name.rpartition(".")
        values[name] = given[section][key] if section else given[key]
    return page(
        "app.html",
        "Human from Blur",
        scripts=[page_file("app.js")],
        app_style=page_file("app.css"),
        values=values,
        limits={"bytes": MOST_BYTES, "pictures": MOST_PICTURES, "pixels": MOST_PIXELS, "kind": KIND},
        pictures=sorted(PICTURE_SUFFIXES),
        videos=sorted(VIDEOS),
    )


async def _chunks(request: Request) -> AsyncIterator[bytes]:
    try:
        async for chunk in request.stream():
            if chunk:
                yield chunk
    except ClientDisconnect:
        return


def _job(jobs: Jobs, request: Request) -> Job:
    return jobs[request.path_params["job"]]


def _absent(_: Request, __: Exception) -> Response:
    return JSONResponse({"error": "it is not there any more: load the page again"}, 404)


def _download(content: Iterator[bytes], name: str, size: int) -> Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Content-Length": str(size)}
    return StreamingResponse(content, media_type="application/octet-stream", headers=headers)


def _pieces(job: Job, name: str) -> Iterator[bytes]:
    """Yield a file of a job's result; no link is followed."""
    with open_file(job.folder, RESULTS, name) as file:
        yield from _read(file)


def _read(file: BinaryIO) -> Iterator[bytes]:
    while piece := file.read(_READ_BYTES):
        yield piece


def _packed(job: Job) -> tuple[BinaryIO, int]:
    """Return an archive of a job's result, in a file without a name, and its size."""
    packed = tempfile.TemporaryFile(dir=job.folder)  # noqa: SIM115  (it is gone once the answer is)
    with zipfile.ZipFile(packed, "w") as archive:
        for name in job.files():
            archive.writestr(zipfile.ZipInfo(f"{job.folder.name}/{Path(name).name}"), b"".join(_pieces(job, name)))
    size = packed.tell()
    packed.seek(0)
    return packed, size
