"""Does the command fit lobes to a bake, and refuse what it cannot?"""

import pytest

from torchprt.transfer import Zonal, load


@pytest.mark.parametrize("options", [["--smoothness", "0"], ["--smoothness", "nan"]])
def test_refuses_what_cannot_be_fitted_and_writes_nothing(run, folder, tmp_path, options):
    output = tmp_path / "a.safetensors"
    ended = run("fit", folder / "ball.safetensors", "-o", output, *options)
    assert ended.code == 2
    assert "smoothness" in ended.err
    assert not output.exists()


def test_fits_tells_what_it_cost_and_shades(done, folder, tmp_path):
    fitted = tmp_path / "a.safetensors"
    said = done("fit", folder / "ball.safetensors", "-o", fitted, "--lobes", "1")
    signal = load(fitted).layers["diffuse"].signal
    assert isinstance(signal, Zonal)
    assert signal.lobes == 1
    assert not signal.smooth
    assert f"fit error {signal.fit_error:.2%}" in said
    # A ball shadows nothing: its vectors are zonal about the normals, but for the rays.
    assert signal.fit_error < 0.1
    done("shade", fitted, "--light", folder / "lamp.exr", "-o", tmp_path / "a.npy")


def test_a_smoothness_is_a_smooth_fit(done, folder, tmp_path):
    fitted = tmp_path / "a.safetensors"
    done("fit", folder / "ball.safetensors", "-o", fitted, "--lobes", "1", "--smoothness", "1")
    assert load(fitted).layers["diffuse"].signal.smooth


def test_stopped_it_writes_nothing(run, folder, tmp_path, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    import torchprt.compression

    monkeypatch.setattr(torchprt.compression, "fit", stop)
    ended = run("fit", folder / "ball.safetensors", "-o", tmp_path / "a.safetensors")
    assert ended.code == 130
    assert "nothing is written" in ended.err
    assert not list(tmp_path.iterdir())
