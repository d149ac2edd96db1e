"""torchprt in Blender: bake the selected objects once, light them as often as you like.

An add-on of one file for Blender 4.2 to 5.0: Edit > Preferences > Add-ons > Install from Disk, then the tab "torchprt"
of the sidebar (N) of the 3D view. It calls the command `torchprt`, so Blender's Python needs neither torch nor pip.

Blender's z is up, that of torchprt (and glTF) is y: (x, y, z) of Blender is (x, z, -y) there.
docs/blender.md says what one sees, `bake.py` beside this file does the same without a window.
"""

import contextlib
import hashlib
import json
import math
import os
import queue
import re
import shlex
import shutil
import signal
import struct
import subprocess
import tempfile
import threading
import zlib
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np

bl_info = {
    "name": "torchprt",
    "description": "Bakes precomputed radiance transfer and brings its light back as vertex colours or lightmaps",
    "author": "torchprt",
    "version": (1, 0, 0),
    "blender": (4, 2, 0),
    "location": "3D view > Sidebar > torchprt",
    "category": "Render",
}

PREFIX = "prt "
"""What colours, images and materials that come back are called: this and the name of their light."""
FACING = -90.0
"""Yaw that brings the middle of an image from torchprt's place for it, Blender's +y, to Blender's, +x."""


class Fault(Exception):
    """What a user can mend, in one sentence."""


# --- Meshes: one row for each vertex, normal and texture coordinate that differ, so that rows know their corners.


class Part(NamedTuple):
    """An object as torchprt is given it, y up, in the world."""

    name: str
    positions: np.ndarray
    normals: np.ndarray
    uv: list
    """Sets of texture coordinates [rows, 2], v down the picture as in glTF: that of the pictures, that of the map."""
    triangles: np.ndarray
    material: np.ndarray
    """Which slot each row has; rows of one slot follow each other."""
    row_of_corner: np.ndarray


