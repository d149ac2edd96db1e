"""Does what Blender sends arrive as it is, and does the light come back to the corners that it is of?

Without Blender its interface is a stub (tests/blender_stub.py). With TORCHPRT_BPY, a Python that has the package
bpy, all of it runs in Blender itself: pip install bpy in an environment of its own.
"""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import blender_stub as stub
import numpy as np
import pytest
import torch
from environments import save_exr

from torchprt.cli import main
from torchprt.scene import read_mesh, read_surface
from torchprt.sh import yaw_pitch_roll

ROOT = Path(__file__).parents[2]
ADDON = ROOT / "export" / "blender" / "torchprt_blender.py"

CORNERS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
CUBE = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
SQUARE = [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)]
MIRROR = np.diag([-1.0, 2.0, 1.0, 1.0])


@pytest.fixture
def bpy(monkeypatch):
    found = stub.module()
    monkeypatch.setitem(sys.modules, "bpy", found)
    return found


@pytest.fixture
def addon(bpy):
    spec = importlib.util.spec_from_file_location("torchprt_blender", ADDON)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class InThisProcess:
    """The command, here: its start takes seconds."""

    calls: list = []  # noqa: RUF012

    def __init__(self, words):
        self.calls.append(words)
        self.stage, self.share, self.said, self.complained = "starting", 0.0, [], []
        before, sys.argv = sys.argv, ["torchprt", *words[1:]]
        try:
            with pytest.raises(SystemExit) as end:
                main()
        finally:
            sys.argv = before
        assert not end.value.code, words

    def poll(self):
        return True

    def check(self): ...

    def wait(self): ...

    def stop(self): ...

    def warnings(self):
        return []


@pytest.fixture
def at_hand(addon, monkeypatch):
    """The command is at hand without a process."""
    monkeypatch.setattr(addon, "Process", InThisProcess)
    monkeypatch.setattr(addon, "command_line", lambda text: ["torchprt"])
    monkeypatch.setattr(InThisProcess, "calls", [])
    return InThisProcess


# --- Misuse: one sentence.


@pytest.mark.parametrize(
    ("does", "words"),
    [
        (lambda addon, context: addon.baking(context), "No mesh is selected"),
        (lambda addon, context: addon.make_uvs(context), "No mesh is selected"),
        (lambda addon, context: addon.lighting(context), "There is no light"),
        (lambda addon, context: addon.read_bake(context), "Nothing is baked yet"),
        (lambda addon, context: addon.command_line("/no/such/torchprt"), "does not exist"),
        (lambda addon, context: addon.world_image(context, Path("world.exr")), "Cycles, which is off"),
    ],
)
def test_what_a_user_can_mend_is_one_sentence(addon, bpy, tmp_path, does, words):
    with pytest.raises(addon.Fault, match=words):
        does(addon, stub.context(bpy, addon, tmp_path))


def test_a_map_needs_the_uv_map_that_is_named(addon, bpy, tmp_path):
    context = stub.context(bpy, addon, tmp_path, stub.Object("Cube", stub.Mesh(CORNERS, CUBE)))
    context.scene.torchprt.where = "TEXELS"
    with pytest.raises(addon.Fault, match="Cube has no UV map 'Lightmap'"):
        addon.prepare_bake(context, [])
    assert context.scene.objects["Cube"].cleared, "the mesh that was made for it is freed"


def test_an_object_without_faces_is_refused_by_name(addon, bpy, tmp_path):
    empty = stub.Object("Wire", stub.Mesh(SQUARE, [(0, 1, 2)]))
    empty.data.polygons = stub.Rows(0)
    with pytest.raises(addon.Fault, match="Wire has no faces"):
        addon.prepare_bake(stub.context(bpy, addon, tmp_path, empty), [])


def test_two_lights_of_one_name_are_refused(addon, bpy, tmp_path):
    context = stub.context(bpy, addon, tmp_path)
    context.scene.torchprt.lights = [stub.light(addon, "Sun"), stub.light(addon, "Sun")]
    with pytest.raises(addon.Fault, match="Two lights are called Sun"):
        addon.lighting(context)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["torchprt: a.glb is empty: export the mesh again"], "a.glb is empty: export the mesh again"),
        (["torchprt: look", "torchprt: rays is 0: give more"], "rays is 0: give more"),
        (
            ["Usage: torchprt bake", "╭─ Error ───╮", "│ No such option: --texels   │", "╰──────╯"],
            "No such option: --texels",
        ),
        (["Traceback", "MemoryError"], "MemoryError"),
        ([], ""),
    ],
)
def test_the_sentence_of_the_command_is_found(addon, lines, said):
    assert addon.sentence(lines) == said


# --- Rows know their corners.


