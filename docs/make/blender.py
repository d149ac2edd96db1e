"""The picture of docs/blender.md: a courtyard in Blender, path traced by Cycles and lit by what came back of torchprt.

    python-with-bpy docs/make/blender.py docs/images

Needs the package bpy and the command `torchprt` (or TORCHPRT_COMMAND), which may be of another Python.
"""

import math
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "export" / "blender"))

import torchprt_blender as addon

SIZE = (480, 360)
SAMPLES = 96


def with_nodes(block):
    if bpy.app.version < (5, 0, 0):
        block.use_nodes = True
    return block.node_tree


def painted(name, colour):
    material = bpy.data.materials.new(name)
    shader = with_nodes(material).nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1)
    shader.inputs["Roughness"].default_value = 1
    shader.inputs["Specular IOR Level"].default_value = 0
    return material


def add(kind, material, smooth=False, **given):
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**given)
    obj = bpy.context.object
    obj.data.materials.append(material)
    for polygon in obj.data.polygons:
        polygon.use_smooth = smooth
    return obj


def courtyard():
    """Columns before a wall, a ball, a ring and some steps."""
    stone, red, teal = (
        painted("stone", (0.7, 0.66, 0.6)),
        painted("red", (0.7, 0.12, 0.06)),
        painted("teal", (0.05, 0.4, 0.4)),
    )
    add("plane", stone, size=8)
    add("cube", red, size=1, location=(0, 2.6, 1.5), scale=(8, 0.4, 3))
    add("cube", stone, size=1, location=(-3.2, -0.3, 1.5), scale=(0.4, 5.4, 3))
    for x in (-2, -0.7, 0.6, 1.9):
        add(
            "cylinder",
            stone,
            True,
            radius=0.22,
            depth=2.4,
            location=(x, 1.2, 1.2),
            vertices=48,
            end_fill_type="NOTHING",
        )
    add("cube", stone, size=1, location=(-0.05, 1.2, 2.55), scale=(4.8, 0.7, 0.3))
    add("uv_sphere", teal, True, radius=0.6, location=(-1.2, -0.6, 0.6), segments=64, ring_count=32)
    add(
        "torus",
        stone,
        True,
        major_radius=0.55,
        minor_radius=0.18,
        location=(0.9, -0.5, 0.73),
        rotation=(math.pi / 2, 0, 0.6),
    )
    for step in range(3):
        add(
            "cube",
            stone,
            size=1,
            location=(2.6, 0.2 + 0.3 * step, 0.1 + 0.1 * step),
            scale=(1.4, 0.9 - 0.3 * step + 0.6, 0.2 + 0.2 * step),
        )


def world(path):
    """A clear evening: a wide glow, low, and blue above."""
    height, width = 128, 256
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    phi, theta = -(u - 0.5) * 2 * np.pi, (v - 0.5) * np.pi
    toward = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta)], -1)
    sun = np.array([0.95, -0.3, 0.75])
    glow = np.exp(20 * (toward @ (sun / np.linalg.norm(sun)) - 1))[..., None]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = 0.25 * np.array([0.45, 0.65, 1.0]) * (0.4 + 0.6 * np.clip(toward[..., 2:], 0, 1)) + 14 * glow * [
        1,
        0.72,
        0.42,
    ]
    image = bpy.data.images.new("evening", width, height, float_buffer=True, alpha=False)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.filepath_raw, image.file_format = str(path), "OPEN_EXR"
    image.save()
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    tree = with_nodes(scene.world)
    picture = tree.nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(str(path))
    tree.links.new(picture.outputs[0], next(n for n in tree.nodes if n.type == "BACKGROUND").inputs[0])


def camera():
    from mathutils import Vector

    scene = bpy.context.scene
    eye = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(eye)
    eye.location = (3.2, -6.4, 3.0)
    eye.rotation_euler = (Vector((-0.25, 0.3, 0.95)) - eye.location).to_track_quat("-Z", "Y").to_euler()
    eye.data.lens = 38
    scene.camera = eye
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.film_transparent = False
    scene.view_settings.view_transform = "AgX"


def drawn(path, samples):
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", samples
    scene.cycles.use_denoising = True
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = 12
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return read(path)


def read(path):
    image = bpy.data.images.load(str(path))
    pixels = np.empty(4 * SIZE[0] * SIZE[1], np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(SIZE[1], SIZE[0], 4)


def main(folder):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module="cycles")
    addon.register()
    context, kept = bpy.context, Path(tempfile.gettempdir()) / "torchprt-blender-picture"
    kept.mkdir(exist_ok=True)
    courtyard()
    world(kept / "evening.exr")
    camera()
    traced = read(kept / "cycles.png") if (kept / "cycles.png").exists() else drawn(kept / "cycles.png", SAMPLES)
    settings = context.scene.torchprt
    settings.folder, settings.where, settings.size = str(kept), "TEXELS", 512
    settings.order, settings.rays = 10, 256
    light = settings.lights.add()
    light.name = "Evening"
    for obj in context.scene.objects:
        obj.select_set(obj.type == "MESH")
    addon.make_uvs(context)
    for work in (addon.baking, addon.lighting):
        done = work(context)
        done.finish()
        print(*done.notes, *done.said, sep="\n")
    lit = drawn(kept / "torchprt.png", 16)
    gap = np.ones((SIZE[1], 8, 4), np.float32)
    both = np.concatenate([traced, gap, lit], 1)
    image = bpy.data.images.new("both", both.shape[1], both.shape[0], alpha=False)
    image.pixels.foreach_set(both.ravel())
    image.update()
    image.filepath_raw, image.file_format = str(Path(folder) / "blender.png"), "PNG"
    image.save()
    difference = np.abs(traced - lit)[..., :3]
    print(f"mean difference {255 * difference.mean():.1f} of 255, 99 % below {255 * np.quantile(difference, 0.99):.0f}")
    addon.unregister()


main(sys.argv[1])