def y_up(points):
    """Blender's (x, y, z) is (x, z, -y) of glTF and torchprt."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], -1)


def make_part(name, matrix, vertices, vertex_of_corner, normals, uv, slot_of_corner, triangles):
    """Arrays of a mesh of Blender as a `Part`: `matrix` [4, 4] to the world, normals and uv a corner each.

    Corners are one row where slot, vertex, normal (to 1e-4) and texture coordinates agree.
    """
    keys = [slot_of_corner[:, None], vertex_of_corner[:, None], np.rint(normals * 1e4)]
    # Bits of floats sort as well as any numbers; -0 is 0.
    keys += [(np.asarray(each, np.float32) + np.float32(0)).view(np.int32) for each in uv]
    table = np.concatenate([np.asarray(key, np.int64) for key in keys], 1)
    _, first, row_of_corner = np.unique(table, axis=0, return_index=True, return_inverse=True)
    row_of_corner = row_of_corner.reshape(-1)
    linear = np.asarray(matrix, np.float64)[:3, :3]
    positions = vertices[vertex_of_corner[first]] @ linear.T + np.asarray(matrix, np.float64)[:3, 3]
    # By the cofactors, which exist even where an object is flat; a mirror keeps normals outside and turns the winding.
    rows = [np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])]
    mirrored = np.linalg.det(linear) < 0
    turned = normals[first] @ np.stack(rows).T * (-1 if mirrored else 1)
    turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-30)
    faces = row_of_corner[triangles]
    return Part(
        name,
        y_up(positions).astype(np.float32),
        y_up(turned).astype(np.float32),
        [np.stack([each[first, 0], 1 - each[first, 1]], -1).astype(np.float32) for each in uv],
        faces[:, ::-1] if mirrored else faces,
        slot_of_corner[first],
        row_of_corner,
    )


def part_of(obj, matrix, uv_names):
    """The `Part` of an evaluated object: `uv_names[slot]` are the names of its sets there; slot -1 is any other."""
    mesh = obj.to_mesh()
    try:
        if not len(mesh.polygons):
            return None
        corners = len(mesh.loops)
        polygon_of_corner = np.repeat(np.arange(len(mesh.polygons)), _read(mesh.polygons, "loop_total", np.int32))
        slot = _read(mesh.polygons, "material_index", np.int32)[polygon_of_corner]
        slot = np.minimum(slot, max(len(obj.material_slots) - 1, 0))
        sets = []
        for which in range(len(uv_names[-1])):
            sets.append(np.zeros((corners, 2), np.float32))
            for number, names in uv_names.items():
                layer = mesh.uv_layers.get(names[which] or "")
                if layer is None and names[which]:
                    raise Fault(
                        f"{obj.name} has no UV map '{names[which]}': make one with Make Lightmap UVs, or name another"
                    )
                if layer is not None:
                    some = slot == number if number >= 0 else ~np.isin(slot, list(uv_names))
                    sets[-1][some] = _read(layer.uv, "vector", np.float32, 2)[some]
        mesh.calc_loop_triangles()
        return make_part(
            obj.name,
            np.array(matrix),
            _read(mesh.vertices, "co", np.float32, 3).astype(np.float64),
            _read(mesh.loops, "vertex_index", np.int32),
            _read(mesh.corner_normals, "vector", np.float32, 3).astype(np.float64),
            sets,
            slot,
            _read(mesh.loop_triangles, "loops", np.int32, 3),
        )
    finally:
        obj.to_mesh_clear()


def _read(collection, name, dtype, width=None):
    values = np.empty(len(collection) * (width or 1), dtype)
    collection.foreach_get(name, values)
    return values if width is None else values.reshape(-1, width)


# --- Materials: base colour or its picture, metallic, roughness.


BASES = ("BSDF_PRINCIPLED", "BSDF_DIFFUSE")
"""Nodes whose first socket is a base colour."""


def material_of(material, notes):
    """What torchprt takes of a material: its name, colour, picture and UV map of that, metallic, roughness, sides."""
    found = {"name": "none", "colour": (0.8, 0.8, 0.8), "metallic": 0.0, "roughness": 0.5, "two_sided": True}
    found |= {"image": None, "uv": None}
    if material is None:
        return found
    found |= {"name": material.name, "two_sided": not material.use_backface_culling}
    found["colour"] = tuple(material.diffuse_color[:3])
    nodes = material.node_tree.nodes if material.node_tree else ()
    diffuse = next((node for kind in BASES for node in nodes if node.type == kind), None)
    if diffuse is None:
        notes.append(f"Material {material.name} has no Principled or Diffuse BSDF: its viewport colour is taken.")
        return found
    if diffuse.type == "BSDF_PRINCIPLED":
        for name in ("Metallic", "Roughness"):
            if diffuse.inputs[name].is_linked:
                notes.append(f"Material {material.name} has nodes for {name}: the number of its socket is taken.")
            found[name.lower()] = diffuse.inputs[name].default_value
    socket = diffuse.inputs[0]
    if not socket.is_linked:
        found["colour"] = tuple(socket.default_value[:3])
        return found
    node = socket.links[0].from_node
    if node.type == "TEX_IMAGE" and node.image is not None and not _moved(node):
        found |= {"colour": (1.0, 1.0, 1.0), "image": node.image}
        found["uv"] = node.inputs[0].links[0].from_node.uv_map if _has_uv_map(node) else None
    else:
        notes.append(
            f"Material {material.name} has a base colour of nodes that are no image on a UV map: its viewport colour "
            "is taken."
        )
    return found


def _has_uv_map(node):
    return node.inputs[0].is_linked and node.inputs[0].links[0].from_node.type == "UVMAP"


def _moved(node):
    """Whether a picture is looked up elsewhere than at a UV map."""
    if not node.inputs[0].is_linked or _has_uv_map(node):
        return False
    link = node.inputs[0].links[0]
    return not (link.from_node.type == "TEX_COORD" and link.from_socket.name == "UV")


def png_of(image):
    """A picture of Blender as PNG, 8 bits of sRGB."""
    width, height = image.size
    if not width or not height:
        raise Fault(f"Image {image.name} has no pixels: find its file, or take it out of the material")
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, image.channels)[::-1]
    colour = np.clip(pixels[..., [0, 1, 2] if image.channels > 2 else [0, 0, 0]], 0, 1)
    # Pixels of pictures in bytes are as they are kept; those of floats are light.
    if image.is_float or image.colorspace_settings.name in ("Non-Color", "Linear Rec.709"):
        colour = np.where(colour <= 0.0031308, 12.92 * colour, 1.055 * colour ** (1 / 2.4) - 0.055)
    rows = np.rint(colour * 255).astype(np.uint8).reshape(height, width * 3)
    lines = np.concatenate([np.zeros((height, 1), np.uint8), rows], 1).tobytes()

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(lines, 6)) + chunk(b"IEND", b"")


def make_glb(parts, materials, pictures):
    """A binary glTF: a mesh and a node each part, a primitive each material, rows in their order.

    `materials[part][slot]` numbers entries of the list of materials, `pictures` the PNG of those that have any.
    """
    views, accessors, data = [], [], bytearray()

    def view(content, target=None):
        data.extend(b"\0" * (-len(data) % 4))
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(content)})
        if target:
            views[-1]["target"] = target
        data.extend(content)
        return len(views) - 1

    def accessor(values, kind):
        whole = kind == "SCALAR"
        entry = {"bufferView": view(values.tobytes(), 34963 if whole else 34962), "type": kind}
        entry |= {"componentType": 5125 if whole else 5126, "count": len(values)}
        if kind == "VEC3":
            entry |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        accessors.append(entry)
        return len(accessors) - 1

    listed, numbers, images = [], {}, []
    meshes = []
    for part, slots in zip(parts, materials, strict=True):
        primitives = []
        for slot in np.unique(part.material):
            rows = np.flatnonzero(part.material == slot)
            attributes = {"POSITION": accessor(part.positions[rows], "VEC3")}
            attributes["NORMAL"] = accessor(part.normals[rows], "VEC3")
            for number, uv in enumerate(part.uv):
                attributes[f"TEXCOORD_{number}"] = accessor(uv[rows], "VEC2")
            faces = part.triangles[part.material[part.triangles[:, 0]] == slot] - rows[0]
            about = slots[slot]
            if about["name"] not in numbers:
                numbers[about["name"]] = len(listed)
                listed.append(_gltf_material(about, images))
            indices = accessor(faces.astype(np.uint32).reshape(-1), "SCALAR")
            primitives.append({"attributes": attributes, "indices": indices, "material": numbers[about["name"]]})
        meshes.append({"name": part.name, "primitives": primitives})
    document = {"asset": {"version": "2.0", "generator": "torchprt_blender"}, "scene": 0}
    document |= {"scenes": [{"nodes": list(range(len(parts)))}], "meshes": meshes, "materials": listed}
    document["nodes"] = [{"name": part.name, "mesh": number} for number, part in enumerate(parts)]
    if images:
        document["images"] = [
            {"name": name, "mimeType": "image/png", "bufferView": view(pictures[name])} for name in images
        ]
        document["textures"] = [{"source": number} for number in range(len(images))]
    document |= {"bufferViews": views, "accessors": accessors, "buffers": [{"byteLength": len(data)}]}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    data.extend(b"\0" * (-len(data) % 4))
    length = 12 + 8 + len(text) + 8 + len(data)
    start = struct.pack("<4sII", b"glTF", 2, length) + struct.pack("<I4s", len(text), b"JSON") + text
    return start + struct.pack("<I4s", len(data), b"BIN\0") + bytes(data)


def _gltf_material(about, images):
    core = {"baseColorFactor": [*map(float, about["colour"]), 1.0]}
    core |= {"metallicFactor": float(about["metallic"]), "roughnessFactor": float(about["roughness"])}
    if about["image"] is not None:
        name = about["image"].name
        if name not in images:
            images.append(name)
        core["baseColorTexture"] = {"index": images.index(name), "texCoord": 0}
    return {"name": about["name"], "pbrMetallicRoughness": core, "doubleSided": bool(about["two_sided"])}


# --- What is sent: the objects, what else casts shadows, and a note of both.

SOLID = {"MESH", "CURVE", "SURFACE", "FONT", "META"}


def sent(context, objects, settings, notes):
    """The files of a bake as bytes by name, and of each object which rows and corners are its own."""
    graph = context.evaluated_depsgraph_get()
    parts, materials = [], []
    for obj in objects:
        evaluated = obj.evaluated_get(graph)
        slots = _slots(obj, notes)
        part = part_of(evaluated, evaluated.matrix_world, _uv_names(evaluated, slots, settings))
        if part is None:
            raise Fault(f"{obj.name} has no faces: give it some, or leave it out of the selection")
        parts.append(part._replace(name=obj.name))
        materials.append(slots)
    files = {"objects.glb": make_glb(parts, materials, _pictures(materials))}
    if settings.others:
        around = _others(graph, set(objects))
        if around:
            plain = [{slot: material_of(None, notes) for slot in np.unique(part.material)} for part in around]
            files["others.glb"] = make_glb(around, plain, {})
    return files, parts


def _slots(obj, notes):
    """The materials of an object by slot: its own, even while it shows what came back."""
    own = _own_materials(obj)
    return dict(enumerate(material_of(each, notes) for each in own)) or {0: material_of(None, notes)}


def _uv_names(evaluated, slots, settings):
    """For every slot the names of the UV maps that are sent: that of its picture, that of the map."""
    layers = getattr(evaluated.data, "uv_layers", ())
    shown = next((layer.name for layer in layers if layer.active_render), "")
    last = [settings.uv] if settings.where == "TEXELS" else []
    textured = any(each["image"] is not None for each in slots.values())
    if not textured and not last:
        return {-1: []}
    # Where there is no picture, the first set is that of the map too: glTF has no second without a first.
    bare = [settings.uv if last else "", *last]
    return {
        number: [each["uv"] or shown, *last] if each["image"] is not None else bare for number, each in slots.items()
    } | {-1: bare}


def _pictures(materials):
    found = {}
    for slots in materials:
        for about in slots.values():
            if about["image"] is not None and about["image"].name not in found:
                found[about["image"].name] = png_of(about["image"])
    return found


def _others(graph, objects):
    """What is visible and not baked, instances too: it casts shadows."""
    found = []
    for instance in graph.object_instances:
        obj = instance.object
        original = obj.original
        if obj.type not in SOLID or not instance.show_self or "torchprt_of" in original:
            continue
        if not instance.is_instance and original in objects:
            continue
        part = part_of(obj, instance.matrix_world.copy(), {-1: []})
        if part is not None:
            found.append(part)
    return found


# --- The command, in a process of its own.


def command_line(text):
    """The words of the command that the preferences name, or that is found on the path."""
    if not text:
        found = shutil.which("torchprt")
        if found is None:
            raise Fault("The command torchprt is not on the path: give its place in the preferences of the add-on")
        return [found]
    if Path(text).is_file():
        return [text]
    words = shlex.split(text, posix=os.name != "nt")
    if shutil.which(words[0]) is None:
        raise Fault(f"The command {words[0]} does not exist: give its place in the preferences of the add-on")
    return words


def bake_words(settings, folder, others):
    """What follows `torchprt` to bake what was sent to a folder."""
    words = ["bake", str(folder / "objects.glb"), "-o", str(folder / "bake.safetensors")]
    words += ["--order", str(settings.order), "--rays", str(settings.rays), "--bounces", settings.bounces]
    if others:
        words += ["--blocker", str(folder / "others.glb")]
    if settings.gloss:
        words += ["--material", "file"]
    if settings.where == "TEXELS":
        words += ["--texels", str(settings.size), "--uv", "1"]
    return words


def shade_words(folder, environment, yaw, output, white=False, eye=None):
    """What follows `torchprt` to light a bake; the yaw is about the axis that is up, counter-clockwise from above."""
    words = ["shade", str(folder / "bake.safetensors"), "--light", str(environment), "--rotate", f"{yaw:g}"]
    if white:
        words.append("--white")
    if eye is not None:
        words += ["--eye", ",".join(f"{each:.9g}" for each in eye)]
    return [*words, "-o", str(output)]


class Process:
    """`torchprt` at work: `poll` reads what it told, `stop` ends it so that a bake can go on later."""

    def __init__(self, words):
        environment = {
            name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "TORCHPRT_QUIET")
        }
        environment |= {"TORCHPRT_PROGRESS": "lines", "PYTHONUTF8": "1", "COLUMNS": "400"}
        try:
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                encoding="utf-8",
                errors="replace",
                env=environment,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as fault:
            raise Fault(
                f"{words[0]} does not start ({fault.strerror}): look at the preferences of the add-on"
            ) from fault
        self._lines = queue.Queue()
        self._threads = [
            threading.Thread(target=self._listen, args=(stream, name), daemon=True)
            for stream, name in ((self._process.stdout, "said"), (self._process.stderr, "complained"))
        ]
        for thread in self._threads:
            thread.start()
        self.stage, self.share = "starting", 0.0
        self.said, self.complained = [], []

    def _listen(self, stream, name):
        with stream:
            for line in stream:
                self._lines.put((name, line.rstrip()))

    def poll(self):
        """Reads what was told; True when it has ended."""
        ended = self._process.poll() is not None
        if ended:
            for thread in self._threads:
                thread.join(timeout=5)
        while not self._lines.empty():
            name, line = self._lines.get()
            progress = re.fullmatch(r"\s*(.+?) (\d+)%", line)
            if name == "complained" and progress:
                self.stage, self.share = progress[1], int(progress[2]) / 100
            elif line.strip():
                getattr(self, name).append(line)
        return ended

    def wait(self):
        self._process.wait()

    def stop(self):
        if self._process.poll() is None:
            # With Ctrl-C it says how to go on; Windows knows none for a process without a console, and what is done is
            # kept all the same.
            self._process.send_signal(signal.SIGINT if os.name != "nt" else signal.SIGTERM)
            try:
                self._process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                self._process.kill()

    def check(self):
        """Fault, with its one sentence, if it failed."""
        if self._process.returncode:
            raise Fault(sentence(self.complained) or f"torchprt ended with {self._process.returncode} and said nothing")

    def warnings(self):
        return [line.removeprefix("torchprt: ") for line in self.complained if line.startswith("torchprt: ")]


def sentence(lines):
    """What a command complained of, without frames around it."""
    plain = [line.strip(" │╭╰─╮╯") for line in lines]
    own = [line for line in plain if line.startswith("torchprt: ")]
    kept = [line for line in own or plain if line and line != "Error"]
    return kept[-1].removeprefix("torchprt: ") if kept else ""


# --- Where things are kept.


def folder_of(context):
    """The folder of a scene: beside its .blend, or for one that was never saved among the temporary ones."""
    settings = context.scene.torchprt
    if settings.folder.startswith("//") and not bpy.data.filepath:
        top = Path(tempfile.gettempdir()) / "torchprt-blender"
    else:
        top = Path(bpy.path.abspath(settings.folder))
    return top / bpy.path.clean_name(context.scene.name)


def write(path, data):
    """Whole or not at all, and not if it is there as it is."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_bytes() != data:
            part = path.with_name(path.name + ".part")
            part.write_bytes(data)
            part.replace(path)
    except OSError as fault:
        raise Fault(f"{path} cannot be written ({fault.strerror}): choose another folder") from fault


