"""The server of the page: on this machine only, and only for who knows its address."""

from __future__ import annotations

import json
import os
import secrets
import sys
import tempfile
import threading
import urllib.parse
from collections.abc import Callable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from levelflow.extraction import EmptyLevelSet
from levelflow.viewer.editing import STEPS, Editing
from levelflow.viewer.frames import Frames, Glance, Rank, Superseded
from levelflow.viewer.packing import pack
from levelflow.viewer.page import description, page, sliders
from levelflow.viewer.viewed import Viewed

FORMATS = ("ply", "stl", "glb", "usdc")
_LARGEST_PLANE = 512
_FINEST = 1024
_LONGEST_TEXT = 4 << 20


class Server(ThreadingHTTPServer):
    """Serves the page and what it asks for, on 127.0.0.1.

    The path of every address starts with a random token, and requests in another name than that of this machine, or
    from the pages of others, are refused: no other user and no other page can look. It writes nothing but handles that
    were read as such, into the file of `editing`.

    Args:
        viewed: What to show, side by side.
        port: The port; 0 takes a free one.
        resolution: Cells along the longest side of the box for a frame that is looked at.
        preview: The same for a frame on the way to it.
        editing: The handles of the first of what is viewed, if the page is to edit them.

    Attributes:
        url: The address of the page.
        frames: The frames that are kept.

    Raises:
        OSError: If the port is in use, or not allowed.
        ValueError: If a resolution is too small, or there is nothing to show.
    """

    daemon_threads = True
    allow_reuse_address = os.name == "posix"

    def __init__(
        self,
        viewed: Sequence[Viewed],
        *,
        port: int = 0,
        resolution: int = 128,
        preview: int = 64,
        editing: Editing | None = None,
    ) -> None:
        if not viewed:
            raise ValueError("Server(viewed=[]): there is nothing to show; give a field or a mesh.")
        if not 2 <= preview <= resolution <= _FINEST:
            raise ValueError(
                f"Server(resolution={resolution}, preview={preview}): give 2 <= preview <= resolution <= {_FINEST}."
            )
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except (OSError, OverflowError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise OSError(
                f"Server(port={port}): cannot listen there ({reason}); "
                "choose another port, or leave it out and a free one is taken."
            ) from None
        self.viewed, self.resolution, self.preview = tuple(viewed), resolution, preview
        self.frames, self.editing = Frames(viewed), editing
        self.times = sliders(viewed)
        self.token = secrets.token_urlsafe(16)
        self.url = f"http://127.0.0.1:{self.server_address[1]}/{self.token}/"

    def description(self) -> dict:
        """What the page has to know."""
        return description(
            self.viewed, self.times, resolution=self.resolution, preview=self.preview, editing=self.editing
        )

    def check_surface(self) -> None:
        """Computes the first frames, before anybody asks for them.

        Raises:
            EmptyLevelSet: If something has no surface at the first, the last and the middle of its times.
        """
        for i, one in enumerate(self.viewed):
            for share in (0.0, 1.0, 0.5):
                time = tuple(a + share * (b - a) for a, b in one.box.times)
                if one.surface(time, resolution=self.preview).mesh is not None:
                    break
            else:
                raise EmptyLevelSet(
                    f"view {one.name}: the field has no surface, as far as {self.preview} cells along the box can "
                    "tell; raise --preview, or train it for longer."
                )
            self.frames.get(i, tuple(a for a, _ in one.box.times), resolution=self.preview)

    def start(self) -> threading.Thread:
        """Serves in a thread of its own until `close`."""
        thread = threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        thread.start()
        return thread

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Says what went wrong with a connection, but for a browser that has gone away."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)

    def close(self) -> None:
        """Ends a server that was started."""
        self.shutdown()
        self.server_close()


class _Refused(Exception):
    """A request that is not answered, and why."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    server: Server
    protocol_version = "HTTP/1.1"
    # A page that goes away leaves its connection open.
    timeout = 60

    def do_GET(self) -> None:
        """Answers with what is asked for, or with a sentence that says why not."""
        self._respond(self._answer)

    def do_POST(self) -> None:
        """Answers to handles: deforms the surface, or puts them in their file."""
        # What is not read of a request would be taken for the next one.
        self.close_connection = True
        self._respond(self._edited)

    def _respond(self, answer: Callable[[str, dict[str, str]], tuple[str, bytes]]) -> None:
        try:
            kind, body = answer(*self._checked())
            self._send(200, kind, body)
        except Superseded:
            self._send(204, "application/octet-stream", b"")
        except _Refused as refusal:
            self._send_error(refusal.status, str(refusal))
        except (ValueError, ModuleNotFoundError) as error:
            self._send_error(400, str(error))
        except ConnectionError:
            self.close_connection = True
        except OSError as error:
            self._send_error(400, str(error))

    def log_message(self, format: str, *args: object) -> None:
        """Nothing is written down."""

    def _checked(self) -> tuple[str, dict[str, str]]:
        """The path behind the token, and the query, if the request comes from the page itself."""
        port = self.server.server_address[1]
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        if host not in (f"127.0.0.1:{port}", f"localhost:{port}"):
            raise _Refused(403, f"This server answers to 127.0.0.1:{port}, not to {host!r}.")
        if origin is not None and origin != f"http://{host}":
            raise _Refused(403, f"This server does not answer the pages of {origin!r}.")
        parts = urllib.parse.urlsplit(self.path)
        first, _, rest = parts.path.removeprefix("/").partition("/")
        if not secrets.compare_digest(first.encode(), self.server.token.encode()):
            raise _Refused(403, "The address is not complete; open the one that `levelflow view` wrote.")
        return rest, dict(urllib.parse.parse_qsl(parts.query))

    def _answer(self, path: str, query: dict[str, str]) -> tuple[str, bytes]:
        """The type and the content of an answer."""
        if path == "":
            return "text/html; charset=utf-8", page(self.server.description()).encode()
        if path == "meta":
            return "application/json", json.dumps(self.server.description()).encode()
        answers = {"frame": self._frame, "plane": self._plane, "export": self._export}
        if path not in answers:
            raise _Refused(404, f"There is no {path!r} here; known are meta, {', '.join(answers)}.")
        try:
            i = int(query.get("field", "0"))
            time = tuple(float(part) for part in query.get("t", "").split(",") if part)
        except ValueError:
            raise ValueError(f"{path}: field and t must be numbers, such as field=0&t=0.5.") from None
        if not 0 <= i < len(self.server.viewed):
            raise ValueError(f"{path}?field={i}: there are {len(self.server.viewed)} fields, numbered from 0.")
        return "application/octet-stream", answers[path](query, i, time)

    def _edited(self, path: str, query: dict[str, str]) -> tuple[str, bytes]:
        """The type and the content of an answer to handles, whose text is the body of the request."""
        editing = self.server.editing
        if editing is None or path not in ("handles", "deformed"):
            raise _Refused(404, f"There is nothing to send to {path!r}; with --handles known are handles, deformed.")
        if self.headers.get("Content-Type") != "application/json":
            raise _Refused(415, f"{path}: send handles as application/json.")
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > _LONGEST_TEXT:
            raise _Refused(413, f"{path}: send at most {_LONGEST_TEXT} bytes, and say how many.")
        try:
            text = self.rfile.read(int(length)).decode()
        except UnicodeDecodeError:
            raise ValueError(f"{path}: send handles as text in UTF-8.") from None
        if path == "handles":
            editing.save(text)
            return "application/json", json.dumps({"saved": str(editing.file)}).encode()
        steps = _whole(query, "steps", STEPS, 1, STEPS)
        surface = editing.deformed(text, way=query.get("way", "blended"), steps=steps, page=query.get("page", ""))
        return "application/octet-stream", pack(surface, self.server.frames.frames[0])

    def _frame(self, query: dict[str, str], i: int, time: tuple[float, ...]) -> bytes:
        resolution = _whole(query, "resolution", self.server.preview, 2, _FINEST)
        rank = Rank(_whole(query, "rank", 0, 0, len(Rank) - 1))
        glance = Glance(query.get("page", ""), _whole(query, "glance", 0, 0, 1 << 52))
        return self.server.frames.get(i, time, resolution=resolution, rank=rank, glance=glance)

    def _plane(self, query: dict[str, str], i: int, time: tuple[float, ...]) -> bytes:
        """f / scale on the square of a plane where one coordinate of the page is `offset` and the others in [-1, 1]."""
        n = _whole(query, "n", 96, 2, _LARGEST_PLANE)
        axis = _whole(query, "axis", 2, 0, 2)
        try:
            offset = float(query.get("offset", "0"))
        except ValueError:
            raise ValueError(f"plane?offset={query['offset']}: give a number.") from None
        one, frame = self.server.viewed[i], self.server.frames.frames[i]
        line = np.linspace(-1, 1, n)
        second, first = np.meshgrid(line, line, indexing="ij")
        points = np.full((n * n, 3), offset)
        points[:, (axis + 1) % 3], points[:, (axis + 2) % 3] = first.reshape(-1), second.reshape(-1)
        x = np.array(frame.center) + frame.scale * points[:, : one.box.space]
        return (one.values(x, time) / frame.scale).astype("<f4").tobytes()

    def _export(self, query: dict[str, str], i: int, time: tuple[float, ...]) -> bytes:
        """A file with the surface, at full resolution and with its vertices on it."""
        from levelflow.export.gltf import write_glb
        from levelflow.export.ply import write_ply
        from levelflow.export.printing import write_stl
        from levelflow.export.usd import write_usd

        kind = query.get("format", "ply")
        if kind not in FORMATS:
            raise ValueError(f"export?format={kind}: known are {', '.join(FORMATS)}.")
        snapshot = self.server.viewed[i].snapshot(time, resolution=self.server.resolution)
        assert snapshot.mesh is not None
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"surface.{kind}"
            if kind == "ply":
                write_ply(snapshot, file)
            elif kind == "stl":
                write_stl(snapshot.mesh, file)
            elif kind == "glb":
                write_glb([snapshot], file)
            else:
                write_usd([snapshot], file)
            return file.read_bytes()

    def _send_error(self, status: int, sentence: str) -> None:
        self._send(status, "application/json", json.dumps({"error": sentence}).encode())

    def _send(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("X-Frame-Options", "DENY")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()
        try:
            self.wfile.write(body)
        except ConnectionError:
            self.close_connection = True


def _whole(query: dict[str, str], name: str, default: int, least: int, most: int) -> int:
    """A whole number of a query."""
    text = query.get(name, str(default))
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if not least <= value <= most:
        raise ValueError(f"{name}={text}: give a whole number from {least} to {most}.")
    return value
