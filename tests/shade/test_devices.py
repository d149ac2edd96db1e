"""Does everything of a shader stay on the device of the shader and its arguments, without looking at values?

There need be no GPU for this: `one_device` has a device that is not the default one.
"""

import pytest
import torch
from every_shader import asked, every_transfer, lights
from one_device import faults_of
from transfers import replaced
from zonal_transfers import random_zonal, turns

from torchprt import InputError, sh
from torchprt.pose import DeformedFrames, SkinnedMesh, nearest_rotation, surface_frames
from torchprt.shade import EnvironmentShader, display, shader
from torchprt.shade.display import TONES

TRANSFERS = every_transfer()
pytestmark = pytest.mark.usefixtures("untyped")


def calls(name):
    """Modules of a transfer and what they are called with."""
    transfer = TRANSFERS[name]
    module = shader(transfer)
    look = asked(module.needs, transfer.vertices, 2)
    yield module, (lights(2), turns(2)), look
    yield EnvironmentShader(module, 4, tone="filmic"), (torch.rand(2, 6, 4, 4, 3), turns(2)), look
    if "eye" in module.needs:
        eye = {"eye": torch.ones(2, 3)}
        positions = {"positions": transfer.positions} if "pose" in module.needs else {}
        yield module, (lights(2),), {**eye, **positions}
        yield module.fix_light(lights(2)), (), eye
        yield module.fix_eye(view=torch.ones(3)), (lights(2), turns(2)), {}
    if "pose" in module.needs:
        still = {key: value for key, value in look.items() if key != "frames"}
        yield module.fix_pose(look["frames"]), (lights(2),), still
        yield module, (lights(2),), {**still, "positions": transfer.positions}


@pytest.mark.parametrize("wanted", ["values", "gradients"])
@pytest.mark.parametrize("name", TRANSFERS)
def test_a_shader_stays_on_its_device(name, wanted):
    # All made before any is moved: they share parts.
    for module, given, look in list(calls(name)):
        given = [value.requires_grad_(wanted == "gradients") for value in given]

        def run(*given, module=module, **look):
            radiance = module(*given, **look)
            if radiance.requires_grad:
                radiance.sum().backward()
            return radiance

        module.to("meta")
        assert not faults_of(run, *given, **look)


@pytest.mark.parametrize("name", [name for name in TRANSFERS if name.endswith("1")])
def test_fixing_what_stands_still_stays_on_its_device(name):
    module = shader(TRANSFERS[name]).to("meta")
    if "eye" in module.needs:
        assert not faults_of(lambda l, r: list(module.fix_light(l, r).buffers()), lights(2), turns(2))
        assert not faults_of(lambda eye: list(module.fix_eye(eye=eye).buffers()), torch.ones(3))
    if "pose" in module.needs:
        assert not faults_of(lambda frames: list(module.fix_pose(frames).buffers()), turns(module.vertices))


def test_a_light_in_a_table_stays_on_its_device():
    module = shader(random_zonal(), method="table").to("meta")
    assert not faults_of(module, lights(2), turns(2), frames=turns(9))


@pytest.mark.parametrize("tone", TONES)
def test_display_stays_on_its_device(tone):
    assert not faults_of(lambda radiance: display(radiance, tone=tone), torch.rand(4, 3))


def test_poses_stay_on_their_device():
    transfer = random_zonal()
    frames = DeformedFrames(transfer.positions, transfer.faces, normals=transfer.normals).to("meta")
    assert not faults_of(frames, transfer.positions.expand(2, -1, -1))
    skin = SkinnedMesh(transfer.positions, torch.full((9, 2), 0.5)).to("meta")
    assert not faults_of(skin, torch.eye(4).expand(2, 2, 4, 4))
    assert not faults_of(nearest_rotation, turns(3))
    uv = transfer.positions[:, :2].contiguous()
    assert not faults_of(surface_frames, transfer.positions, transfer.faces, uv, transfer.normals)


@pytest.mark.parametrize("name", [name for name in TRANSFERS if name.endswith("1")])
def test_a_shader_is_where_its_transfer_is_whatever_the_default_device(name):
    wanted = EnvironmentShader(shader(TRANSFERS[name]), 4)
    with torch.device("meta"):
        module = EnvironmentShader(shader(TRANSFERS[name]), 4)
    look = asked(module.shader.needs, module.shader.vertices, 2)
    given = torch.rand(2, 6, 4, 4, 3), turns(2)
    with torch.device("meta"):
        found = module(*given, **look)
    assert torch.equal(found, wanted(*given, **look))


def test_what_has_no_values_is_refused_in_one_sentence():
    transfer = TRANSFERS["exit clustered 1"]
    with pytest.raises(InputError, match="transfer is on the meta device"):
        shader(replaced(transfer, positions=transfer.positions.to("meta")))
    with pytest.raises(InputError, match="on the meta device has no values"):
        shader(transfer).to("meta").to_empty(device="cpu")
    with pytest.raises(InputError, match="no state dict holds all of it"):
        shader(transfer).to("meta").load_state_dict(shader(transfer).state_dict(), assign=True)


@pytest.mark.parametrize("light", [torch.zeros(16, 3, dtype=torch.float64), torch.zeros(16, 3, dtype=torch.int64)])
def test_a_light_that_does_not_fit_the_numbers_of_the_shader_is_refused_in_one_sentence(light):
    module = shader(TRANSFERS["exit dense 1"])
    for call in (lambda: module(light, view=torch.ones(3)), lambda: module.fix_light(light)):
        with pytest.raises(InputError, match="convert the light"):
            call()


def test_nothing_is_looked_at_while_a_cuda_graph_is_captured(monkeypatch):
    module = shader(TRANSFERS["exit dense 1"])
    wrong = {"rotation": 2 * torch.eye(3), "view": torch.zeros(3)}
    with pytest.raises(InputError, match="orthogonal"):
        module(lights(), **wrong)
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: True)
    module(lights(), **wrong)
    sh.check_directions(torch.zeros(3))
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: False)
    with pytest.raises(InputError, match="orthogonal"):
        module(lights(), **wrong)
