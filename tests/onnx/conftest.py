"""Every file that a test of this room writes is run with a batch of none, in another process: a fault of ONNX Runtime
there is a signal (SIGFPE), which would take the tests down."""

import json
import subprocess
import sys

import pytest

# Answers one line a file: its output at the batches that are asked for, or why it is none of ours.
SERVER = """
import json, sys
import numpy as np, onnxruntime
onnxruntime.set_default_logger_severity(4)
for line in sys.stdin:
    path, batches = json.loads(line)
    try:
        session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    except Exception as fault:
        print(json.dumps("not opened"), flush=True)
        continue
    if "torchprt" not in session.get_modelmeta().custom_metadata_map:
        print(json.dumps("foreign"), flush=True)
        continue
    found = []
    try:
        for batch in batches:
            shapes = {i.name: [{"B": batch, "R": 3}.get(size, size) for size in i.shape] for i in session.get_inputs()}
            feed = {name: np.ones(shape, "f4") for name, shape in shapes.items()}
            (radiance,) = session.run(None, feed)
            found.append([list(radiance.shape), str(radiance.dtype)])
        print(json.dumps(found), flush=True)
    except Exception as fault:
        print(json.dumps(str(fault)[-300:]), flush=True)
"""


class Runner:
    """ONNX Runtime in a process of its own, which is started again when a file has killed it."""

    def __init__(self):
        self.process = None

    def __call__(self, path, batches):
        if self.process is None:
            self.process = subprocess.Popen(
                [sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        self.process.stdin.write(json.dumps([str(path), batches]) + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            code = self.process.wait()
            self.close()
            return f"ONNX Runtime died of signal {-code}"
        return json.loads(answer)

    def close(self):
        if self.process is not None:
            self.process.stdin.close()
            self.process.stdout.close()
            self.process.wait()
        self.process = None


@pytest.fixture(scope="session")
def elsewhere():
    """Runs a file at several batch sizes in another process: shapes and dtypes, or what went wrong."""
    runner = Runner()
    yield runner
    runner.close()


@pytest.fixture(scope="session")
def seen_folders(tmp_path_factory):
    """Those of other rooms, and those that were looked through."""
    return set(tmp_path_factory.getbasetemp().iterdir())


@pytest.fixture(autouse=True)
def a_batch_of_none(elsewhere, seen_folders, tmp_path_factory):
    """After a test: every file that it or a fixture of its module has written."""
    yield
    for folder in set(tmp_path_factory.getbasetemp().iterdir()) - seen_folders:
        seen_folders.add(folder)
        for path in sorted(folder.rglob("*.onnx")) if folder.is_dir() and not folder.is_symlink() else ():
            # Tests spoil a copy under this name; others make pipes, which would be waited for.
            if path.name == "doctored.onnx" or not path.is_file():
                continue
            answer = elsewhere(path, [0])
            if answer in ("not opened", "foreign"):
                continue
            assert isinstance(answer, list), f"{path.name} with a batch of none: {answer}"
            shape, dtype = answer[0]
            assert shape[0] == 0, path
            assert dtype == "float32", path
