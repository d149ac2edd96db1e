"""Does a path tracer that no one here wrote see a texture as the vertices of its surface have it?

Mitsuba looks straight down at the sheet with its picture, at points of ours; under a constant light of 1 a flat sheet
sends what it reflects. A vertex is the mean of what is seen over its one-ring, weighted with its hat function.
"""

import numpy as np
import pytest
from path_tracer import variant
from textured_files import noise, png, save_sheet, sheet, textured

from torchprt.light import hemisphere as sky
from torchprt.scene import load
from torchprt.shade import shader
from torchprt.transport import bake

mi = pytest.importorskip("mitsuba", reason="the peer test needs `pip install mitsuba`")
ROWS = 160
"""Points along a side of a face."""


@pytest.fixture(scope="module")
def mitsuba():
    if fault := variant(mi):
        pytest.skip(fault)
    return mi


def lattice(rows: int) -> np.ndarray:
    """Barycentric coordinates of the middles of equal triangles."""
    i, j = np.meshgrid(np.arange(rows), np.arange(rows), indexing="ij")
    low = np.stack([i + 1 / 3, j + 1 / 3], -1)[i + j < rows]
    high = np.stack([i + 2 / 3, j + 2 / 3], -1)[i + j < rows - 1]
    points = np.concatenate([low, high]) / rows
    return np.column_stack([1 - points.sum(1), points])


@pytest.mark.parametrize(("size", "repeats"), [(24, 1.0), (128, 1.0), (32, 2.5)])
def test_radiance_of_a_vertex_is_that_of_the_texture_around_it(mitsuba, tmp_path, size, repeats):
    texels = noise(size, seed=size)
    positions, faces, uv = sheet()
    path = save_sheet(tmp_path / "sheet.glb", [textured()], [png(texels)], TEXCOORD_0=repeats * uv)
    light = sky((0.0, 0.0, 1.0), 1.0, 1.0, 4)
    ours = shader(bake(load(path), order=4, rays=256, progress=False))(light.float()).numpy()
    (tmp_path / "picture.png").write_bytes(png(texels))
    sheet_of_theirs = mitsuba.Mesh("sheet", len(positions), len(faces), has_vertex_texcoords=True)
    parameters = mitsuba.traverse(sheet_of_theirs)
    parameters["vertex_positions"] = positions.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    # In a .ply, too, v runs down the picture for it.
    parameters["vertex_texcoords"] = (repeats * uv).astype(np.float32).ravel()
    parameters.update()
    sheet_of_theirs.write_ply(str(tmp_path / "sheet.ply"))
    picture = {"type": "bitmap", "filename": str(tmp_path / "picture.png")}
    world = mitsuba.load_dict(
        {
            "type": "scene",
            "sheet": {
                "type": "ply",
                "filename": str(tmp_path / "sheet.ply"),
                "bsdf": {"type": "diffuse", "reflectance": picture},
            },
            "light": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}},
        }
    )
    points = lattice(ROWS)
    sums, weights = np.zeros((len(positions), 3)), np.zeros(len(positions))
    for face in faces:
        seen = albedo_along_z(mitsuba, world, points @ positions[face])
        area = np.linalg.norm(np.cross(*(positions[face][1:] - positions[face][0])))
        for corner in range(3):
            hat = points[:, corner]
            sums[face[corner]] += area * (seen * hat[:, None]).mean(0)
            weights[face[corner]] += area * hat.mean()
    assert np.abs(ours - sums / weights[:, None]).max() < 1 / 255


def albedo_along_z(mitsuba, world, points) -> np.ndarray:
    """What the surface under each point reflects of a constant light, [P, 3]."""
    import drjit

    origins = np.ascontiguousarray((points + np.array([0, 0, 1])).T.astype(np.float32))
    rays = mitsuba.Ray3f(mitsuba.Point3f(origins), mitsuba.Vector3f(0, 0, -1))
    hit = world.ray_intersect(rays)
    colour = hit.bsdf(rays).eval_diffuse_reflectance(hit, hit.is_valid())
    drjit.eval(colour)
    return np.array(colour).reshape(3, -1).T