def test_a_corner_is_a_row_where_normals_differ_and_none_where_they_agree(addon):
    for smooth, rows in ((False, 24), (True, 8)):
        part = addon.part_of(stub.Object("Cube", stub.Mesh(CORNERS, CUBE, smooth=smooth)), np.eye(4), {-1: []})
        assert len(part.positions) == rows
        corners = part.positions[part.row_of_corner]
        expected = addon.y_up(np.array(CORNERS)[np.concatenate(CUBE)])
        np.testing.assert_array_equal(corners, expected)


def test_texture_coordinates_part_rows_and_run_down_as_in_gltf(addon):
    uv = np.random.default_rng(0).random((24, 2))
    mesh = stub.Mesh(CORNERS, CUBE, smooth=True, uv={"Lightmap": uv})
    part = addon.part_of(stub.Object("Cube", mesh), np.eye(4), {-1: ["Lightmap"]})
    assert len(part.positions) == 24
    found = part.uv[0][part.row_of_corner]
    np.testing.assert_allclose(found, np.stack([uv[:, 0], 1 - uv[:, 1]], -1), atol=1e-7)


def test_up_is_up_and_a_mirror_keeps_outside_outside(addon, tmp_path):
    assert addon.y_up(np.array([1.0, 2.0, 3.0])).tolist() == [1.0, 3.0, -2.0]
    for matrix in (np.eye(4), MIRROR):
        part = addon.part_of(stub.Object("Cube", stub.Mesh(CORNERS, CUBE)), matrix, {-1: []})
        path = tmp_path / "cube.glb"
        path.write_bytes(addon.make_glb([part], [{0: addon.material_of(None, [])}], {}))
        mesh = read_mesh(path)
        a, b, c = mesh.positions[mesh.faces.long()].unbind(1)
        outward = torch.linalg.cross(b - a, c - a)
        assert ((outward * (a + b + c)).sum(-1) > 0).all()
        assert (mesh.normals * mesh.positions).sum(-1).min() > 0
        assert mesh.report.watertight


# --- The file.


