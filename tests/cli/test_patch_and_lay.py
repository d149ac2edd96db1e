"""Do patches go all the way from a picture of heights to a lit mesh, and are wrong ones refused?"""

import numpy as np
import PIL.Image
import pytest
import trimesh

from torchprt.scene import samples
from torchprt.transfer import load


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A picture of a bump, a cylinder with texture coordinates, and what is no patch."""
    folder = tmp_path_factory.mktemp("patches")
    ticks = (np.arange(16) + 0.5) / 16 - 0.5
    bump = np.clip(1 - 6 * (ticks[:, None] ** 2 + ticks**2), 0, 1)
    PIL.Image.fromarray((255 * bump).astype(np.uint8)).save(folder / "bump.png")
    mesh = samples.cylinder(8).objects[0].mesh
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.positions.tolist()]
    lines += [f"vt {u} {v}" for u, v in mesh.uv.reshape(-1, 2).tolist()]
    corner = [[f"{v + 1}/{3 * f + k + 1}" for k, v in enumerate(face)] for f, face in enumerate(mesh.faces.tolist())]
    lines += [f"f {' '.join(face)}" for face in corner]
    (folder / "cylinder.obj").write_text("\n".join(lines))
    trimesh.creation.icosphere(subdivisions=1).export(folder / "ball.ply")
    return folder


def test_a_picture_becomes_a_patch_on_a_lit_mesh(done, made, folder, tmp_path):
    small = ("--size", 8, "--order", 4, "--rays", 64)
    said = done("patch", made / "bump.png", "-o", tmp_path / "p.safetensors", *small, "--depth", 0.2)
    told = done("info", tmp_path / "p.safetensors")
    for word in ("zonal diffuse, shadowed, order 4", "map of 8 x 8 texels, tiles\n", "diffuse: 4 lobes"):
        assert word in said
        assert word in told
    baked = load(tmp_path / "p.safetensors")
    assert (baked.receivers.rows, baked.receivers.columns) == (8, 8)

    said = done(
        "lay", tmp_path / "p.safetensors", made / "cylinder.obj", "-o", tmp_path / "c.safetensors", "--repeat", "8,6"
    )
    assert "zonal" in said
    laid = load(tmp_path / "c.safetensors")
    assert (laid.order, laid.layers["diffuse"].signal.lobes) == (4, 4)
    done("shade", tmp_path / "c.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "c.npy")
    radiance = np.load(tmp_path / "c.npy")
    assert radiance.shape == (laid.vertices, 3)
    lit = laid.normals[:, 0].numpy() > 0.5
    assert radiance[lit].mean() > 4 * abs(radiance[laid.normals[:, 0].numpy() < -0.5].mean())


def test_options_change_the_patch(done, made, tmp_path):
    small = ("--size", 4, "--order", 3, "--rays", 16, "--lobes", 1, "--smooth", "--single", "--unshadowed")
    said = done("patch", made / "bump.png", "-o", tmp_path / "p.safetensors", *small)
    for word in ("unshadowed", "diffuse: 1 lobe", "lobes of neighbours correspond", "a single patch"):
        assert word in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["patch", "bump.png", "--depth", "0.1", "-o", "p.png"], ["p.png"]),
        (["patch", "missing.png", "-o", "p.safetensors"], ["missing.png"]),
        (["patch", "ball.ply", "-o", "p.safetensors"], ["must fill the unit square"]),
        (["patch", "ball.ply", "--depth", "1", "-o", "p.safetensors"], ["--depth is for images"]),
        (["patch", "bump.png", "--subsurface", "marble", "-o", "p.safetensors"], ["by millimetres how wide a tile is"]),
        (["patch", "bump.png", "--subsurface", "stone", "-o", "p.safetensors"], ["'stone' is no medium", "marble"]),
        (["patch", "bump.png", "--thickness", "0.1", "-o", "p.safetensors"], ["thickness is given without subsurface"]),
        (["patch", "bump.png", "--albedo", "2", "-o", "p.safetensors"], ["[0, 1]"]),
        (["lay", "missing.safetensors", "cylinder.obj", "-o", "c.safetensors"], ["missing.safetensors"]),
        (["lay", "bump.png", "cylinder.obj", "-o", "c.safetensors"], ["bump.png"]),
    ],
)
def test_refuses_in_one_sentence(refused, made, tmp_path, arguments, words):
    placed = [
        made / part if part.endswith((".png", ".ply", ".obj")) and part != "p.png" else part for part in arguments
    ]
    placed = [tmp_path / part if str(part).endswith((".safetensors", "p.png")) else part for part in placed]
    placed = [made / "bump.png" if part == tmp_path / "bump.png" else part for part in placed]
    refused(*words, arguments=placed)


def test_a_mesh_without_texture_coordinates_cannot_be_covered(done, refused, made, folder, tmp_path):
    small = ("--size", 4, "--order", 3, "--rays", 16, "--lobes", 1)
    done("patch", made / "bump.png", "-o", tmp_path / "p.safetensors", *small)
    output = ("-o", tmp_path / "c.safetensors")
    refused(
        "ball.ply has no texture coordinates", arguments=["lay", tmp_path / "p.safetensors", made / "ball.ply", *output]
    )
    laid = ["lay", folder / "ball.safetensors", made / "cylinder.obj", *output]
    refused("at vertices, not at the texels of a patch", arguments=laid)
    refused("--repeat", arguments=["lay", tmp_path / "p.safetensors", made / "cylinder.obj", *output, "--repeat", "2"])


def test_a_patch_is_lit_flat_as_it_was_baked(done, made, folder, tmp_path):
    small = ("--size", 4, "--order", 3, "--rays", 16, "--lobes", 1)
    done("patch", made / "bump.png", "-o", tmp_path / "p.safetensors", *small)
    done("shade", tmp_path / "p.safetensors", "--light", folder / "lamp.exr", "-o", tmp_path / "p.npy")
    assert np.load(tmp_path / "p.npy").shape == (16, 3)


def test_a_glossy_patch_is_shown_on_a_mesh_at_every_pixel(done, refused, made, folder, tmp_path):
    small = ("--size", 3, "--order", 3, "--rays", 16, "--lobes", 1, "--material", "ggx:0.5,0.4", "--factors", 2)
    said = done("patch", made / "bump.png", "-o", tmp_path / "p.safetensors", *small, "--albedo", 0.2, "--depth", 0.3)
    for word in ("zonal diffuse + zonal factored", "map of 3 x 3 texels", "materials ggx:0.5,0.4"):
        assert word in said
    patch, light = tmp_path / "p.safetensors", ("--light", folder / "lamp.exr", "--size", "48x36")
    shown = (patch, "--on", made / "cylinder.obj", "--repeat", "4,3", *light)
    said = done("render", *shown, "-o", tmp_path / "one.png")
    assert "1 picture of 48 x 36" in said
    done("render", *shown, "--turntable", 3, "-o", tmp_path / "f-####.png")
    pictures = [np.asarray(PIL.Image.open(path)).astype(int) for path in sorted(tmp_path.glob("f-*.png"))]
    assert len(pictures) == 3
    assert abs(pictures[0] - pictures[1]).mean() > 0.5
    done("lay", patch, made / "cylinder.obj", "-o", tmp_path / "c.safetensors")
    done("render", tmp_path / "c.safetensors", *light, "-o", tmp_path / "vertices.png")
    output = ("-o", tmp_path / "x.png")
    refused("--repeat", "--on", arguments=["render", patch, "--repeat", "2,2", *output])
    refused("ball.ply has no texture", arguments=["render", patch, "--on", made / "ball.ply", *output])
    refused(
        "recorded at vertices", arguments=["render", tmp_path / "c.safetensors", "--on", made / "cylinder.obj", *output]
    )
    refused("--on is given", arguments=["render", made / "ball.ply", "--on", made / "cylinder.obj", *output])
    refused("--show is sight", arguments=["render", patch, "--on", made / "cylinder.obj", "--show", "sight", *output])
    refused("--factors", arguments=["patch", made / "bump.png", "--factors", "2", "-o", tmp_path / "q.safetensors"])


def test_a_patch_that_light_diffuses_in(done, made, tmp_path):
    inside = ["--subsurface", "skin1", "--millimetres", 10, "--thickness", 0.05]
    small = ["--size", 6, "--rays", 16, "--order", 3, "--lobes", 1]
    done("patch", made / "bump.png", "-o", tmp_path / "p.safetensors", *small, *inside)
    assert load(tmp_path / "p.safetensors").channels == 3
