"""Does the command tell what is in a file?"""

from transfers import random_glossy

from torchprt.compression import fit
from torchprt.transfer import save


def test_info_tells_of_meshes_and_images_too(done, folder):
    assert "The surface is closed and consistently wound" in done("info", folder / "ball.ply")
    assert "64 x 32 pixels" in done("info", folder / "lamp.exr")


def test_info_tells_of_every_layer_by_its_name(done, tmp_path):
    baked = random_glossy("exit", order=3, output_order=2, materials=["phong:4"])
    save(fit(baked, lobes=2), tmp_path / "a.safetensors")
    said = done("info", tmp_path / "a.safetensors")
    assert "zonal diffuse + zonal exit, shadowed, order 3, output order 2 (optimal)" in said
    assert "\ndiffuse: 2 lobes a vertex, fit error " in said
    assert "\nexit: 2 lobes a row, fit error " in said
    assert "\nexit: materials phong:4, specular of every vertex, mean (" in said