def test_torchprt_reads_rows_in_their_order_with_materials_and_maps(addon, bpy, tmp_path):
    pixels = np.zeros((2, 2, 4), np.float32)
    pixels[:, 0, 0], pixels[:, 1, 1], pixels[..., 3] = 1, 1, 1
    picture = stub.Image("squares", pixels)
    uv = np.tile([[0.1, 0.1], [0.4, 0.1], [0.4, 0.9], [0.1, 0.9]], (6, 1))
    mesh = stub.Mesh(CORNERS, CUBE, uv={"Shown": uv, "Lightmap": 0.5 * uv}, slots=[0, 1, 0, 1, 0, 1])
    box = stub.Object("Box", mesh, stub.material("red", (0.5, 0.25, 0.125)), stub.material("picture", image=picture))
    floor = stub.Object("Floor", stub.Mesh(SQUARE, [(0, 1, 2, 3)], uv={"Lightmap": uv[:4]}))
    context = stub.context(bpy, addon, tmp_path, floor, box)
    context.scene.torchprt.where = "TEXELS"
    context.scene.torchprt.others = False
    files, parts = addon.sent(context, [box, floor], context.scene.torchprt, notes := [])
    assert notes == []
    path = tmp_path / "objects.glb"
    path.write_bytes(files["objects.glb"])
    surface = read_surface(path)
    expected = np.concatenate([part.positions for part in parts])
    np.testing.assert_array_equal(surface.mesh.positions.numpy(), expected)
    np.testing.assert_allclose(
        surface.mesh.normals.numpy(), np.concatenate([part.normals for part in parts]), atol=1e-6
    )
    colour = surface.look(gloss=False).diffuse[parts[0].row_of_corner]
    red = np.isin(np.arange(24) // 4, (0, 2, 4))
    np.testing.assert_allclose(colour[red], [[0.5, 0.25, 0.125]] * 12, atol=1e-6)
    # The left half of the picture is red; its two texels blend.
    assert (colour[~red][:, 0] > 4 * colour[~red][:, 1]).all()
    given = np.concatenate([part.uv[1] for part in parts])
    np.testing.assert_array_equal(surface.raw.more_uv[1], given[surface.mesh.faces.numpy()])


def test_what_the_nodes_of_a_material_are_not_understood_for_is_said(addon):
    toon = stub.material("toon", kind="BSDF_TOON")
    image = stub.Image("lost", np.zeros((0, 0, 4), np.float32))
    notes = []
    assert addon.material_of(toon, notes)["colour"] == (0.1, 0.2, 0.3)
    assert "toon has no Principled or Diffuse BSDF" in notes[0]
    with pytest.raises(addon.Fault, match="Image lost has no pixels"):
        addon.png_of(image)


# --- The command.


def test_the_words_of_the_command_are_those_that_it_knows(addon, bpy, tmp_path):
    import click
    from typer.main import get_command

    from torchprt.cli.command import app

    settings = stub.defaults(addon.TorchprtSettings)
    settings.where, settings.gloss = "TEXELS", True
    lists = [
        addon.bake_words(settings, tmp_path, others=True),
        addon.shade_words(tmp_path, "env.exr", -90.0, tmp_path / "Light.exr", white=True),
        addon.shade_words(tmp_path, "env.exr", 0.0, tmp_path / "Light.exr", eye=(1.0, 2.0, -3.0)),
    ]
    group = get_command(app)
    for verb, *rest in lists:
        command = group.commands[verb]
        # Parsed, not run: an option that is not known, or of another type, is an error of click.
        context = command.make_context(verb, list(rest), parent=click.Context(group))
        assert not context.args


def test_a_process_tells_its_stage_its_warnings_and_its_fault(addon):
    code = """
import os, sys
assert os.environ["TORCHPRT_PROGRESS"] == "lines"
print("diffuse 41%", file=sys.stderr)
print("torchprt: no light", file=sys.stderr)
print("12 rows")
sys.exit(2)
"""
    process = addon.Process([sys.executable, "-c", code])
    process.wait()
    assert process.poll()
    assert (process.stage, process.share, process.said) == ("diffuse", 0.41, ["12 rows"])
    assert process.warnings() == ["no light"]
    with pytest.raises(addon.Fault, match=r"^no light$"):
        process.check()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no Ctrl-C for a process without a console")
def test_a_process_that_is_stopped_can_keep_what_is_done(addon, tmp_path):
    kept = tmp_path / "kept"
    code = f"""
import pathlib, sys, time
try:
    print("diffuse 1%", file=sys.stderr, flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    pathlib.Path({str(kept)!r}).write_text("done so far")
"""
    process = addon.Process([sys.executable, "-c", code])
    while process.stage == "starting":
        assert not process.poll()
    process.stop()
    assert process.poll()
    assert kept.read_text() == "done so far"


# --- All the way, but for Blender.


def test_light_comes_back_to_the_corners_that_it_is_of(addon, bpy, at_hand, tmp_path):
    """A box over a white floor under a white sky: what is open reads its albedo, what is covered does not."""
    ground = [(x, y, 0) for x in (-30, -1, 1, 30) for y in (-30, -1, 1, 30)]
    tiles = [(4 * i + j, 4 * i + j + 4, 4 * i + j + 5, 4 * i + j + 1) for i in range(3) for j in range(3)]
    white = stub.material("white", (1.0, 1.0, 1.0))
    grey = stub.material("grey", (0.5, 0.25, 0.125))
    floor = stub.Object("A floor", stub.Mesh(ground, tiles), white)
    lifted = np.eye(4)
    lifted[:3, 3] = 5, 5, 1.5
    box = stub.Object("Box", stub.Mesh(CORNERS, CUBE), grey, matrix=lifted)
    context = stub.context(bpy, addon, tmp_path, box, floor)
    settings = context.scene.torchprt
    settings.order, settings.rays, settings.bounces = 2, 64, "0"
    sky = tmp_path / "sky.exr"
    save_exr(sky, np.ones((8, 16, 3), np.float32))
    settings.lights = [stub.light(addon, "Sky", source="FILE", path=str(sky))]
    for work in (addon.baking, addon.lighting):
        done = work(context)
        done.finish()
        assert done.notes == []
    assert [words[1] for words in at_hand.calls] == ["bake", "shade"]
    assert json.loads((tmp_path / "Scene" / "bake.json").read_text())["objects"] == ["A floor", "Box"]
    colours = {each.name: each.data.color_attributes["prt Sky"] for each in (floor, box)}
    assert {(each.domain, each.data_type) for each in colours.values()} == {("CORNER", "FLOAT_COLOR")}
    lit = {name: each.data.arrays["color"].reshape(-1, 4) for name, each in colours.items()}
    assert all((each[:, 3] == 1).all() for each in lit.values())
    # The far corners of the floor see all of the sky, and the top of the box too.
    corners = np.concatenate(tiles)
    far = np.isin(corners, (0, 3, 12, 15))
    np.testing.assert_allclose(lit["A floor"][far, :3], 1, atol=0.01)
    top = np.arange(24) // 4 == CUBE.index((1, 5, 7, 3))
    np.testing.assert_allclose(lit["Box"][top, :3], [[0.5, 0.25, 0.125]] * 4, atol=0.01)
    under = np.arange(24) // 4 == CUBE.index((0, 2, 6, 4))
    assert lit["Box"][under, :3].max() < 0.05
    # The materials of the meshes are as they were, and come back.
    assert box.data.materials == [grey]
    assert box.material_slots[0].link == "OBJECT"
    addon.restore(context)
    assert box.material_slots[0].link == "DATA"
    assert box.material_slots[0].material is grey
    # Moved, it would be lit as where it was.
    box.matrix_world[0, 3] += 1
    with pytest.raises(addon.Fault, match="moved or changed"):
        addon.lighting(context).finish()


def test_lights_of_files_stand_as_blender_places_them(addon, bpy, at_hand, tmp_path):
    """The middle of an image is +x in Blender, and -z, which is Blender's +y, in torchprt. Blender agrees below."""
    context = stub.context(bpy, addon, tmp_path)
    path = tmp_path / "env.exr"
    save_exr(path, np.ones((4, 8, 3), np.float32))
    for turn in (0.0, 30.0):
        light = stub.light(addon, "File", source="FILE", path=str(path), rotation=np.radians(turn))
        words, output = addon.prepare_light(context, light, {"gloss": False, "where": "TEXELS"}, set())
        assert output.suffix == ".exr"
        yaw = float(words[words.index("--rotate") + 1])
        middle = (
            yaw_pitch_roll(torch.tensor([yaw, 0.0, 0.0], dtype=torch.float64)) @ torch.tensor([0, 0, -1.0]).double()
        )
        seen = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn)), 0])
        np.testing.assert_allclose(middle.numpy(), addon.y_up(seen), atol=1e-12)