def prepare_bake(context, notes):
    """Writes what is baked and returns the words of the command and what `Light` must know of the bake."""
    settings = context.scene.torchprt
    objects = [original_of(obj) for obj in context.selected_objects if obj.type == "MESH"]
    objects = sorted(dict.fromkeys(objects), key=lambda obj: obj.name)
    if not objects:
        raise Fault("No mesh is selected: select the objects that shall receive light")
    with _visible(objects):
        files, parts = sent(context, objects, settings, notes)
    folder = folder_of(context)
    for name, data in files.items():
        write(folder / name, data)
    about = {
        "objects": [part.name for part in parts],
        "rows": [len(part.positions) for part in parts],
        "digest": digest_of(files),
        "where": settings.where,
        "uv": settings.uv,
        "gloss": settings.gloss,
        "others": settings.others,
    }
    words = bake_words(settings, folder, "others.glb" in files)
    return [*command_line(command_text(context)), *words], about


def digest_of(files):
    """What tells a scene from one that was changed."""
    return hashlib.sha256(b"".join(files[name] for name in sorted(files))).hexdigest()


def keep_bake(context, about):
    """Notes that a bake is there."""
    write(folder_of(context) / "bake.json", json.dumps(about, indent=1).encode())


def noted(context):
    """What `keep_bake` noted. Fault if there is nothing, or if objects are gone."""
    path = folder_of(context) / "bake.json"
    if not path.exists():
        raise Fault("Nothing is baked yet: select objects and press Bake")
    about = json.loads(path.read_text())
    missing = [name for name in about["objects"] if name not in context.scene.objects]
    if missing:
        raise Fault(f"{missing[0]} was baked and is gone from the scene: bake again")
    return about


