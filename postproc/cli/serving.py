"""The overview of a folder on this machine: an HTTP server on 127.0.0.1 that only reads this folder."""

from __future__ import annotations

from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from postproc.errors import PostprocError

_RELOAD_S = 2
_NOTHING_YET = b"<!DOCTYPE html><title>postproc</title><p>No program has been converted yet."
_SHOWN = (".html", ".json", ".csv", ".glb", ".src", ".dat", ".mod")


def server(folder: Path, port: int) -> ThreadingHTTPServer:
    """Return a server of a folder, bound to 127.0.0.1.

    :param port: 0 = any that is free.
    :raises PostprocError: the port is in use.
    """
    try:
        return ThreadingHTTPServer(("127.0.0.1", port), partial(_Overview, directory=str(folder)))
    except OSError as cause:
        raise PostprocError(
            f"port {port} of 127.0.0.1 cannot be used ({cause.strerror}). Give another --port."
        ) from cause


class _Overview(SimpleHTTPRequestHandler):
    """Files of a folder; its overview reloads itself. Names of other hosts are refused (DNS rebinding)."""

    def do_GET(self) -> None:
        """Send a file of the folder."""
        host = (self.headers.get("Host") or "").rpartition(":")[0]
        path = self.path.partition("?")[0]
        if host not in ("127.0.0.1", "localhost"):
            self.send_error(403)
        elif path in ("/", "/index.html") and not (Path(self.directory) / "index.html").is_file():
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(_NOTHING_YET)))
            self.end_headers()
            self.wfile.write(_NOTHING_YET)
        elif path != "/" and (path.count("/") > 1 or not path.lower().endswith(_SHOWN)):
            self.send_error(404)
        else:
            super().do_GET()

    def do_HEAD(self) -> None:
        """Refuse: browsers do not need it."""
        self.send_error(405)

    def end_headers(self) -> None:
        """Let the overview reload itself, and nothing be kept."""
        if self.path.partition("?")[0] in ("/", "/index.html"):
            self.send_header("Refresh", str(_RELOAD_S))
        self.send_header("Cache-Control", "no-store")
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the terminal shows the programs."""
