"""Does the command tell what is in a file that is no bake?"""


def test_info_tells_of_meshes_and_images_too(done, folder):
    assert "The surface is closed and consistently wound" in done("info", folder / "ball.ply")
    assert "64 x 32 pixels" in done("info", folder / "lamp.exr")