def read_bake(context):
    """What `keep_bake` noted, the objects, and their parts as they are now. Fault if they were changed since."""
    about = noted(context)
    objects = [context.scene.objects[name] for name in about["objects"]]
    with _visible(objects):
        files, parts = sent(context, objects, Baked(about["where"], about["uv"], about["others"]), [])
    if digest_of(files) != about["digest"]:
        raise Fault("Objects were moved or changed since they were baked: bake again")
    return about, objects, parts


class Baked(NamedTuple):
    """Those settings that say what is sent."""

    where: str
    uv: str
    others: bool


@contextlib.contextmanager
def _visible(objects):
    """Objects behind their copies are evaluated too."""
    hidden = [obj for obj in objects if obj.hide_get()]
    for obj in hidden:
        obj.hide_set(False)
    try:
        yield
    finally:
        for obj in hidden:
            obj.hide_set(True)


def command_text(context):
    """What the preferences say; the environment variable TORCHPRT_COMMAND is for scripts, which have none."""
    addon = context.preferences.addons.get(__name__)
    return (addon.preferences.command if addon else "") or os.environ.get("TORCHPRT_COMMAND", "")


# --- Light.


def world_image(context, path, height=256):
    """The world of the scene as Cycles sees it from inside, as a latitude-longitude .exr: any nodes, any strength."""
    if "cycles" not in context.preferences.addons:
        raise Fault("The world is looked at by Cycles, which is off: turn it on in the preferences, or choose a file")
    if context.scene.world is None:
        raise Fault("The scene has no world: add one, or choose a file for the light")
    scene = bpy.data.scenes.new("torchprt world")
    camera = bpy.data.cameras.new("torchprt world")
    eye = bpy.data.objects.new("torchprt world", camera)
    try:
        scene.world = context.scene.world
        scene.collection.objects.link(eye)
        scene.camera = eye
        # Toward +y with z up: the middle of such an image in torchprt.
        eye.rotation_euler = (math.pi / 2, 0.0, 0.0)
        camera.type = "PANO"
        (camera if hasattr(camera, "panorama_type") else camera.cycles).panorama_type = "EQUIRECTANGULAR"
        scene.render.engine = "CYCLES"
        scene.cycles.samples = 16
        scene.cycles.use_adaptive_sampling = False
        scene.cycles.use_denoising = False
        scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0.0
        scene.render.resolution_x, scene.render.resolution_y = 2 * height, height
        scene.render.resolution_percentage = 100
        scene.render.film_transparent = False
        scene.render.use_compositing = scene.render.use_sequencer = False
        form = scene.render.image_settings
        form.file_format, form.color_mode, form.color_depth = "OPEN_EXR", "RGB", "32"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True, scene=scene.name)
        if not path.exists():
            raise Fault(f"{path} was not written by Cycles: choose another folder")
    finally:
        bpy.data.objects.remove(eye)
        bpy.data.cameras.remove(camera)
        bpy.data.scenes.remove(scene)


