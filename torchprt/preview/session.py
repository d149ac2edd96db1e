"""The state of a preview: what is shown of which bake, under which light, from where. No window in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.errors import InputError
from torchprt.light import WINDOWS, windowed
from torchprt.preview import modes
from torchprt.preview.animation import Animation
from torchprt.preview.camera import Camera
from torchprt.preview.environment import Environment, automatic_exposure, for_pixels, photograph
from torchprt.preview.error_colours import error_colours
from torchprt.preview.ground import opacity, subject
from torchprt.preview.lobe import Lobe, lobe
from torchprt.preview.mirror import mirror_radiance
from torchprt.preview.orbit import Orbit, dragged
from torchprt.preview.relight import Relight
from torchprt.preview.sight import sight_colours, sight_legend
from torchprt.shade import display, shader
from torchprt.shade.display import TONE, ToneMap
from torchprt.trace import Tracer
from torchprt.transfer import Transfer
from torchprt.words import count

MODES = ("transfer", "unshadowed", "one lamp", "compressed", "error", "sight")
UNBAKED = ("unshadowed", "one lamp")
"""Modes that look at normals alone."""
PLAIN = 0.27
"""sRGB of what is behind the model where nothing else is."""
BACKDROPS = ("plain", "environment", "environment in bands")
WORST = 0.1
"""The error of compression that is shown as red at exposure 0, relative to the RMS radiance."""
CLUSTERS = 256
"""Of what is compressed here, or a sixteenth of the receivers if they are few."""
MIRRORED = 0.02
"""Radians that a vertex of a mirror shows as one."""
LOBE = 0.25
"""How far a transfer function reaches, in radii of the model."""


class Session:
    """What a preview shows, and every change to it; `colours` are those of the vertices on the screen.

    `bakes`: by name, of one mesh: as many as there are (without and with bounces, compressed). `environments`: at
    least one, with lights of the highest order among the bakes. `brdf`: of bakes of kind "incident". `poses`: what
    transfer that follows the pose is shown in (`Animation`).
    Methods that change what is shown return a line that says what it is now.

    Raises InputError if there is no bake, no environment, bakes are of different meshes or have no faces, or the poses
    are not of that mesh.
    """

    # Whether what is drawn has a side that is not lit.
    has_reverse = True

    def __init__(
        self,
        bakes: Mapping[str, Transfer],
        environments: Sequence[Environment],
        *,
        brdf: Any = None,
        tone: ToneMap = TONE,
        toward: tuple[float, float, float] = (0.45, 0.35, 1.0),
        poses: Float[Tensor, "T V 3"] | None = None,
    ):
        if not bakes or not environments:
            raise InputError("there is nothing to preview: give a bake and an environment")
        first = next(iter(bakes.values()))
        drawn = self._drawn_of(bakes)
        self.bakes = {name: bake for name, bake in bakes.items() if not bake.approximates}
        self.compressed = {name: bake for name, bake in bakes.items() if bake.approximates}
        self.rest, self.faces = drawn
        self.receivers = first.receivers
        if poses is not None and self.surface_uv is not None:
            raise InputError("poses move vertices, and this bake was recorded at texels: leave them out")
        self.positions = self.rest
        self.playing = False
        self.seconds = 0.0
        self._animation = Animation(self.rest, poses)
        self.normals = first.normals.float()
        self.mirrors = first.receivers.mirrors
        self._around: tuple[int, Tensor] | None = None
        self.environments = list(environments)
        self.tone: ToneMap = tone
        self.mode = "transfer" if self.bakes else "compressed"
        self.bake = next(iter(self.bakes or self.compressed))
        self.packed = next(iter(self.compressed), None)
        self.order = self.highest = max(bake.order for bake in bakes.values())
        self.window = "none"
        self.exposure = 0.0
        self.environment = 0
        self.backdrop = BACKDROPS[0]
        self._opacity = opacity(first.receivers) if self.surface_uv is None else None
        self.rotation = torch.eye(3)
        self.orbit = self._home = Orbit.around(subject(first.receivers).double(), toward)
        self.picked: int | None = None
        self.radius = float(
            (subject(first.receivers).double() - torch.tensor(self.orbit.target).double()).norm(dim=-1).max()
        )
        self._brdf = brdf
        self._all = dict(bakes)
        self._relights: dict[str, Relight] = {}
        self._windowed: dict[tuple[int, int, str], Tensor] = {}
        self._tracer: Tracer | None = None
        self._traced: Tensor | None = None
        self._shown: tuple[object, Tensor] | None = None
        self.worst: float | None = None

    def _drawn_of(self, bakes: Mapping[str, Transfer]) -> tuple[Tensor, Tensor]:
        """Positions and faces of what is drawn; InputError if the bakes are of different meshes or have no faces."""
        first_name, first = next(iter(bakes.items()))
        for name, bake in bakes.items():
            if not (torch.equal(bake.faces, first.faces) and torch.equal(bake.positions, first.positions)):
                raise InputError(
                    f"{name} has {bake.vertices} vertices and {len(bake.faces)} faces, {first_name} {first.vertices} "
                    f"and {len(first.faces)}: give bakes of one mesh"
                )
        if not first.receivers.on_surface:
            raise InputError(f"{first_name} is a volume: use preview.VolumeSession, or session_of")
        positions, _, faces = first.receivers.surface
        if len(faces) == 0:
            raise InputError(f"{first_name} was recorded at loose points: a preview needs faces")
        return positions.double(), faces.long()

    # What is looked at

    @property
    def surface_uv(self) -> Float[Tensor, "F 3 2"] | None:
        """Where the corners of faces are on the map that `map` makes of colours; None if these are of vertices."""
        return self.receivers.surface_uv

    def map(self, colours: Float[Tensor, "V 3"]) -> Float[Tensor, "H W 3"]:
        """The map of colours of texels, with its gutters."""
        return self.receivers.as_atlas().image(colours)

    @property
    def camera(self) -> Camera:
        return self.orbit.camera()

    @property
    def eye(self) -> Float[Tensor, "3"]:
        return torch.tensor(self.camera.eye, dtype=torch.float64)

    @property
    def follows_eye(self) -> bool:
        """Whether the picture on the vertices changes with the camera."""
        return self.mode not in UNBAKED and self._relight(self._stored()).follows_eye

    @property
    def follows_pose(self) -> bool:
        """Whether the model can move: what is shown follows its pose."""
        return self.surface_uv is None and self._relight(self._stored()).follows_pose

    @property
    def stops(self) -> float:
        """The exposure in stops: that of the environment and what was added by hand."""
        return self.exposure + automatic_exposure(self.environments[self.environment].light)

    def light(self) -> Float[Tensor, "N 3"]:
        """The light as it is now: its bands and window, turned; zero in the bands that are dropped."""
        key = (self.environment, self.order, self.window)
        if key not in self._windowed:
            self._windowed[key] = windowed(self.environments[self.environment].light[: self.order**2], self.window)
        kept = self._windowed[key]
        turned = sh.rotate(kept, self.rotation)
        return torch.cat([turned, turned.new_zeros(self.highest**2 - len(turned), 3)])

    def radiance(self) -> Float[Tensor, "V 3"]:
        """Linear radiance of every vertex in the present mode; of "error", that of the compressed."""
        light = self.light()
        if self.mode in UNBAKED:
            lit = modes.unshadowed if self.mode == "unshadowed" else modes.one_lamp
            return lit(light, self._normals()) * modes.reflectance(self._all[self.bake])
        return self._shade(self._stored(), light)

    def colours(self) -> Float[Tensor, "V 3"]:
        """sRGB in [0, 1] of every vertex; the same tensor as before if nothing has changed that it depends on."""
        key = (
            *(self.mode, self.bake, self.packed, self.order, self.window, self.environment, self.exposure),
            *(tuple(self.rotation.flatten().tolist()), self.orbit if self.follows_eye else None),
            self.seconds if self.follows_pose else None,
            self._opacity is not None and self.backdrop == BACKDROPS[0],
        )
        if self._shown is None or self._shown[0] != key:
            self._shown = key, self._faded(self._make_colours())
        return self._shown[1]

    def _faded(self, colours: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """With a ground that becomes the plain background toward its edge."""
        if self._opacity is None or self.backdrop != BACKDROPS[0]:
            return colours
        share = self._opacity.to(colours)[:, None]
        return share * colours + (1 - share) * PLAIN

    def backdrop_image(self) -> Float[Tensor, "H W 3"] | None:
        """sRGB latitude-longitude map of what is behind the model, before it is turned; None if nothing is."""
        if self.backdrop == BACKDROPS[0]:
            return None
        environment = self.environments[self.environment]
        if self.backdrop == BACKDROPS[1] and environment.image is not None:
            return self._display(environment.image)
        self.light()
        return self._display(photograph(self._windowed[self.environment, self.order, self.window]))

    def mirror_colours(self) -> Float[Tensor, "P 3"] | None:
        """sRGB of the vertices of mirrors as the camera sees them; None if the scene has none."""
        if self.mirrors is None:
            return None
        environment = self.environments[self.environment]
        if self._around is None or self._around[0] != self.environment:
            image = photograph(environment.light) if environment.image is None else environment.image
            self._around = self.environment, for_pixels(image.float(), MIRRORED)
        return self._display(mirror_radiance(self.mirrors, self.eye, self._around[1], self.rotation))

    def lobe(self) -> Lobe | None:
        """The transfer function of the picked vertex, as a surface on the model; None if none is picked."""
        if self.picked is None:
            return None
        coefficients = self._relight(self._stored()).transfer_of(self.picked, self.eye, self._pose()).mean(-1)
        return lobe(coefficients[: self.order**2], self._place(self.picked), LOBE * self.radius)

    def status(self) -> list[str]:
        """Lines that say what is shown."""
        shown = self._stored()
        bake = self._all[shown]
        lines = [
            f"{self.mode}: {shown}"
            + ("" if self.mode in UNBAKED else f", {bake.transport}, {count(bake.bounces, 'bounce')}"),
            f"light: {self.environments[self.environment].name}, {self.order} of {count(self.highest, 'band')}, "
            f"window {self.window}",
            f"exposure {self.stops:+.1f} stops",
        ]
        if self.mode == "error" and self.worst is not None:
            lines.append(f"error {self.worst:.2%} RMS, red is {self._most():.2%}")
        if self.mode == "sight":
            lines += sight_legend(bake.receivers)
        return lines

    # Changes

    def set_mode(self, mode: str) -> str:
        """Shows one of `MODES`; "compressed" again goes on to the next compressed bake that was given.

        Without any, the present bake is compressed here, which takes seconds.
        Raises InputError for another name.
        """
        if mode not in MODES:
            raise InputError(f"mode '{mode}' is unknown: use one of {', '.join(MODES)}")
        if mode in ("transfer", "error") and not self.bakes:
            return f"mode: {self.mode}; for {mode} give the file of the bake before it was compressed too"
        if mode == self.mode == "compressed" and self.packed is not None:
            self.packed = _after(list(self.compressed), self.packed)
        self.mode = mode
        return f"mode: {mode}, {self._stored()}" if mode == "compressed" else f"mode: {mode}"

    def next_mode(self) -> str:
        return self.set_mode(_after(MODES, self.mode))

    def change_order(self, step: int) -> str:
        """Drops or adds bands of the light."""
        self.order = max(1, min(self.highest, self.order + step))
        return f"order: {self.order}"

    def next_window(self) -> str:
        self.window = _after(WINDOWS, self.window)
        return f"window: {self.window}"

    def next_environment(self, step: int = 1) -> str:
        self.environment = (self.environment + step) % len(self.environments)
        return f"environment: {self.environments[self.environment].name}"

    def next_bake(self) -> str:
        """The next of the bakes that were given: without interreflection, with it."""
        self.bake = _after(list(self.bakes or self.compressed), self.bake)
        bake = self._all[self.bake]
        return f"bake: {self.bake}, {bake.transport}, {count(bake.bounces, 'bounce')}"

    def next_backdrop(self) -> str:
        self.backdrop = _after(BACKDROPS, self.backdrop)
        return f"behind: {self.backdrop}"

    def expose(self, stops: float | int) -> str:
        self.exposure += stops
        return f"exposure: {self.stops:+.1f} stops"

    def play(self) -> str:
        """Starts or stops the model's motion, if what is shown can follow it."""
        if not self.follows_pose:
            return "this bake stands still: give one in zonal lobes, which follows the pose"
        self.playing = not self.playing
        return f"animation: {'on' if self.playing else 'off'}"

    def advance(self, seconds: float | int) -> None:
        """Lets time pass: the model moves if it is playing; transfer that does not follow it is shown at rest."""
        if self.playing:
            self.seconds += seconds
        moved = self.seconds != 0 and self.follows_pose
        if self.playing or moved != (self.positions is not self.rest):
            self.positions = self._animation.at(self.seconds) if moved else self.rest

    def turn_camera(self, right: float | int, down: float | int) -> None:
        """As if the model's near side was dragged by these angles in radians."""
        self.orbit = self.orbit.turned(right, down)

    def turn_light(self, right: float | int, down: float | int) -> None:
        """As if the near side of the environment was dragged by these angles in radians."""
        self.rotation = dragged(self.rotation, self.camera, right, down)

    def zoom(self, steps: float | int) -> None:
        self.orbit = self.orbit.zoomed(steps)

    def reset(self) -> str:
        """Camera and light as they were in the beginning."""
        self.orbit, self.rotation = self._home, torch.eye(3)
        self.seconds, self.playing = 0.0, False
        return "camera and light as in the beginning"

    def pick(self, x: float | int, y: float | int, width: int, height: int) -> str:
        """Picks the vertex nearest to what is seen at a point of the window; none where nothing is seen."""
        if self._tracer is None or self._traced is not self.positions:
            self._tracer, self._traced = Tracer(self.positions, self.faces, few=True), self.positions
        ray = self.camera.through(torch.tensor([[x]]).double(), torch.tensor([[y]]).double(), width, height)
        hit = self._tracer.camera(self.eye, ray)
        triangle = int(hit.triangle)
        if triangle < 0 or not bool(hit.front):
            self.picked = None
            return "no vertex picked"
        u, v = float(hit.u), float(hit.v)
        corner = max(range(3), key=(1 - u - v, u, v).__getitem__)
        if self.surface_uv is None:
            self.picked = int(self.faces[triangle, corner])
        else:
            weights = torch.tensor([1 - u - v, u, v], dtype=torch.float64)
            self.picked = self._nearest(weights @ self.rest[self.faces[triangle]])
        word = "vertex" if self.surface_uv is None else "texel"
        return f"{word} {self.picked}: its transfer function, red where light adds and blue where it takes away"

    # How

    def _place(self, receiver: int) -> Tensor:
        """Where a receiver is, as it is drawn."""
        return self.positions[receiver] if self.surface_uv is None else self.receivers.positions[receiver].double()

    def _nearest(self, place: Float[Tensor, "3"]) -> int:
        """The receiver nearest to a place, among those that face the eye if any do."""
        away = (self.receivers.positions.double() - place).norm(dim=-1)
        facing = (self.normals.double() @ (self.eye - place)) > 0
        return int(torch.where(facing, away, 2 * self.radius + away).argmin())

    def _stored(self) -> str:
        """The name of the bake that is shaded in the present mode."""
        if self.mode in ("transfer", "sight", *UNBAKED):
            return self.bake
        return self.packed or self._compress(self.bake)

    def _compress(self, name: str) -> str:
        from torchprt.compression import compress

        made, bake = f"{name}, compressed here", self._all[name]
        if made not in self._all:
            receivers = list(bake.layers.values())[-1].signal.shape[0]
            self._all[made] = compress(bake, clusters=max(1, min(CLUSTERS, receivers // 16)))
        return made

    def _relight(self, name: str) -> Relight:
        if name not in self._relights:
            bake = self._all[name]
            chosen = self._brdf if "reflectance" in bake.needs else None
            self._relights[name] = Relight(shader(bake, brdf=chosen))
        return self._relights[name]

    def _shade(self, name: str, light: Tensor) -> Tensor:
        return self._relight(name)(light[: self._all[name].order ** 2], self.eye, self._pose())

    def _normals(self) -> Tensor:
        pose = self._pose()
        if pose is None:
            return self.normals
        frames = self._relight(self._stored()).shader.pose(None, pose)
        assert frames is not None
        return (frames @ self.normals[..., None].to(frames))[..., 0].float()

    def _pose(self) -> Tensor | None:
        return self.positions if self.follows_pose and self.positions is not self.rest else None

    def _make_colours(self) -> Tensor:
        if self.mode == "sight":
            return sight_colours(self._all[self.bake].receivers)
        return self._error() if self.mode == "error" else self._display(self.radiance())

    def _error(self) -> Tensor:
        """The map of what compression changes, and its RMS in `worst`."""
        light = self.light()
        wanted = self._shade(self.bake, light)
        wrong = (self._shade(self._stored(), light) - wanted).square().mean(-1).sqrt()
        scale = float(wanted.square().mean().sqrt()) or 1.0
        self.worst = float(wrong.square().mean().sqrt()) / scale
        return error_colours(wrong / scale, self._most())

    def _most(self) -> float:
        return WORST * 2.0**-self.exposure

    def _display(self, radiance: Tensor) -> Tensor:
        return display(radiance.float(), exposure=self.stops, tone=self.tone)


def _after(names: Sequence[str], name: str) -> str:
    return names[(names.index(name) + 1) % len(names)]
