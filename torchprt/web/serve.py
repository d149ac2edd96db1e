"""A web server for looking at a page on this machine."""

from __future__ import annotations

import functools
import os
import sys
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from torchprt.errors import InputError

# Browsers refuse modules of another type; what is registered on a machine differs from one to the next.
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".wasm": "application/wasm",
    ".gz": "application/gzip",
    ".glb": "model/gltf-binary",
    ".onnx": "application/octet-stream",
    ".jpg": "image/jpeg",
    ".txt": "text/plain; charset=utf-8",
}


class _Handler(SimpleHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def guess_type(self, path: Any) -> str:
        return TYPES.get(Path(str(path)).suffix.lower(), "application/octet-stream")

    def end_headers(self) -> None:
        # A page that was written again must be seen again.
        self.send_header("Cache-Control", "no-cache")
        super().end_headers()

    def log_message(self, format: str, *arguments: Any) -> None:
        pass


class _Server(ThreadingHTTPServer):
    def handle_error(self, request: Any, client_address: Any) -> None:
        # A browser that goes away in the middle of a file is no fault.
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


def serve(folder: str | os.PathLike[str], port: int = 0) -> ThreadingHTTPServer:
    """A server of `folder` on 127.0.0.1, on a free port if `port` is 0; run its `serve_forever`, and `server_close` it.

    No other machine reaches it. Raises InputError if the folder holds no `index.html` or the port cannot be had.
    """
    root = Path(folder)
    if not (root / "index.html").is_file():
        raise InputError(f"{root} holds no index.html: give a folder that `torchprt export --web` wrote")
    if not 0 <= port < 1 << 16:
        raise InputError(f"port {port} is not from 0 to 65535")
    try:
        return _Server(("127.0.0.1", port), functools.partial(_Handler, directory=str(root)))
    except OSError as fault:
        raise InputError(f"port {port} cannot be had ({fault.strerror}): give another one") from fault