def prepare_light(context, light, about, seen):
    """The words of the command that lights a bake by `light`, and the file that comes of it.

    `seen`: the worlds that were looked at already.
    """
    folder = folder_of(context)
    if light.source == "WORLD":
        environment, yaw = folder / "world.exr", 0.0
        if environment not in seen:
            world_image(context, environment)
            seen.add(environment)
    else:
        environment, yaw = Path(bpy.path.abspath(light.path)), FACING
        if not light.path or not environment.is_file():
            raise Fault(f"Light {light.name} has no file '{light.path}': choose an .exr or .hdr")
    eye = None
    if about["gloss"] and not context.scene.torchprt.white:
        if context.scene.camera is None:
            raise Fault("Gloss looks different from everywhere, and the scene has no camera: add one")
        eye = y_up(np.array(context.scene.camera.matrix_world)[:3, 3])
    output = folder / (bpy.path.clean_name(light.name) + (".exr" if about["where"] == "TEXELS" else ".npy"))
    white = context.scene.torchprt.white
    words = shade_words(folder, environment, yaw + math.degrees(light.rotation), output, white, eye)
    return [*command_line(command_text(context)), *words], output


# --- What comes back.


def bring_back(context, light, output, bake, notes):
    """Colours or a map onto the objects of a bake, as `read_bake` gave it."""
    about, objects, parts = bake
    light.white = context.scene.torchprt.white
    if about["where"] == "TEXELS":
        image = bpy.data.images.get(PREFIX + light.name) or bpy.data.images.load(str(output))
        image.name = PREFIX + light.name
        image.filepath = str(output)
        image.reload()
        return
    radiance = np.load(output)
    if len(radiance) < sum(about["rows"]):
        raise Fault(f"{output} has {len(radiance)} rows for {sum(about['rows'])} of the objects: bake again")
    start = 0
    for obj, part in zip(objects, parts, strict=True):
        rows = radiance[start : start + len(part.positions)]
        start += len(part.positions)
        with _visible([obj]):
            target = _receiver(context, obj, part, notes)
        if len(target.data.loops) != len(part.row_of_corner):
            raise Fault(f"{obj.name} was changed while it was lit: bake again")
        name = PREFIX + light.name
        old = target.data.color_attributes.get(name)
        if old is not None and (old.domain != "CORNER" or old.data_type != "FLOAT_COLOR"):
            target.data.color_attributes.remove(old)
            old = None
        colours = old or target.data.color_attributes.new(name, "FLOAT_COLOR", "CORNER")
        values = np.ones((len(part.row_of_corner), 4), np.float32)
        values[:, :3] = rows[part.row_of_corner]
        colours.data.foreach_set("color", values.ravel())
        target.data.update()


def _receiver(context, obj, part, notes):
    """The object itself if its modifiers leave its corners alone, or a copy of it with its modifiers applied."""
    graph = context.evaluated_depsgraph_get()
    evaluated = obj.evaluated_get(graph)
    mesh = evaluated.to_mesh()
    same = len(mesh.vertices) == len(obj.data.vertices) and np.array_equal(
        _read(mesh.loops, "vertex_index", np.int32), _read(obj.data.loops, "vertex_index", np.int32)
    )
    evaluated.to_mesh_clear()
    if same:
        if obj.data.users > 1:
            notes.append(f"{obj.name} shared its mesh, and has one of its own now: it stands in other light.")
            obj.data = obj.data.copy()
        return obj
    copy = copy_of(context, obj)
    if copy is None or len(copy.data.loops) != len(part.row_of_corner):
        mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=graph)
        if copy is None:
            copy = bpy.data.objects.new(obj.name + " lit", mesh)
            copy["torchprt_of"] = obj.name
            for collection in obj.users_collection:
                collection.objects.link(copy)
            notes.append(f"{obj.name} has modifiers that change its faces: {copy.name} shows them applied.")
        else:
            old, copy.data = copy.data, mesh
            bpy.data.meshes.remove(old)
    copy.matrix_world = obj.matrix_world
    return copy


def copy_of(context, obj):
    return next((each for each in context.scene.objects if each.get("torchprt_of") == obj.name), None)


def original_of(obj):
    return bpy.data.objects.get(obj.get("torchprt_of", ""), obj)


