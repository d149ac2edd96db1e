"""As much of Blender's Python interface as the add-on reads: meshes, objects, a scene. It draws and renders nothing.

Meshes hand out arrays by `foreach_get`, as Blender's do; what the add-on only writes to (nodes, windows) are mocks.
tests/export/in_blender.py is for Blender itself.
"""

import itertools
import types
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np


class Rows:
    """A collection of Blender's: arrays by the name of a property."""

    def __init__(self, count, **arrays):
        self._count = count
        self.arrays = {name: np.asarray(values) for name, values in arrays.items()}

    def __len__(self):
        return self._count

    def foreach_get(self, name, out):
        values = self.arrays[name]
        assert out.dtype == values.dtype, "Blender would convert one number after the other"
        out[:] = values.ravel()

    def foreach_set(self, name, values):
        assert values.ndim == 1
        self.arrays[name] = values.copy()


class Named(dict):
    """A collection of Blender's whose entries have names: iterated, they are the entries."""

    def __iter__(self):
        return iter(self.values())


class Colours(Named):
    def __init__(self, corners):
        super().__init__()
        self._corners = corners

    def new(self, name, data_type, domain):
        self[name] = SimpleNamespace(data_type=data_type, domain=domain, data=Rows(self._corners))
        return self[name]


class Mesh:
    """Polygons over vertices; flat, or with one normal a vertex. `uv`: by name, [corners, 2]."""

    def __init__(self, vertices, polygons, *, smooth=False, uv=None, slots=None):
        corners = np.concatenate([np.asarray(each) for each in polygons])
        starts = np.cumsum([0, *(len(each) for each in polygons)])
        points = np.asarray(vertices, np.float64)
        flat = [np.cross(points[p[1]] - points[p[0]], points[p[2]] - points[p[0]]) for p in polygons]
        flat = np.repeat(flat, np.diff(starts), axis=0)
        if smooth:
            total = np.zeros_like(points)
            np.add.at(total, corners, flat)
            flat = total[corners]
        normals = (flat / np.linalg.norm(flat, axis=1, keepdims=True)).astype(np.float32)
        fans = [(a, a + k, a + k + 1) for a, b in itertools.pairwise(starts) for k in range(1, b - a - 1)]
        self.vertices = Rows(len(points), co=points.astype(np.float32))
        self.loops = Rows(len(corners), vertex_index=corners.astype(np.int32))
        self.polygons = Rows(
            len(polygons),
            loop_total=np.diff(starts).astype(np.int32),
            material_index=np.asarray(slots if slots is not None else [0] * len(polygons), np.int32),
        )
        self.corner_normals = Rows(len(corners), vector=normals)
        self.loop_triangles = Rows(len(fans), loops=np.array(fans, np.int32))
        self.uv_layers = Named()
        for number, (name, values) in enumerate((uv or {}).items()):
            layer = SimpleNamespace(name=name, active_render=not number)
            layer.uv = Rows(len(corners), vector=np.asarray(values, np.float32))
            self.uv_layers[name] = layer
        self.color_attributes = Colours(len(corners))
        self.materials = []
        self.users = 1

    def calc_loop_triangles(self): ...

    def update(self): ...


class Slot:
    def __init__(self, mesh, number):
        self._mesh, self._number, self._own, self.link = mesh, number, None, "DATA"

    @property
    def material(self):
        return self._own if self.link == "OBJECT" else self._mesh.materials[self._number]

    @material.setter
    def material(self, value):
        assert self.link == "OBJECT", "the materials of the mesh are the user's"
        self._own = value


class Object(dict):
    """Its custom properties, and what it is."""

    type = "MESH"

    def __init__(self, name, mesh, *materials, matrix=None):
        super().__init__()
        self.name, self.data = name, mesh
        mesh.materials = list(materials)
        self._slots = []
        self.matrix_world = np.eye(4) if matrix is None else np.asarray(matrix, np.float64)
        self.hidden = False
        self.cleared = 0

    __hash__ = object.__hash__

    def __eq__(self, other):
        return self is other

    @property
    def material_slots(self):
        self._slots += [Slot(self.data, number) for number in range(len(self._slots), len(self.data.materials))]
        return self._slots

    @property
    def original(self):
        return self

    def evaluated_get(self, graph):
        return self

    def to_mesh(self):
        return self.data

    def to_mesh_clear(self):
        self.cleared += 1

    def hide_get(self):
        return self.hidden

    def hide_set(self, hidden):
        self.hidden = hidden


