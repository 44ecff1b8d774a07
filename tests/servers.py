"""Real HTTP servers on this machine, for tests of what downloads and uploads."""

import base64
import hashlib
import json
import os
from collections.abc import Collection, Mapping
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Event, Thread
from typing import Any, TypeVar
from urllib.parse import unquote, urlsplit

PATIENCE = 300
"""Seconds: longer than anything takes that a test waits for, on however busy a machine."""

AnyServer = TypeVar("AnyServer", bound="LocalServer")


class LocalServer:
    """A server in a thread of its own, on a free port; ``close`` or the end of a ``with`` block stops it."""

    handler: type[BaseHTTPRequestHandler]

    def __init__(self) -> None:
        outer = self

        class Handler(self.handler):
            owner = outer

            def log_message(self, format: str, *args: object) -> None:
                """Tests read ``requests``, not the terminal."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        # Looks often whether it should stop: the half second that is the default would be waited for in every test.
        self._thread = Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        self._thread.start()

    def close(self) -> None:
        if self._thread.is_alive():
            self._server.shutdown()
            self._server.server_close()
            self._thread.join()

    def __enter__(self: AnyServer) -> AnyServer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class _FileHandler(BaseHTTPRequestHandler):
    owner: "FileServer"

    def do_GET(self) -> None:
        owner, asked = self.owner, self.headers.get("Range")
        owner.requests.append(asked)
        if owner.status != 200:
            self.send_error(owner.status)
            return
        begin, total = 0, len(owner.content)
        if asked and owner.ranges:
            begin = int(asked.removeprefix("bytes=").partition("-")[0])
            if begin >= total:
                self._head(416, {"Content-Range": f"bytes */{total}", "Content-Length": "0"})
                return
            headers = {"Content-Range": f"bytes {begin}-{total - 1}/{total}"}
            self._head(206, {**headers, "Content-Length": str(total - begin)})
        else:
            self._head(200, {"Content-Length": str(total)} if owner.length else {})
        self.wfile.write(owner.content[begin:][: owner.stop_after])
        if owner.stall is not None:
            owner.stall.wait()

    def _head(self, status: int, headers: dict[str, str]) -> None:
        owner = self.owner
        self.send_response(status)
        for name, value in {"Content-Type": owner.content_type, **headers}.items():
            self.send_header(name, value)
        if owner.etag is not None:
            self.send_header("ETag", owner.etag)
        if owner.modified is not None:
            self.send_header("Last-Modified", formatdate(owner.modified, usegmt=True))
        self.end_headers()


class FileServer(LocalServer):
    """One file, at every address. What the server does is in its attributes, and may change between requests."""

    handler = _FileHandler

    def __init__(self, content: bytes) -> None:
        self.content = content
        self.content_type = "application/octet-stream"
        self.etag: str | None = '"first"'
        self.modified: float | None = None
        """Seconds since 1970."""
        self.status = 200
        self.length = True
        """Whether an answer says its length."""
        self.ranges = True
        """Whether parts are sent; else the whole file, whatever is asked."""
        self.stop_after: int | None = None
        """Bytes of an answer after which the connection is closed."""
        self.stall: Event | None = None
        """What the server waits for before it closes a connection."""
        self.requests: list[str | None] = []
        """The Range header of every request."""
        super().__init__()

    def close(self) -> None:
        if self.stall is not None:
            self.stall.set()
        super().close()


class _HubHandler(BaseHTTPRequestHandler):
    owner: "FakeHub"
    protocol_version = "HTTP/1.1"

    def do_HEAD(self) -> None:
        self._get()

    def do_GET(self) -> None:
        self._get()

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        path = self._log()
        if path == "/api/validate-yaml":
            self._json(200, {"errors": [], "warnings": []})
        elif self._token() is None:
            self._refuse(401, "", "Invalid username or password.")
        elif self._token() != self.owner.token:
            self._refuse(403, "", "You don't have the rights to do that.")
        elif path == "/api/repos/create":
            self._create(json.loads(body))
        else:
            self._change(path, body)

    def _get(self) -> None:
        api, repo, action, revision, file = self._parts(self._log())
        files = self.owner.repos.get(repo)
        if files is None or (repo in self.owner.private and self._token() != self.owner.token):
            self._refuse(404 if self._token() else 401, "RepoNotFound", "Repository not found")
        elif repo in self.owner.gated and not api and self._token() != self.owner.token:
            self._refuse(403 if self._token() else 401, "GatedRepo", f"Access to model {repo} is restricted.")
        elif revision not in ("main", commit := self.owner.commit(repo)):
            self._refuse(404, "RevisionNotFound", f"Invalid rev id: {revision}")
        elif api:
            self._json(200, {"id": repo, "sha": commit, "private": repo in self.owner.private})
        elif action != "resolve" or file not in files:
            self._refuse(404, "EntryNotFound", "Entry not found", {"X-Repo-Commit": commit})
        else:
            tag = f'"{hashlib.sha1(files[file]).hexdigest()}"'
            self._send(200, files[file], {"ETag": tag, "X-Repo-Commit": commit})

    def _create(self, wanted: dict[str, Any]) -> None:
        repo = f"{wanted['organization']}/{wanted['name']}"
        exists = repo in self.owner.repos
        if not exists:
            self.owner.repos[repo] = {}
            # Versions of the library before 1.8 say it by "private".
            if wanted.get("visibility") == "private" or wanted.get("private"):
                self.owner.private.add(repo)
        self._json(409 if exists else 200, {"url": f"{self.owner.url}/{repo}"})

    def _change(self, path: str, body: bytes) -> None:
        _, repo, action, _, _ = self._parts(path)
        if repo not in self.owner.repos:
            self._refuse(404, "RepoNotFound", "Repository not found")
        elif action == "preupload":
            names = [file["path"] for file in json.loads(body)["files"]]
            files = [{"path": name, "uploadMode": "regular", "shouldIgnore": False, "oid": None} for name in names]
            self._json(200, {"files": files})
        elif action == "commit":
            lines = [json.loads(line) for line in body.splitlines()]
            files = {value["path"]: value["content"] for kind, value in map(dict.values, lines) if kind == "file"}
            self.owner.repos[repo] |= {name: base64.b64decode(content) for name, content in files.items()}
            self.owner.commits.append((repo, lines[0]["value"]["summary"]))
            commit = self.owner.commit(repo)
            self._json(200, {"commitUrl": f"{self.owner.url}/{repo}/commit/{commit}", "commitOid": commit})
        else:
            self._refuse(404, "", "No such page")

    def _log(self) -> str:
        path = unquote(urlsplit(self.path).path)
        self.owner.requests.append(f"{self.command} {path}")
        return path

    def _parts(self, path: str) -> tuple[bool, str, str, str, str]:
        """Whether it is the API, organisation/model, what is done, revision, file."""
        api = path.startswith("/api/models/")
        parts = path.removeprefix("/api/models").split("/", 5)[1:]
        parts += [""] * (5 - len(parts))
        return api, f"{parts[0]}/{parts[1]}", parts[2], parts[3] or "main", parts[4]

    def _token(self) -> str | None:
        words = self.headers.get("Authorization", "").split()
        return words[1] if words else None

    def _refuse(self, status: int, code: str, message: str, headers: Mapping[str, str] | None = None) -> None:
        self._send(status, b"", {"X-Error-Code": code, "X-Error-Message": message, **(headers or {})})

    def _json(self, status: int, value: object) -> None:
        self._send(status, json.dumps(value).encode(), {"Content-Type": "application/json"})

    def _send(self, status: int, body: bytes, headers: Mapping[str, str]) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


class FakeHub(LocalServer):
    """As much of the Hugging Face Hub as downloading and pushing models needs.

    ``repos`` has the bytes of every file: ``{"organisation/model": {"config.json": b"{}"}}``; pushing changes it.
    Reading is free but for gated and private models; these, and all writing, ask for ``token``.
    """

    handler = _HubHandler

    def __init__(
        self,
        repos: Mapping[str, Mapping[str, bytes]],
        *,
        gated: Collection[str] = (),
        private: Collection[str] = (),
        token: str = "hf_right",
    ) -> None:
        self.repos = {name: dict(files) for name, files in repos.items()}
        self.gated, self.private, self.token = set(gated), set(private), token
        self.commits: list[tuple[str, str]] = []
        """(organisation/model, message) of what was pushed."""
        self.requests: list[str] = []
        """Method and path of every request."""
        super().__init__()

    def commit(self, repo: str) -> str:
        """The name of the only commit there is: a hash of the files."""
        digest = hashlib.sha1()
        for name, content in sorted(self.repos[repo].items()):
            digest.update(name.encode() + b"\0" + content + b"\0")
        return digest.hexdigest()

    def environment(self, home: Path, *, token: str | None = None, offline: bool = False) -> dict[str, str]:
        """Environment of a process that takes this for the Hub and keeps its cache in ``home``.

        Given to a process and not to a test, because ``huggingface_hub`` reads it once, when it is imported.
        """
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("HF_", "TRANSFORMERS_"))}
        ours = {"HF_ENDPOINT": self.url, "HF_HOME": str(home), "HF_HUB_DISABLE_XET": "1", "no_proxy": "127.0.0.1"}
        if token is not None:
            ours["HF_TOKEN"] = token
        if offline:
            ours["HF_HUB_OFFLINE"] = "1"
        return kept | ours