def lit_material(light, uv, own, bare=(1.0, 1.0, 1.0)):
    """A material that shows what came back without any light of the scene: as it is, or on the base colour of `own`.

    `bare`: what it is multiplied with where there is no `own`.
    """
    name = PREFIX + light.name
    title = name if own is None else f"{name} on {own.name}"
    old = bpy.data.materials.get(title)
    material = bpy.data.materials.new(title) if own is None else own.copy()
    if old is not None:
        old.user_remap(material)
        bpy.data.materials.remove(old)
    material.name = title
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    if own is None:
        nodes.clear()
    colour = bare if own is None else _base_colour(own, nodes)
    for node in [node for node in nodes if node.type == "OUTPUT_MATERIAL"]:
        nodes.remove(node)
    output, emission = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeEmission")
    if uv:
        source, place = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeUVMap")
        source.image, place.uv_map = bpy.data.images[name], uv
        source.extension = "EXTEND"
        links.new(place.outputs[0], source.inputs[0])
        place.location = (-400, 500)
    else:
        source = nodes.new("ShaderNodeVertexColor")
        source.layer_name = name
    product = nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    links.new(source.outputs["Color"], product.inputs[0])
    if isinstance(colour, tuple):
        product.inputs[1].default_value = colour
    else:
        links.new(colour, product.inputs[1])
    links.new(product.outputs[0], emission.inputs["Color"])
    links.new(emission.outputs[0], output.inputs["Surface"])
    for x, node in ((-200, source), (100, product), (300, emission), (500, output)):
        node.location = (x, 500)
    return material


def _base_colour(own, nodes):
    """What light is multiplied with: a socket of the nodes, or a number each channel."""
    diffuse = next((node for kind in BASES for node in nodes if node.type == kind), None)
    if diffuse is None:
        return tuple(own.diffuse_color[:3])
    socket = diffuse.inputs[0]
    return socket.links[0].from_socket if socket.is_linked else tuple(socket.default_value[:3])


def show(context, light):
    """The objects of the bake in a light. Their own materials stay in their meshes, `restore` brings them back."""
    about = noted(context)
    uv, name = about["uv"] if about["where"] == "TEXELS" else "", PREFIX + light.name
    objects = [context.scene.objects[each] for each in about["objects"]]
    seen = [copy_of(context, obj) or obj for obj in objects]
    if name not in bpy.data.images if uv else any(name not in each.data.color_attributes for each in seen):
        raise Fault(f"{light.name} has brought nothing back yet: press Light")
    made = {None: lit_material(light, uv, None, material_of(None, [])["colour"] if light.white else (1.0, 1.0, 1.0))}
    for obj in objects:
        copy = None if uv else copy_of(context, obj)
        own = _own_materials(obj) or [None]
        for each in own if light.white else ():
            if each not in made:
                made[each] = lit_material(light, uv, each)
        for each in [obj] if copy is None else [obj, copy]:
            _dress(each, [made[slot if light.white else None] for slot in own])
        if copy is not None:
            copy.hide_set(False)
            copy.hide_render = False
            obj.hide_set(True)
            obj.hide_render = True


def _dress(obj, materials):
    if not obj.material_slots:
        obj.data.materials.append(None)
    if "torchprt_own" not in obj:
        kept = [slot.material.name if slot.link == "OBJECT" and slot.material else "" for slot in obj.material_slots]
        obj["torchprt_own"] = json.dumps(
            [[slot.link, name] for slot, name in zip(obj.material_slots, kept, strict=True)]
        )
    for slot, material in zip(obj.material_slots, materials, strict=True):
        slot.link = "OBJECT"
        slot.material = material


def _own_materials(obj):
    """The materials of an object's slots, even while it shows what came back."""
    kept = json.loads(obj["torchprt_own"]) if "torchprt_own" in obj else None
    if kept is None or len(kept) != len(obj.material_slots):
        return [slot.material for slot in obj.material_slots]
    return [
        bpy.data.materials.get(name) if link == "OBJECT" else obj.data.materials[number]
        for number, (link, name) in enumerate(kept)
    ]


def restore(context):
    """Their own materials to all objects of the scene, and copies away."""
    for obj in list(context.scene.objects):
        if "torchprt_of" in obj:
            original = original_of(obj)
            original.hide_set(False)
            original.hide_render = False
            mesh = obj.data
            bpy.data.objects.remove(obj)
            bpy.data.meshes.remove(mesh)
        elif "torchprt_own" in obj:
            own = _own_materials(obj)
            for slot, material, (link, _) in zip(
                obj.material_slots, own, json.loads(obj["torchprt_own"]), strict=False
            ):
                slot.material = material if link == "OBJECT" else None
                slot.link = link
            del obj["torchprt_own"]


def make_uvs(context):
    """A UV map of the chosen name on the selected meshes, all on one square, that nothing overlaps on."""
    name = context.scene.torchprt.uv
    objects = [obj for obj in context.selected_objects if obj.type == "MESH"]
    if not objects or not name:
        raise Fault("No mesh is selected, or no name given to the UV map: select the objects that share a lightmap")
    meshes = {}
    for obj in objects:
        if obj.data in meshes:
            raise Fault(
                f"{obj.name} and {meshes[obj.data]} share a mesh, and would share their place on the map: make single "
                "users of them (Object > Relations)"
            )
        meshes[obj.data] = obj.name
    edited = []
    for obj in objects:
        layers = obj.data.uv_layers
        edited.append((obj, max(layers.active_index, 0)))
        layer = layers.get(name) or layers.new(name=name)
        if layer is None:
            raise Fault(f"{obj.name} has eight UV maps already: take one away")
        layers.active = layer
    context.view_layer.objects.active = objects[0]
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        bpy.ops.mesh.reveal()
        bpy.ops.mesh.select_all(action="SELECT")
        # Gutters are four texels wide on each side.
        bpy.ops.uv.smart_project(island_margin=8 / context.scene.torchprt.size, margin_method="FRACTION")
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
        for obj, index in edited:
            obj.data.uv_layers.active_index = index


