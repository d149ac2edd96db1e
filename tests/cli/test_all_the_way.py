"""Do the verbs together do what they promise: bake, shade, light, export, info?"""

import numpy as np
import onnxruntime
import torch

EPSILON = np.finfo(np.float32).eps


def test_a_mesh_goes_all_the_way(done, folder, tmp_path, untyped):
    said = done("bake", folder / "ball.ply", "-o", tmp_path / "b.safetensors", "--order", 4, "--rays", 64, "--seed", 3)
    assert "162 vertices, 320 faces in 1 piece" in said
    assert "order 4" in said
    assert "Monte Carlo estimate" in said
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["b.safetensors"]

    said = done("info", tmp_path / "b.safetensors")
    for word in ("diffuse, shadowed, order 4, 1 channel, 162 vertices", "320 faces", "64 rays", "seed 3", "albedo 0.5"):
        assert word in said

    said = done("light", folder / "lamp.exr", "-o", tmp_path / "l.npy", "--order", 4)
    assert "order 4" in said
    assert "light of order 4" in done("info", tmp_path / "l.npy")
    assert np.load(tmp_path / "l.npy").shape == (16, 3)
    assert np.load(tmp_path / "l.npy").dtype == np.float32

    said = done("export", tmp_path / "b.safetensors", "-o", tmp_path / "b.onnx")
    assert "opset 18" in said
    said = done("info", tmp_path / "b.onnx")
    for word in ("order: 4", "source: light", "vertices: 162", "('B', 162, 3)"):
        assert word in said

    for name, light in (("image.npy", folder / "lamp.exr"), ("light.npy", tmp_path / "l.npy")):
        done("shade", tmp_path / "b.safetensors", "--light", light, "-o", tmp_path / name, "--rotate", "-30,20,10")
    radiance = np.load(tmp_path / "image.npy")
    assert radiance.dtype == np.float32
    assert radiance.shape == (162, 3)
    assert radiance.flags.c_contiguous
    np.testing.assert_array_equal(np.load(tmp_path / "light.npy"), radiance)

    from torchprt import sh

    turn = sh.yaw_pitch_roll(torch.tensor([-30.0, 20.0, 10.0], dtype=torch.float64)).float().numpy()
    session = onnxruntime.InferenceSession(tmp_path / "b.onnx", providers=["CPUExecutionProvider"])
    (found,) = session.run(None, {"light": np.load(tmp_path / "l.npy")[None], "rotation": turn[None]})
    # Sums of 16 products of a turned light: some tens of epsilon of the largest radiance.
    np.testing.assert_allclose(found[0], radiance, rtol=0, atol=64 * EPSILON * radiance.max())


def test_suffixes_in_capitals_are_the_same(done, folder, tmp_path):
    done("bake", folder / "ball.ply", "-o", tmp_path / "B.SAFETENSORS", "--unshadowed")
    done("light", folder / "lamp.exr", "-o", tmp_path / "L.NPY")
    done("shade", tmp_path / "B.SAFETENSORS", "--light", tmp_path / "L.NPY", "-o", tmp_path / "R.NPY")
    assert np.load(tmp_path / "R.NPY").shape == (162, 3)
    assert len(list(tmp_path.iterdir())) == 3
