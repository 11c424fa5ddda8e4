"""The same for programs: jobs over HTTP with JSON, described at /api/openapi.json, and a recording's state over a WebSocket."""

import json
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from lmeasure.core import LMeasureError, version_of
from lmeasure.text import message
from lmeasure.workbench import forms
from lmeasure.workbench.answers import Bench, bench_of, job_of, page
from lmeasure.workbench.project import OWN
from lmeasure.workbench.text import why
from lmeasure.workflows import COMMANDS, load, options_of


def _commands() -> list[str]:
    return [name for name in COMMANDS if name not in forms.NOT_HERE]


def project(request: Request) -> Response:
    """Return the content of the project."""
    found = bench_of(request).project.found
    return JSONResponse({"files": [{"kind": one.kind, "path": one.path} for one in found]})


async def jobs(request: Request) -> Response:
    """All jobs; posted {command, settings}, one is begun."""
    bench = bench_of(request)
    if request.method == "GET":
        return JSONResponse({"jobs": [job.about() for job in bench.jobs.all()]})
    content, error = await _content(request)
    command, given = content.get("command"), content.get("settings", {})
    if error or not isinstance(command, str) or command not in _commands() or not isinstance(given, dict):
        return JSONResponse({"error": error or "wanted: {command: one of those of /api/commands, settings: {name: value}}"}, 422)
    try:
        requested = {key: _as_text(value) for key, value in given.items() if value is not None}
        words = await run_in_threadpool(forms.command_words, command, requested, bench.folder)
        job = await bench.jobs.begin(words)
    except LMeasureError as failed:
        return JSONResponse({"error": why("en", failed), "option": getattr(failed, "option", "")}, 422)
    return JSONResponse(job.about(), 201)


async def _content(request: Request) -> tuple[dict[str, Any], str]:
    if request.headers.get("content-type", "").split(";")[0].strip() != "application/json":
        return {}, "the content is not application/json"
    try:
        content = json.loads(await request.body())
        json.dumps(content, ensure_ascii=False).encode()  # lone surrogates, which cannot be encoded
    except (ValueError, RecursionError):
        return {}, "the content is not JSON"
    return (content, "") if isinstance(content, dict) else ({}, "the content is not an object")


def _as_text(value: Any) -> Any:
    """A value as a form has it."""
    if isinstance(value, bool):
        return value
    return [str(one) for one in value] if isinstance(value, list) else str(value)


async def job(request: Request) -> Response:
    """Return one job, with its output; posted to its end, it is ended."""
    found = job_of(request)
    if request.method == "DELETE":
        await bench_of(request).jobs.cancel(found)
    elif request.method == "POST":
        content, error = await _content(request)
        if error or not isinstance(content.get("line"), str):
            return JSONResponse({"error": error or "wanted: {line: text}"}, 422)
        return JSONResponse({"taken": await bench_of(request).jobs.type(found, content["line"])})
    return JSONResponse(found.about() | {"said": found.said, "last": found.last})


def commands(request: Request) -> Response:
    """Every command with its options."""
    every = {name: [o._asdict() for o in options_of(load(name).settings)] for name in _commands()}
    return JSONResponse({"commands": every})


def openapi(request: Request) -> Response:
    """The API as OpenAPI 3.1, its bodies from the settings' own models."""
    return JSONResponse(described())


def described() -> dict[str, Any]:
    """See `openapi`."""
    bodies: list[dict[str, Any]] = []
    schemas: dict[str, Any] = {}
    for name in _commands():
        schema = load(name).settings.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas |= schema.pop("$defs", {})
        schemas[f"{name}-settings"] = schema | {"title": f"{name} settings"}
        reported = {"command": {"const": name}, "settings": {"$ref": f"#/components/schemas/{name}-settings"}}
        bodies.append({"type": "object", "properties": reported, "required": ["command", "settings"]})
    schemas["job"] = {
        "type": "object",
        "properties": {
            "number": {"type": "integer"},
            "command": {"type": "string"},
            "line": {"type": "string", "description": "the command line that does the same"},
            "state": {"enum": ["running", "done", "failed", "cancelled", "interrupted"]},
            "begun": {"type": "string", "format": "date-time"},
            "ended": {"type": "string"},
            "progress": {"type": ["object", "null"]},
            "result": {"type": ["object", "null"], "description": "the document of --json (docs/command-line.md)"},
        },
    }
    ok = {"description": "done", "content": {"application/json": {"schema": {"$ref": "#/components/schemas/job"}}}}
    number = {"name": "number", "in": "path", "required": True, "schema": {"type": "integer"}}
    body = {"required": True, "content": {"application/json": {"schema": {"oneOf": bodies}}}}
    line = {"type": "object", "properties": {"line": {"type": "string"}}, "required": ["line"]}
    typed = {"required": True, "content": {"application/json": {"schema": line}}}
    plain = {"200": {"description": "done"}}
    return {
        "openapi": "3.1.0",
        "info": {"title": "lmeasure workbench", "version": version_of("lmeasure"), "description": __doc__},
        "security": [{"token": []}],
        "paths": {
            "/api/project": {"get": {"summary": message("workbench.project_has"), "responses": plain}},
            "/api/commands": {"get": {"summary": message("workbench.every_command_options"), "responses": plain}},
            "/api/jobs": {
                "get": {"summary": message("workbench.all_jobs_newest_first"), "responses": plain},
                "post": {
                    "summary": message("workbench.begin_command"),
                    "requestBody": body,
                    "responses": {"201": ok, "422": {"description": "refused, and why"}},
                },
            },
            "/api/jobs/{number}": {
                "parameters": [number],
                "get": {"summary": message("workbench.job_all_said"), "responses": {"200": ok}},
                "post": {"summary": message("workbench.type_line"), "requestBody": typed, "responses": plain},
                "delete": {"summary": message("workbench.end_job_ctrl_c"), "responses": {"200": ok}},
            },
            "/api/jobs/{number}/live": {
                "parameters": [number],
                "get": {"summary": message("workbench.websocket_every_event_job"), "responses": plain},
            },
        },
        "components": {
            "schemas": schemas,
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer", "description": f"PROJECT/{OWN}/token has it"}},
        },
    }


async def live(socket: WebSocket) -> None:
    """Every event of a job, as it comes."""
    bench: Bench = socket.app.state.bench
    found = bench.jobs.jobs.get(int(socket.path_params["number"]))
    if found is None:
        await socket.close(1008)
        return
    await socket.accept()
    try:
        async for event in bench.jobs.watch(found):
            await socket.send_json(event)
        await socket.close()
    except WebSocketDisconnect:
        return


def reported(request: Request) -> Response:
    """The API for people."""
    return page(request, "api.html", described=described())


ROUTES = (
    Route("/api", reported),
    Route("/api/openapi.json", openapi),
    Route("/api/project", project),
    Route("/api/commands", commands),
    Route("/api/jobs", jobs, methods=["GET", "POST"]),
    Route("/api/jobs/{number:int}", job, methods=["GET", "POST", "DELETE"]),
    WebSocketRoute("/api/jobs/{number:int}/live", live),
)
