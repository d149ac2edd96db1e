"""Pictures of an object whose neighbourhood was baked, moving over receivers that it has never seen."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.preview.camera import Camera, frame
from torchprt.preview.environment import Environment, automatic_exposure
from torchprt.preview.picture import SAMPLES, Still
from torchprt.scene import Mesh
from torchprt.sh import rotate, yaw_pitch_roll
from torchprt.shade import NeighbourhoodShader, by_ratio, shader, under_field
from torchprt.shade.display import TONE, ToneMap, linear
from torchprt.transfer import Transfer


class Cast:
    """Pictures of `receiver` under a light in which copies of an object stand, whose `neighbourhood` was baked.

    - `receiver`: a mesh, diffuse with `albedo`, one for all or `[V, 3]`; or a bake, which then shadows itself too: its
      layers are put under the light that the object leaves at each of its receivers.
    - `model`: a bake of the object itself, which is drawn too; nothing of the receiver shadows it.
    - `camera` (all is framed if omitted), `size`, `samples`, `exposure` and `tone` as for `Still` and its pictures;
      `background`: a colour in sRGB, a plain grey one if omitted.

    Raises InputError if the neighbourhood is none, or the orders of light differ.
    """

    def __init__(
        self,
        neighbourhood: Transfer,
        receiver: Mesh | Transfer,
        environment: Environment,
        *,
        model: Transfer | None = None,
        albedo: float | Sequence[float] | Tensor = 0.5,
        camera: Camera | None = None,
        size: tuple[int, int] = (800, 600),
        exposure: float | int | None = None,
        tone: ToneMap = TONE,
        samples: int = SAMPLES,
        background: tuple[float, float, float] | None = None,
    ):
        self.around = NeighbourhoodShader(neighbourhood)
        orders = {"neighbourhood": neighbourhood.order}
        orders |= {"receiver": receiver.order} if isinstance(receiver, Transfer) else {}
        orders |= {"model": model.order} if model is not None else {}
        if len(set(orders.values())) > 1:
            told = ", ".join(f"{name} {order}" for name, order in orders.items())
            raise InputError(f"the bakes answer to lights of different orders ({told}): bake all with one order")
        self.light = environment.light.float()
        self.exposure = automatic_exposure(environment.light) if exposure is None else float(exposure)
        self.tone: ToneMap = tone
        self.size, self.samples, self.camera = size, samples, camera
        self.behind = None if background is None else linear(torch.tensor(background)).expand(size[1], size[0], 3)
        self.positions, self.normals = receiver.positions.float(), receiver.normals.float()
        self.faces = receiver.faces.long()
        self.albedo = torch.as_tensor(albedo, dtype=torch.float32)
        self.own = shader(receiver, dtype=torch.float32) if isinstance(receiver, Transfer) else None
        self.model = model
        self.shown = None if model is None else shader(model, dtype=torch.float32)

    def radiance(
        self, poses: Float[Tensor, "K 4 4"], light: Float[Tensor, "N 3"], eye: Float[Tensor, "3"] | None = None
    ) -> Float[Tensor, "V 3"]:
        """Of the receivers, with a copy of the object at each of the poses."""
        with torch.no_grad():
            if self.own is not None:
                fields = self.around.light_at(light, positions=self.positions, pose=poses)
                # What each changes, added up: a light per receiver has no ratio.
                field = light + (fields - light).sum(0)
                seen = {"eye": eye} if "eye" in self.own.needs else {}
                return under_field(self.own, field, **seen)
            plain, change = self.around.parts(light, positions=self.positions, normals=self.normals, pose=poses)
            parts = [(plain, each) for each in change]
            radiance = plain + change[0] if len(parts) == 1 else by_ratio(parts)
            return radiance * self.albedo

    def picture(
        self, poses: Float[Tensor, "K 4 4"], rotation: Float[Tensor, "3 3"] | None = None
    ) -> Float[Tensor, "H W 3"]:
        """One picture as sRGB in [0, 1]; `rotation` turns the environment."""
        poses = poses.float()
        light = self.light if rotation is None else rotate(self.light, rotation.float())
        places, faces = [self.positions.double()], [self.faces]
        for pose in poses if self.model is not None else poses[:0]:
            assert self.model is not None
            faces.append(self.model.faces.long() + sum(map(len, places)))
            places.append((self.model.positions.float() @ pose[:3, :3].T + pose[:3, 3]).double())
        everything = torch.cat(places)
        camera = self.camera or frame(everything, aspect=self.size[0] / self.size[1])
        eye = torch.tensor(camera.eye)
        colours = [self.radiance(poses, light, eye)]
        for pose in poses if self.shown is not None else poses[:0]:
            assert self.shown is not None
            back = pose[:3, :3].T
            seen = {"eye": back @ (eye - pose[:3, 3])} if "eye" in self.shown.needs else {}
            with torch.no_grad():
                colours.append(self.shown(rotate(light, back), **seen))
        still = Still(everything, torch.cat(faces), size=self.size, camera=camera, samples=self.samples)
        # An eye sees no negative radiance, which ringing leaves in deep shadow.
        radiance = torch.cat(colours).clamp(min=0)
        return still.picture(radiance, exposure=self.exposure, tone=self.tone, background=self.behind)


def along(keys: Float[Tensor, "K 6"], count: int) -> Float[Tensor, "T 4 4"]:
    """`count` poses on a smooth way through keys: x, y, z and yaw, pitch, roll in degrees, evenly in time.

    Natural cubic splines of the six numbers (straight between two keys), so a yaw that goes on from 350 to 370 turns
    on.
    Raises InputError without keys, or unless `count` is 1 or more.
    """
    from scipy.interpolate import CubicSpline

    if keys.ndim != 2 or keys.shape[1] != 6 or not len(keys) or count < 1:
        raise InputError(f"{count} poses along keys of shape {list(keys.shape)}: give one or more, along [K, 6]")
    if len(keys) == 1:
        return motions(keys.double()).expand(count, 4, 4)
    times = torch.linspace(0, len(keys) - 1, count, dtype=torch.float64)
    spline = CubicSpline(range(len(keys)), keys.double().numpy(), bc_type="natural")
    return motions(torch.from_numpy(spline(times.numpy())))


def motions(keys: Float[Tensor, "*B 6"]) -> Float[Tensor, "*B 4 4"]:
    """Rigid motions from x, y, z and yaw, pitch, roll in degrees."""
    motion = torch.eye(4, dtype=keys.dtype).repeat(*keys.shape[:-1], 1, 1)
    motion[..., :3, :3] = yaw_pitch_roll(keys[..., 3:])
    motion[..., :3, 3] = keys[..., :3]
    return motion
