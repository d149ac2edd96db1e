"""Do the commands take what a file says of its materials, and say so?"""

import numpy as np
import PIL.Image
import pytest
import torch

from torchprt.scene import samples
from torchprt.transfer import load


@pytest.fixture(scope="module")
def vase(tmp_path_factory):
    path = tmp_path_factory.mktemp("vase") / "vase.glb"
    samples.write_painted_vase(path, 16)
    return path


def test_a_weight_beside_the_gloss_of_the_file_is_refused(run, vase, tmp_path):
    ended = run("bake", vase, "-o", tmp_path / "a.safetensors", "--material", "file", "--specular", "0.5")
    assert ended.code == 2
    assert "--material file weighs its gloss itself: leave it out" in ended.err


def test_info_says_what_a_bake_would_take(done, vase):
    said = done("info", vase)
    assert "Albedo of the file: textures of 'porcelain', base colour of 'gold'." in said
    assert "gloss of 'porcelain' and 'gold'" in said
    assert "Metal is taken as diffuse, of its base colour: 'gold'." in said


def test_a_model_is_rendered_in_its_colours(done, vase, tmp_path):
    kept = tmp_path / "a.safetensors"
    done("bake", vase, "-o", kept, "--rays", 16, "--bounces", 0, "--order", 3)
    albedo = load(kept).layers["diffuse"].albedo
    # Porcelain, cobalt and gold.
    assert float(albedo.amax(1).max()) == pytest.approx(1, abs=1e-4)
    assert bool((albedo[:, 2] > 2 * albedo[:, 0]).any())
    done("render", kept, "-o", tmp_path / "a.png", "--size", "64x64", "--light", "sky")
    colours = np.asarray(PIL.Image.open(tmp_path / "a.png").convert("RGB")).astype(int)
    assert (colours[..., 2] > colours[..., 0] + 40).any()
    assert (colours[..., 0] > colours[..., 2] + 40).any()
    done("bake", vase, "-o", kept, "--rays", 16, "--bounces", 0, "--order", 3, "--albedo", "0.3")
    assert torch.allclose(load(kept).layers["diffuse"].albedo, torch.tensor(0.3))


def test_the_gloss_of_the_file_is_baked_if_asked_for(done, vase, tmp_path):
    kept = tmp_path / "a.safetensors"
    options = ["--rays", 16, "--bounces", 0, "--order", 3, "--output-order", 5]
    said = done("bake", vase, "-o", kept, *options, "--material", "file")
    assert "Gloss of the file: 2 kinds of GGX." in said
    assert load(kept).layers.keys() == {"diffuse", "exit"}
