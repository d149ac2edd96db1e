"""Does the server for trying a page answer this machine alone, with types that browsers take?"""

import contextlib
import http.client
import socket
import threading

import pytest

from torchprt.errors import InputError
from torchprt.web import serve


@pytest.fixture
def folder(tmp_path):
    page = tmp_path / "page"
    page.mkdir()
    (page / "index.html").write_text("<title>here</title>")
    for name in ("a.js", "b.mjs", "c.wasm.gz", "d.onnx", "e.glb", "f.json", "g.css", "h.jpg", "i.unknown"):
        (page / name).write_bytes(b"content")
    (tmp_path / "secret.txt").write_text("not for you")
    return page


@contextlib.contextmanager
def asking(folder):
    """`ask(path)`: status, headers and body."""
    with serve(folder) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()

        def ask(path):
            connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
            with contextlib.closing(connection):
                connection.request("GET", path)
                answer = connection.getresponse()
                return answer.status, answer.headers, answer.read()

        try:
            yield ask
        finally:
            server.shutdown()
            thread.join()


def test_refuses_a_folder_without_a_page_and_a_port_that_is_none(folder, tmp_path):
    for where in (tmp_path, tmp_path / "none", folder / "a.js"):
        with pytest.raises(InputError, match=r"holds no index\.html.*--web"):
            serve(where)
    for port in (-1, 65536):
        with pytest.raises(InputError, match="not from 0 to 65535"):
            serve(folder, port)


def test_a_port_that_is_taken_is_named(folder):
    with serve(folder) as first, pytest.raises(InputError, match=f"port {first.server_port} cannot be had"):
        serve(folder, first.server_port)


def test_it_listens_to_this_machine_alone(folder):
    with serve(folder) as server:
        assert server.server_address[0] == "127.0.0.1"


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/", "text/html; charset=utf-8"),
        ("/a.js", "text/javascript; charset=utf-8"),
        ("/b.mjs", "text/javascript; charset=utf-8"),
        ("/c.wasm.gz", "application/gzip"),
        ("/d.onnx", "application/octet-stream"),
        ("/e.glb", "model/gltf-binary"),
        ("/f.json", "application/json"),
        ("/g.css", "text/css; charset=utf-8"),
        ("/h.jpg", "image/jpeg"),
        ("/i.unknown", "application/octet-stream"),
    ],
)
def test_types_are_those_that_browsers_take(folder, path, kind):
    with asking(folder) as ask:
        status, headers, body = ask(path)
    assert (status, headers["Content-Type"]) == (200, kind)
    assert headers["Cache-Control"] == "no-cache"
    assert headers["Content-Encoding"] is None
    assert body


@pytest.mark.parametrize("path", ["/../secret.txt", "/%2e%2e/secret.txt", "/..%2fsecret.txt", "/none.js"])
def test_what_is_not_in_the_folder_is_not_there(folder, path):
    with asking(folder) as ask:
        assert ask(path)[0] == 404


def test_a_browser_that_goes_away_in_the_middle_of_a_file_is_no_fault(folder, capfd):
    """More than the system takes in one piece, so that the server is still writing."""
    (folder / "large.onnx").write_bytes(bytes(1 << 25))
    with serve(folder) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        # Unread bytes make the end of this a reset.
        with socket.create_connection(("127.0.0.1", server.server_port)) as browser:
            browser.sendall(b"GET /large.onnx HTTP/1.1\r\nHost: here\r\n\r\n")
            browser.recv(99)
        server.shutdown()
        thread.join()
    # The end of the server has waited for what it was writing.
    assert capfd.readouterr().err == ""
