"""The viewer out of the installed wheel and the catalog behind one address of this machine, for any browser."""

import http.client
import os
import re
import select
import socket
import subprocess
import threading
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, urlsplit

from pipeline.errors import ConfigError

LOCAL = "127.0.0.1"
PAGES: Mapping[str, str] = {
    "index.html": "text/html; charset=utf-8", "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm", "favicon.ico": "image/x-icon",
}
"""What the viewer consists of; its service worker is left out, it would outlive us in the browser."""
POLICY = ("default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; style-src 'self' "
          "'unsafe-inline'; img-src 'self' data: blob:; worker-src 'self' blob:; connect-src 'self' data: blob:; "
          "frame-ancestors 'self'")
"""Nothing is fetched from, or sent to, anywhere else."""
_HOSTED = re.compile(rb"Hosting a web-viewer at http://127\.0\.0\.1:(\d+)")
_ELSEWHERE = re.compile(rb"<link[^>]*https?://[^>]*>")
_HOP = frozenset({"connection", "keep-alive", "transfer-encoding", "te", "trailer", "upgrade", "host",
                  "proxy-connection", "expect"})
"""Headers between two neighbours, not between the ends."""
_START_S = 30.0
_LOOK_S = 0.2
"""How often a call that answers nothing looks whether everything ends [s]."""


def viewer_binary() -> Path:
    """The viewer that the installed package holds."""
    from importlib.util import find_spec

    spec = find_spec("rerun_cli")
    if spec is None or not spec.submodule_search_locations:
        raise ConfigError("the Rerun viewer is not installed", where="package rerun-sdk", mend="uv sync")
    return Path(spec.submodule_search_locations[0]) / "rerun"


def quiet() -> dict[str, str]:
    """This environment for Rerun's own programs; where CI is set they send no statistics of use."""
    return {**os.environ, "CI": "true"}


def viewer_pages() -> dict[str, bytes]:
    """File -> content of the web viewer, taken from the installed binary, which gives it out over HTTP only.

    Raises:
        ConfigError: the binary does not start.
    """
    command = [str(viewer_binary()), "--serve-web", "--bind", LOCAL, "--port", "auto", "--web-viewer-port", "0"]
    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                             env=quiet())
    giving_up = threading.Timer(_START_S, child.kill)
    giving_up.start()
    try:
        assert child.stdout is not None
        said = list[bytes]()
        for line in child.stdout:
            said.append(line)
            if found := _HOSTED.search(line):
                pages = {name: _get(int(found[1]), name) for name in PAGES}
                return pages | {"index.html": _ELSEWHERE.sub(b"", pages["index.html"])}
        last = said[-1].decode(errors="replace").strip() if said else "nothing"
        raise ConfigError(f"the Rerun viewer does not start: {last[-200:]}", where=command[0],
                          mend="install it again: uv sync --reinstall-package rerun-sdk")
    finally:
        giving_up.cancel()
        child.kill()
        child.communicate()


@contextmanager
def web_viewer(catalog: str, start: str, port: int = 0, pages: Mapping[str, bytes] | None = None) -> Generator[str]:
    """Serve viewer and catalog under one address while the body runs; the address is what a person opens.

    Args:
        catalog: address of the catalog, as rerun+http://127.0.0.1:PORT.
        start: what is opened first, an address within the catalog.
        port: where to listen; 0 for a free one.
        pages: see `viewer_pages`.

    Raises:
        ConfigError: the port is taken.
    """
    files = viewer_pages() if pages is None else pages
    behind = urlsplit(catalog.removeprefix("rerun+")).port or 0
    try:
        server = _Server((LOCAL, port), _Handler)
    except OSError as error:
        raise ConfigError(f"port {port} cannot be used ({error.strerror})", where=f"--port {port}",
                          mend="name another one, or leave --port away") from error
    address = f"http://{LOCAL}:{server.server_port}"
    inside = start.replace(catalog, f"rerun+{address}")
    server.files, server.behind, server.first = files, behind, f"/?url={quote(inside, safe='')}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield f"{address}/"
    finally:
        server.ending = True
        server.shutdown()
        server.server_close()
        thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    files: Mapping[str, bytes]
    behind: int
    first: str
    ending = False


class _Handler(BaseHTTPRequestHandler):
    """Files of the viewer by GET; the catalog's gRPC-Web by POST, passed on as it comes."""

    protocol_version = "HTTP/1.1"
    server: _Server  # pyright: ignore[reportIncompatibleVariableOverride]

    def do_GET(self) -> None:
        """A file of the viewer; the bare address leads to what was asked for."""
        path = urlsplit(self.path)
        name = path.path.lstrip("/") or "index.html"
        if not self._ours():
            return self._short(403)
        if name == "index.html" and not path.query:
            self.send_response(302)
            self.send_header("Location", self.server.first)
            self.send_header("Content-Length", "0")
            return self.end_headers()
        data = self.server.files.get(name)
        if data is None:
            return self._short(404)
        self.send_response(200)
        self.send_header("Content-Type", PAGES[name])
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(data)

    def do_POST(self) -> None:
        """A call of the catalog, passed on byte by byte; some answer for as long as the viewer is open."""
        self.close_connection = True
        if not self._ours() or not self.path.startswith("/rerun."):
            return self._short(403)
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        kept = [f"{k}: {v}" for k, v in self.headers.items() if k.lower() not in _HOP]
        head = [f"POST {self.path} HTTP/1.1", f"Host: {LOCAL}:{self.server.behind}", "Connection: close", *kept, "", ""]
        with socket.create_connection((LOCAL, self.server.behind)) as behind:
            behind.sendall("\r\n".join(head).encode("latin-1") + body)
            while not self.server.ending:
                ready, _, _ = select.select([behind, self.connection], [], [], _LOOK_S)
                if self.connection in ready:  # it asks nothing more on this connection: it went away
                    return
                if behind in ready:
                    piece = behind.recv(1 << 16)
                    if not piece:
                        return
                    self.connection.sendall(piece)

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: the terminal belongs to the person."""

    def _ours(self) -> bool:
        """Whether the request names this machine: a page elsewhere that rebinds its name to 127.0.0.1 does not."""
        port = self.server.server_port
        return self.headers.get("Host", "") in (f"{LOCAL}:{port}", f"localhost:{port}")

    def _short(self, status: int) -> None:
        self.send_response(status)
        self.send_header("Content-Length", "0")
        self.send_header("Connection", "close")
        self.end_headers()
        self.close_connection = True

    def handle(self) -> None:
        """Serve one connection; a browser that goes away in the middle is no fault."""
        with suppress(OSError):
            super().handle()


def _get(port: int, name: str) -> bytes:
    connection = http.client.HTTPConnection(LOCAL, port, timeout=_START_S)
    try:
        connection.request("GET", f"/{name}")
        return connection.getresponse().read()
    finally:
        connection.close()


@contextmanager
def native_viewer(start: str) -> Generator["subprocess.Popen[bytes]"]:
    """The viewer in a window of this machine's display, gone when the body ends.

    Args:
        start: what is opened first, an address within a catalog.
    """
    command = [str(viewer_binary()), start, "--bind", LOCAL, "--port", "auto", "--hide-welcome-screen"]
    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                             env=quiet())
    try:
        yield child
    finally:
        child.terminate()
        try:
            child.wait(5)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
