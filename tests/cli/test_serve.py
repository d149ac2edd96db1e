"""Does a page reach a browser until Ctrl-C?"""

import re
import signal
import subprocess
import sys
import urllib.request


def test_serving_what_is_no_page_is_refused(refused, tmp_path):
    refused("index.html", "--web", arguments=["serve", tmp_path])


def test_a_page_is_served_until_ctrl_c(tmp_path):
    (tmp_path / "index.html").write_text("a page")
    command = [sys.executable, "-m", "torchprt", "serve", str(tmp_path), "--port", "0"]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell that runs the tests in the background makes its children deaf to Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as server:
        try:
            assert server.stdout is not None
            address = re.search(r"http://127\.0\.0\.1:\d+/", server.stdout.readline())
            assert address
            with urllib.request.urlopen(address[0], timeout=20) as answer:
                assert answer.read() == b"a page"
            server.send_signal(signal.SIGINT)
            _, complaints = server.communicate(timeout=20)
        finally:
            server.kill()
    assert server.returncode == 0
    assert complaints == ""
