"""Is a file that was taken for another called by its name?"""

import numpy as np
import pytest

import torchprt
from torchprt.errors import InputError
from torchprt.files import check_writable
from torchprt.suffixes import by_content, kind_of, nearest, refuse_other


@pytest.mark.parametrize(
    ("read", "name", "words"),
    [
        (torchprt.load, "a.safetensors", "is a transfer, not a mesh: light it with `torchprt shade`"),
        (torchprt.load, "a.exr", "is an image, not a mesh: give it as a light"),
        (torchprt.load_transfer, "a.ply", "is a mesh, not a transfer: bake it"),
        (torchprt.load_transfer, "a.onnx", "is a graph, not a transfer: run it with ONNX Runtime"),
        (
            torchprt.light.read,
            "a.npy",
            "is an array, not an image: give it as a light, or read it with prt.light.read_c",
        ),
        (torchprt.light.read, "a.glb", "is a mesh, not an image: bake it"),
    ],
)
def test_a_file_of_another_kind_is_called_by_its_name(read, name, words, tmp_path):
    (tmp_path / name).write_bytes(b"anything")
    with pytest.raises(InputError, match=f"{name} {words}"):
        read(tmp_path / name)


def test_an_image_is_read_whatever_its_name_says(tmp_path):
    from PIL import Image

    Image.fromarray(np.zeros((2, 4, 3), np.uint8)).save(tmp_path / "a.ply", format="PNG")
    assert torchprt.light.read(tmp_path / "a.ply").shape == (2, 4, 3)


def test_what_is_wanted_or_unknown_is_not_refused():
    refuse_other("a.PLY", "a mesh")
    refuse_other("a.blend", "a mesh")
    refuse_other("a", "a mesh")
    assert kind_of(".PLY") == "a mesh"
    assert kind_of("") is None


@pytest.mark.parametrize(
    ("name", "hint"),
    [("a.pgn", ", as .*a.png$"), ("a.safetensor", "a.safetensors$"), ("a.txt", "fetensors$"), ("a", "s$")],
)
def test_a_slip_of_the_suffix_is_told_what_it_is_near_to(name, hint, tmp_path):
    with pytest.raises(InputError, match=f"{name} must end in .*{hint}"):
        check_writable(tmp_path / name, (".png", ".safetensors"))
    assert nearest(".txt", (".png", ".safetensors")) is None


def test_content_says_what_a_file_is(tmp_path):
    path = tmp_path / "a"
    for start, suffix in (
        (b"RIFF\0\0\0\0WEBPVP8 ", ".webp"),
        (b"RIFF\0\0\0\0WAVEfmt ", None),
        (b"\0\0\0\x20ftypisom", ".mp4"),
        (b"\x40\0\0\0\0\0\0\0" + b'{"a":1}', ".safetensors"),
        (b"", None),
        (b"glTF", ".glb"),
    ):
        path.write_bytes(start)
        found = by_content(path)
        assert (found and found[0]) == suffix
    with pytest.raises(InputError, match="does not exist"):
        by_content(tmp_path / "none")
    with pytest.raises(InputError, match="cannot be read"):
        by_content(tmp_path)