# --- What is seen: settings, operators, panel.


# Newer Blenders want to be told that a path may begin with //.
_PLACED = {"ANIMATABLE"}
if "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties:
    _PLACED |= {"PATH_SUPPORTS_BLEND_RELATIVE"}


class TorchprtLight(bpy.types.PropertyGroup):
    source: bpy.props.EnumProperty(
        name="From",
        items=[
            ("WORLD", "World", "The world of this scene, as Cycles sees it"),
            ("FILE", "File", "An .exr or .hdr of an environment, placed as Blender's Environment Texture places it"),
        ],
    )
    path: bpy.props.StringProperty(name="File", subtype="FILE_PATH", options=_PLACED)
    rotation: bpy.props.FloatProperty(
        name="Rotation", subtype="ANGLE", description="Turns the light about z, counter-clockwise seen from above"
    )
    white: bpy.props.BoolProperty(description="Whether what came back is without base colour")


class TorchprtSettings(bpy.types.PropertyGroup):
    where: bpy.props.EnumProperty(
        name="Into",
        items=[
            ("VERTICES", "Vertices", "Light comes back as a color attribute"),
            ("TEXELS", "Texels", "Light comes back as an image on a UV map"),
        ],
    )
    size: bpy.props.IntProperty(
        name="Size", default=1024, min=8, max=8192, description="Texels along a side of the map"
    )
    uv: bpy.props.StringProperty(name="UV map", default="Lightmap")
    order: bpy.props.IntProperty(name="Order", default=5, min=1, max=16, description="Bands of light: sharper shadows")
    rays: bpy.props.IntProperty(name="Rays", default=1024, min=1, max=1 << 22, description="For each vertex or texel")
    bounces: bpy.props.EnumProperty(
        name="Bounces",
        items=[("auto", "Auto", "Until one adds less than 1 %"), *((str(n), str(n), "") for n in range(9))],
    )
    white: bpy.props.BoolProperty(
        name="Without base colour",
        description="What arrives and not what leaves; the materials that show it multiply it with their base colour, "
        "so that fine textures stay fine",
    )
    gloss: bpy.props.BoolProperty(name="Gloss", description="Of the materials, seen from the camera of the scene")
    others: bpy.props.BoolProperty(
        name="Others cast shadows", default=True, description="Visible objects that are not selected"
    )
    folder: bpy.props.StringProperty(name="Folder", subtype="DIR_PATH", default="//torchprt", options=_PLACED)
    lights: bpy.props.CollectionProperty(type=TorchprtLight)
    light: bpy.props.IntProperty()


class TorchprtPreferences(bpy.types.AddonPreferences):
    bl_idname = __name__
    command: bpy.props.StringProperty(
        name="Command", subtype="FILE_PATH", description="Of torchprt; empty: the one that is found on the path"
    )

    def draw(self, context):
        self.layout.prop(self, "command")


def chosen_light(settings):
    """The light of the list that is chosen. Fault if there is none."""
    if not 0 <= settings.light < len(settings.lights):
        raise Fault("There is no light: add one with +")
    return settings.lights[settings.light]


class Work:
    """Commands one after the other, each made when its turn comes and followed by what it is for.

    `steps` yields pairs: words of a command, and what to do when it has ended well.
    """

    running = None

    def __init__(self, steps, notes):
        self._steps, self.notes, self.process = iter(steps), notes, None
        self._then = None
        self.said = []
        self._next()

    def _next(self):
        words, self._then = next(self._steps, (None, None))
        self.process = None if words is None else Process(words)

    def poll(self):
        """Goes on; True when all is done. Fault if a command failed."""
        if self.process is None:
            return True
        if self.process.poll():
            self.process.check()
            self.notes += self.process.warnings()
            self.said += self.process.said
            self._then()
            self._next()
        return self.process is None

    def told(self):
        return f"{self.process.stage} {self.process.share:.0%}" if self.process else ""

    def finish(self):
        """Until all is done, for scripts."""
        try:
            while not self.poll():
                self.process.wait()
        except BaseException:
            self.stop()
            raise

    def stop(self):
        if self.process is not None:
            self.process.stop()


def baking(context):
    """The work of a bake."""
    notes = []

    def steps():
        words, about = prepare_bake(context, notes)
        yield words, lambda: keep_bake(context, about)

    return Work(steps(), notes)


def lighting(context):
    """The work of lighting a bake by every light of the list; the chosen one is shown."""
    settings, notes = context.scene.torchprt, []
    chosen = chosen_light(settings)
    names = [light.name for light in settings.lights]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise Fault(f"Two lights are called {twice}, and so would be what they bring back: rename one")

    def steps():
        bake, seen = read_bake(context), set()
        for light in settings.lights:
            words, output = prepare_light(context, light, bake[0], seen)
            yield words, lambda light=light, output=output: bring_back(context, light, output, bake, notes)
        show(context, chosen)

    return Work(steps(), notes)