def material(name, colour=(0.8, 0.8, 0.8), image=None, uv=None, kind="BSDF_PRINCIPLED"):
    """A material whose base colour is a number or a picture, on a UV map of a name or on the one that is shown."""
    socket = SimpleNamespace(is_linked=image is not None, default_value=(*colour, 1.0), links=[])
    if image is not None:
        place = SimpleNamespace(is_linked=uv is not None, links=[])
        place.links = [SimpleNamespace(from_node=SimpleNamespace(type="UVMAP", uv_map=uv))]
        node = SimpleNamespace(type="TEX_IMAGE", image=image, inputs=[place])
        socket.links = [SimpleNamespace(from_node=node)]

    class Inputs(list):
        def __getitem__(self, key):
            return (
                SimpleNamespace(is_linked=False, default_value=0.25)
                if isinstance(key, str)
                else list.__getitem__(self, key)
            )

    shader = SimpleNamespace(type=kind, inputs=Inputs([socket]))
    return SimpleNamespace(
        name=name,
        use_backface_culling=False,
        diffuse_color=(0.1, 0.2, 0.3, 1.0),
        node_tree=SimpleNamespace(nodes=[shader]),
    )


class Image:
    """A picture of bytes: pixels between 0 and 1, row 0 below."""

    channels, is_float = 4, False
    colorspace_settings = SimpleNamespace(name="sRGB")

    def __init__(self, name, pixels):
        self.name, self.size = name, pixels.shape[1::-1]
        self.pixels = SimpleNamespace(foreach_get=lambda out: out.__setitem__(slice(None), pixels.ravel()))


def module():
    """A module `bpy`."""
    bpy = types.ModuleType("bpy")

    def asked(**kwargs):
        return SimpleNamespace(**kwargs)

    kinds = ("String", "Int", "Float", "Bool", "Enum", "Pointer", "Collection")
    bpy.props = SimpleNamespace(**{f"{kind}Property": asked for kind in kinds})
    names = ("PropertyGroup", "AddonPreferences", "Operator", "UIList", "Panel")
    bpy.types = SimpleNamespace(**{name: type(name, (), {}) for name in names})
    bpy.types.Scene = type("Scene", (), {})
    bpy.types.Property = SimpleNamespace(bl_rna=SimpleNamespace(properties=()))
    bpy.registered = []
    bpy.utils = SimpleNamespace(register_class=bpy.registered.append, unregister_class=bpy.registered.remove)
    bpy.app = SimpleNamespace(version=(5, 0, 1), background=False)
    bpy.path = SimpleNamespace(abspath=lambda path: path, clean_name=lambda name: name.replace("/", "_"))
    bpy.data = SimpleNamespace(filepath="", objects=Named(), images=Named(), materials=MagicMock())
    bpy.data.materials.get.return_value = None
    bpy.ops = MagicMock()
    return bpy


def defaults(group):
    """The settings of a group as Blender would make them."""
    found = {}
    for name, given in group.__annotations__.items():
        items = getattr(given, "items", None)
        found[name] = getattr(given, "default", items[0][0] if items else "" if "PATH" in str(vars(given)) else 0)
    return SimpleNamespace(**found)


def context(bpy, addon, folder, *objects):
    """A scene of objects, all of them selected."""
    settings = defaults(addon.TorchprtSettings)
    settings.folder, settings.lights = str(folder), []
    known = Named({each.name: each for each in objects})
    bpy.data.objects = known
    scene = SimpleNamespace(name="Scene", torchprt=settings, objects=known, camera=None, world=None)
    instances = [
        SimpleNamespace(object=each, show_self=True, is_instance=False, matrix_world=each.matrix_world)
        for each in objects
    ]
    return SimpleNamespace(
        scene=scene,
        mode="OBJECT",
        selected_objects=list(objects),
        preferences=SimpleNamespace(addons={}),
        evaluated_depsgraph_get=lambda: SimpleNamespace(object_instances=instances),
        window_manager=MagicMock(),
        workspace=MagicMock(),
        window=None,
        screen=None,
    )


def light(addon, name, **given):
    found = defaults(addon.TorchprtLight)
    vars(found).update(name=name, **given)
    return found
