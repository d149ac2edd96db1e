"""Bakes and lights a .blend without a window, as the add-on does.

    blender -b scene.blend -P bake.py -- --texels 1024 --light env.exr --save lit.blend --render lit.png

Where Python has the package bpy: python bake.py -- --open scene.blend and the rest. Needs `torchprt_blender.py` beside
it and the command `torchprt` on the path (or --command, or TORCHPRT_COMMAND).
"""

import argparse
import math
import os
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

import torchprt_blender as addon


def asked(words):
    parser = argparse.ArgumentParser(prog="bake.py", description="Bakes and lights a .blend without a window.")
    parser.add_argument("--open", metavar="FILE", help="the .blend, where Blender itself was not given one")
    parser.add_argument(
        "--objects", nargs="+", metavar="NAME", help="what receives light; all visible meshes by default"
    )
    parser.add_argument("--texels", type=int, metavar="SIZE", help="into a map of SIZE x SIZE, not into vertices")
    parser.add_argument(
        "--uv", default="Lightmap", help="the UV map of --texels; made if an object has none of the name"
    )
    parser.add_argument("--light", metavar="FILE", help="an .exr or .hdr; the world of the scene by default")
    parser.add_argument("--rotation", type=float, default=0.0, help="of the light about z, in degrees")
    parser.add_argument("--order", type=int, default=5)
    parser.add_argument("--rays", type=int, default=1024)
    parser.add_argument("--bounces", default="auto")
    parser.add_argument("--white", action="store_true", help="without base colour, which the materials multiply with")
    parser.add_argument("--gloss", action="store_true", help="of the materials, seen from the camera of the scene")
    parser.add_argument("--folder", default="//torchprt", help="where bakes are kept; // is beside the .blend")
    parser.add_argument("--command", help="of torchprt")
    parser.add_argument("--save", metavar="FILE", help="the .blend with what came back")
    parser.add_argument("--render", metavar="FILE", help="a picture of it by the camera of the scene")
    return parser.parse_args(words)


def select(names):
    """Selects the meshes that receive light."""
    scene = bpy.context.scene
    missing = [name for name in names or () if name not in scene.objects or scene.objects[name].type != "MESH"]
    if missing:
        raise addon.Fault(f"--objects names {missing[0]}, which is no mesh of the scene")
    for obj in scene.objects:
        chosen = obj.name in names if names else obj.type == "MESH" and obj.visible_get()
        obj.select_set(chosen)


def main(words):
    options = asked(words)
    if options.command:
        os.environ["TORCHPRT_COMMAND"] = options.command
    if options.open:
        bpy.ops.wm.open_mainfile(filepath=options.open)
    context = bpy.context
    settings = context.scene.torchprt
    settings.order, settings.rays, settings.bounces = options.order, options.rays, options.bounces
    settings.gloss, settings.white, settings.folder = options.gloss, options.white, options.folder
    select(options.objects)
    if options.texels:
        settings.where, settings.size, settings.uv = "TEXELS", options.texels, options.uv
        if any(options.uv not in obj.data.uv_layers for obj in context.selected_objects):
            addon.make_uvs(context)
    else:
        settings.where = "VERTICES"
    settings.lights.clear()
    light = settings.lights.add()
    light.name, light.rotation = "Light", math.radians(options.rotation)
    if options.light:
        light.source, light.path = "FILE", os.path.abspath(options.light)
    for work in (addon.baking, addon.lighting):
        done = work(context)
        done.finish()
        for line in (*done.notes, *done.said):
            print(line)
    if options.save:
        bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(options.save))
    if options.render:
        context.scene.render.filepath = os.path.abspath(options.render)
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    fresh = not hasattr(bpy.types.Scene, "torchprt")
    try:
        if fresh:
            addon.register()
        main(given)
    except addon.Fault as fault:
        print(f"bake.py: {fault}", file=sys.stderr)
        # Blender ends well after a script that failed, unless it is told.
        sys.exit(2)
    finally:
        # Blender may crash at its end with classes that are still there.
        if fresh:
            addon.unregister()