def test_an_operator_works_on_and_is_stopped_by_escape(addon, bpy, tmp_path, monkeypatch):
    ended = []

    class Slow:
        stage, share, said = "diffuse", 0.5, ()

        def poll(self):
            return bool(ended)

        def check(self): ...

        def warnings(self):
            return ["look"]

        def stop(self):
            ended.append("stopped")

    monkeypatch.setattr(addon, "Process", lambda words: Slow())
    context = stub.context(bpy, addon, tmp_path)
    event = {name: SimpleNamespace(type=name, value="PRESS") for name in ("TIMER", "ESC", "MOUSEMOVE")}
    for last, result in (("TIMER", {"FINISHED"}), ("ESC", {"CANCELLED"})):
        ended.clear()
        operator = addon.TORCHPRT_OT_bake()
        operator.report = MagicMock()
        operator.work = lambda context: addon.Work(iter([(["torchprt"], lambda: None)]), [])
        assert operator.poll(context)
        assert operator.invoke(context, None) == {"RUNNING_MODAL"}
        assert not operator.poll(context), "one at a time"
        for name in ("TIMER", "MOUSEMOVE"):
            assert operator.modal(context, event[name]) == {"PASS_THROUGH"}
        assert "diffuse 50%" in context.workspace.status_text_set.call_args.args[0]
        if last == "TIMER":
            ended.append("by itself")
        assert operator.modal(context, event[last]) == result
        assert ended == ["by itself" if last == "TIMER" else "stopped"]
        assert operator.poll(context)
        context.window_manager.event_timer_remove.assert_called()
        assert any("look" in call.args[1] for call in operator.report.call_args_list) == (last == "TIMER")


def test_the_panel_shows_settings_that_there_are(addon, bpy, tmp_path):
    addon.register()
    assert len(bpy.registered) == len(addon.CLASSES)
    context = stub.context(bpy, addon, tmp_path)
    context.scene.torchprt.lights = [stub.light(addon, "File", source="FILE")]
    context.scene.torchprt.where = "TEXELS"
    panel = addon.TORCHPRT_PT_panel()
    panel.layout = MagicMock()
    shown = []
    panel.layout.column.return_value.prop = lambda group, name, **options: shown.append(getattr(group, name, "missing"))
    panel.draw(context)
    assert len(shown) > 8
    assert "missing" not in shown
    operators = {each.bl_idname for each in addon.CLASSES if hasattr(each, "bl_idname")}
    layout = panel.layout
    rows = (layout, layout.row.return_value, layout.column.return_value, layout.row.return_value.column.return_value)
    named = {call.args[0] for each in rows for call in each.operator.call_args_list}
    assert named <= operators
    assert len(named) == 7
    addon.unregister()
    assert bpy.registered == []


# --- In Blender itself.


def test_in_blender_itself(tmp_path):
    python = os.environ.get("TORCHPRT_BPY")
    if not python:
        pytest.skip("no Blender: set TORCHPRT_BPY to a Python that has the package bpy")
    environment = os.environ | {
        "TORCHPRT_COMMAND": f'"{sys.executable}" -m torchprt',
        "PYTHONPATH": str(ROOT),
        "BLENDER_USER_RESOURCES": str(tmp_path / "user"),
        "OMP_NUM_THREADS": "1",
    }
    script = Path(__file__).with_name("in_blender.py")
    ended = subprocess.run(
        [python, script, ADDON, tmp_path], env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    assert "all is well" in ended.stdout, ended.stdout[-3000:] + ended.stderr[-3000:]