class _Working:
    """An operator that works on while the user does; in the background, where nobody looks, until it is done."""

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT" and Work.running is None

    def _told(self, work):
        for note in dict.fromkeys(work.notes):
            self.report({"WARNING"}, note)
        for line in work.said:
            print(line)
        self.report({"INFO"}, self.done)

    def execute(self, context):
        try:
            work = self.work(context)
            work.finish()
        except Fault as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        self._told(work)
        return {"FINISHED"}

    def invoke(self, context, event):
        if bpy.app.background:
            return self.execute(context)
        try:
            Work.running = self.work(context)
        except Fault as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        self._timer = context.window_manager.event_timer_add(0.1, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        work = Work.running
        if event.type == "ESC" and event.value == "PRESS":
            work.stop()
            self.report({"INFO"}, self.stopped)
            return self._end(context, {"CANCELLED"})
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            if work.poll():
                self._told(work)
                return self._end(context, {"FINISHED"})
        except Fault as fault:
            work.stop()
            self.report({"ERROR"}, str(fault))
            return self._end(context, {"CANCELLED"})
        except BaseException:
            work.stop()
            self._end(context, {"CANCELLED"})
            raise
        context.workspace.status_text_set(f"torchprt: {work.told()}    Esc stops it")
        for area in context.screen.areas if context.screen else ():
            if area.type == "VIEW_3D":
                area.tag_redraw()
        return {"PASS_THROUGH"}

    def _end(self, context, result):
        Work.running = None
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        return result


class TORCHPRT_OT_bake(_Working, bpy.types.Operator):
    """Bake how the selected meshes shadow and light themselves and each other"""

    bl_idname, bl_label = "torchprt.bake", "Bake"
    bl_options = {"REGISTER"}  # noqa: RUF012
    done = "Baked: press Light"
    stopped = "Stopped: the next bake of the same goes on from here"

    def work(self, context):
        return baking(context)


class TORCHPRT_OT_light(_Working, bpy.types.Operator):
    """Light what was baked by every light of the list, and show the chosen one"""

    bl_idname, bl_label = "torchprt.light", "Light"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012
    done = "Lit"
    stopped = "Stopped"

    def work(self, context):
        return lighting(context)


class _Quick:
    """An operator that is done at once."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT" and Work.running is None

    def execute(self, context):
        try:
            self.do(context)
        except Fault as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        return {"FINISHED"}


class TORCHPRT_OT_unwrap(_Quick, bpy.types.Operator):
    """Unfold the selected meshes onto one square without overlaps, as a UV map of their own (Smart UV Project)"""

    bl_idname, bl_label = "torchprt.unwrap", "Make Lightmap UVs"

    def do(self, context):
        make_uvs(context)


class TORCHPRT_OT_show(_Quick, bpy.types.Operator):
    """Show what was baked in the chosen light"""

    bl_idname, bl_label = "torchprt.show", "Show"

    def do(self, context):
        show(context, chosen_light(context.scene.torchprt))


class TORCHPRT_OT_restore(_Quick, bpy.types.Operator):
    """Give the objects their own materials back"""

    bl_idname, bl_label = "torchprt.restore", "Own Materials"

    def do(self, context):
        restore(context)


class TORCHPRT_OT_light_add(_Quick, bpy.types.Operator):
    """Add a light"""

    bl_idname, bl_label = "torchprt.light_add", "Add"

    def do(self, context):
        settings = context.scene.torchprt
        names = {light.name for light in settings.lights}
        light = settings.lights.add()
        light.name = next(n for n in ("Light", *(f"Light {i}" for i in range(2, 1000))) if n not in names)
        settings.light = len(settings.lights) - 1


class TORCHPRT_OT_light_remove(_Quick, bpy.types.Operator):
    """Remove the chosen light; what it brought back stays"""

    bl_idname, bl_label = "torchprt.light_remove", "Remove"

    def do(self, context):
        settings = context.scene.torchprt
        settings.lights.remove(settings.light)
        settings.light = max(min(settings.light, len(settings.lights) - 1), 0)


class TORCHPRT_UL_lights(bpy.types.UIList):
    def draw_item(self, context, layout, data, item, icon, active_data, active_property):
        layout.prop(item, "name", text="", emboss=False, icon="WORLD" if item.source == "WORLD" else "FILE_IMAGE")


class TORCHPRT_PT_panel(bpy.types.Panel):
    bl_label, bl_category = "torchprt", "torchprt"
    bl_space_type, bl_region_type = "VIEW_3D", "UI"

    def draw(self, context):
        settings, layout = context.scene.torchprt, self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column()
        column.prop(settings, "where", expand=True)
        if settings.where == "TEXELS":
            column.prop(settings, "size")
            column.prop(settings, "uv")
            column.operator("torchprt.unwrap", icon="UV")
        for name in ("order", "rays", "bounces", "gloss", "others", "folder"):
            column.prop(settings, name)
        layout.operator("torchprt.bake", icon="RENDER_STILL")
        row = layout.row()
        row.template_list("TORCHPRT_UL_lights", "", settings, "lights", settings, "light", rows=2)
        buttons = row.column(align=True)
        buttons.operator("torchprt.light_add", icon="ADD", text="")
        buttons.operator("torchprt.light_remove", icon="REMOVE", text="")
        if 0 <= settings.light < len(settings.lights):
            light = settings.lights[settings.light]
            column = layout.column()
            column.prop(light, "source", expand=True)
            if light.source == "FILE":
                column.prop(light, "path")
            column.prop(light, "rotation")
        layout.column().prop(settings, "white")
        layout.operator("torchprt.light", icon="LIGHT_SUN")
        row = layout.row(align=True)
        row.operator("torchprt.show")
        row.operator("torchprt.restore")
        if Work.running is not None:
            process = Work.running.process
            layout.progress(factor=process.share if process else 1.0, text=Work.running.told())
            layout.label(text="Esc stops it")


CLASSES = (
    TorchprtLight,
    TorchprtSettings,
    TorchprtPreferences,
    TORCHPRT_OT_bake,
    TORCHPRT_OT_light,
    TORCHPRT_OT_unwrap,
    TORCHPRT_OT_show,
    TORCHPRT_OT_restore,
    TORCHPRT_OT_light_add,
    TORCHPRT_OT_light_remove,
    TORCHPRT_UL_lights,
    TORCHPRT_PT_panel,
)


def register():
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.torchprt = bpy.props.PointerProperty(type=TorchprtSettings)


def unregister():
    if Work.running is not None:
        Work.running.stop()
    del bpy.types.Scene.torchprt
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
