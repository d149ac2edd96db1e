"""Is the small mesh the mesh, as a reader of meshopt's streams finds it?"""

import json
import struct

import numpy as np
import pytest
import torch

from torchprt.scene import samples
from torchprt.web.mesh import save_small_glb

meshopt = pytest.importorskip("meshopt", reason="THE SMALL MESH IS NOT TESTED: meshopt is not installed")


def streams(path):
    """The tree of a .glb, and its streams unpacked, in their order."""
    content = path.read_bytes()
    length = struct.unpack("<I", content[12:16])[0]
    tree, binary = json.loads(content[20 : 20 + length]), content[28 + length :]
    found = []
    for view in tree["bufferViews"]:
        how = view["extensions"]["EXT_meshopt_compression"]
        part = binary[how["byteOffset"] : how["byteOffset"] + how["byteLength"]]
        found.append(
            meshopt.decode_gltf_buffer(part, how["count"], how["byteStride"], how["mode"], how.get("filter", "NONE"))
        )
    return tree, found


@pytest.fixture
def mesh():
    return samples.organic(8000).objects[0].mesh


def test_places_normals_colours_and_faces_are_there_at_the_bits_that_are_said(mesh, tmp_path):
    positions = mesh.positions.float() * 3 + torch.tensor([100.0, -20.0, 0.0])
    colour = torch.rand(len(positions), 3, generator=torch.Generator().manual_seed(1))
    moved = save_small_glb(positions, mesh.normals.float(), mesh.faces, tmp_path / "m.glb", colour=colour)
    tree, (places, normals, colours, faces) = streams(tmp_path / "m.glb")
    (node,) = tree["nodes"]
    whole = np.frombuffer(np.ascontiguousarray(places).tobytes(), "<u2").reshape(-1, 4)[:, :3]
    found = whole * np.array(node["scale"]) + np.array(node["translation"])
    largest = float(np.ptp(positions.numpy(), axis=0).max())
    assert moved <= 0.51 * largest / 65535
    assert np.abs(found - positions.double().numpy()).max() == pytest.approx(moved)
    unit = np.frombuffer(np.ascontiguousarray(normals).tobytes(), "<i2").reshape(-1, 4)[:, :3] / 32767
    cosine = (unit * mesh.normals.numpy()).sum(1) / np.linalg.norm(unit, axis=1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.12
    held = np.frombuffer(np.ascontiguousarray(colours).tobytes(), "<u2").reshape(-1, 4)[:, :3] / 65535
    np.testing.assert_allclose(held, colour, atol=0.51 / 65535)
    triangles = np.frombuffer(np.ascontiguousarray(faces).tobytes(), "<u4").reshape(-1, 3).astype(int)

    def told(corners):
        # Which corner comes first is free, their sense is not.
        return {min(tuple(np.roll(face, k)) for k in range(3)) for face in corners}

    assert told(triangles) == told(mesh.faces.numpy())
    whole_size = 4 * (9 * len(positions) + mesh.faces.numel())
    assert (tmp_path / "m.glb").stat().st_size < 0.4 * whole_size


def test_a_mesh_of_one_point_thick_is_no_division_by_zero(tmp_path):
    positions = torch.ones(3, 3)
    faces = torch.tensor([[0, 1, 2]])
    assert save_small_glb(positions, torch.zeros(3, 3), faces, tmp_path / "m.glb", colour=torch.ones(3, 3)) == 0
