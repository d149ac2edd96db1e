"""Small scenes with glossy surfaces, and what they send toward the eye."""

import torch
from shapes import disc, square
from transfers import gloss, stored

from torchprt import sh
from torchprt.scene import Material, Object, Scene, make_mesh
from torchprt.transport import bake, hemisphere
from torchprt.transport.receivers import tangent_frames


def quiet(scene, **options):
    return bake(scene, progress=False, **options)


def shiny(gloss="phong:10", albedo=0.0, **options):
    return Material(albedo=albedo, gloss=gloss, **options)


def floor_and_wall(material, resolution=9, blocker=True):
    """A floor, a wall standing on it, and a small disc over the floor: shadows, and light from one to the other."""
    floor = square(2.0, resolution)
    wall = square(2.0, resolution)
    upright = torch.stack(
        [wall.positions[:, 0], wall.positions[:, 2] + 1.0, torch.full_like(wall.positions[:, 0], -1.0)], -1
    )
    standing = make_mesh(upright, wall.faces.flip(1), name="wall")
    objects = [Object(floor, material), Object(standing, material)]
    if blocker:
        objects.append(Object(disc(0.4, 0.6), Material(0.0), "blocker"))
    return Scene(objects)


def frames_of(transfer):
    layer = gloss(transfer)
    return tangent_frames(transfer.normals[layer.receivers.long()].double(), layer.tangents.double())


def exit_radiance(transfer, views):
    """`[C, G, views, N]` in double precision: what goes toward local directions, for every light coefficient."""
    functions = sh.exit_functions(views, gloss(transfer).output_order, gloss(transfer).projection)
    return functions @ stored(transfer).double()


def views(count=40):
    return hemisphere(count, seed=5)
