"""What the window draws, as geometries of Open3D, each sent again only when something changed that it depends on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.preview.camera import Camera
from torchprt.preview.lobe import sphere
from torchprt.preview.panel import panel
from torchprt.preview.picture import reverse_corners
from torchprt.preview.session import Session

RINGS = 48
LEFT_TOP = 12
"""Pixels between the panel and the edges of the window."""


class Drawing:
    """The model, its black reverse, mirrors beside it, the environment behind, a lobe and a panel of text.

    `open3d`: the module; `viewer`: its visualiser, which is told what to draw. `size` of the window in pixels.
    """

    def __init__(self, open3d: Any, viewer: Any, session: Session):
        self.open3d = open3d
        self.viewer = viewer
        self.session = session
        self._keys: dict[str, object] = {}
        self._drawn: dict[str, Any] = {}
        self._colours: Tensor | None = None
        self._positions = session.positions
        uv = session.surface_uv
        if uv is None:
            self.model = self._mesh(session.positions, session.faces)
        else:
            self.model = self._mapped(session.positions, session.faces, uv.flatten(0, 1))
        viewer.add_geometry(self.model)
        single = reverse_faces(session.rest, session.faces) if session.has_reverse else session.faces[:0]
        self._reverse = self._mesh(session.positions, single) if len(single) else None
        if self._reverse is not None:
            self._reverse.paint_uniform_color([0.0, 0.0, 0.0])
            viewer.add_geometry(self._reverse, reset_bounding_box=False)
        self._mirrors: Any = None
        if session.mirrors is not None:
            self._mirrors = self._mesh(session.mirrors[0], session.mirrors[3])
            viewer.add_geometry(self._mirrors)
        self._directions, faces = sphere(RINGS)
        inward = faces.flip(1)
        steps = torch.arange(len(self._directions))
        across, down = steps % (2 * RINGS + 1) / (2 * RINGS), steps // (2 * RINGS + 1) / RINGS
        self._sky = self._textured(self._directions, inward, torch.stack([across, down], -1))
        corners = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        self._panel_faces = torch.tensor([[0, 3, 2], [0, 2, 1]])
        self._panel = self._textured(torch.zeros(4, 3), self._panel_faces, corners)

    def update(self, size: tuple[int, int], lines: Sequence[str]) -> bool:
        """Draws what the session shows now, with `lines` on the panel; whether anything had changed."""
        camera = self.session.camera
        near, far = self._clipping(camera)
        changed = [
            self._changed("camera", (camera, size)) and self._look(camera, size, near, far),
            self._shade(),
            self._reflect(camera),
            self._behind(camera, far),
            self._function(),
            self._write(camera, size, near, tuple(lines)),
        ]
        return any(changed)

    def _shade(self) -> bool:
        colours, positions = self.session.colours(), self.session.positions
        if colours is self._colours and positions is self._positions:
            return False
        if positions is not self._positions:
            self.model.vertices = self._vectors(positions)
            if self._reverse is not None:
                self._reverse.vertices = self.model.vertices
                self.viewer.update_geometry(self._reverse)
        self._colours, self._positions = colours, positions
        self.send(colours)
        return True

    def send(self, colours: Float[Tensor, "V 3"]) -> None:
        """Hands sRGB colours of the receivers to Open3D, which draws them with the next frame."""
        if self.session.surface_uv is None:
            self.model.vertex_colors = self._vectors(colours)
        else:
            # Of texels, with the gutters that a filter reads at seams.
            image = (self.session.map(colours.float()).clamp(0, 1) * 255).round()
            self.model.textures = [self._image(image.to(torch.uint8))]
        self.viewer.update_geometry(self.model)

    def _reflect(self, camera: Camera) -> bool:
        session = self.session
        key = (camera, session.environment, session.stops, tuple(session.rotation.flatten().tolist()))
        if self._mirrors is None or not self._changed("mirrors", key):
            return False
        colours = session.mirror_colours()
        assert colours is not None
        self._mirrors.vertex_colors = self._vectors(colours)
        self.viewer.update_geometry(self._mirrors)
        return True

    def _look(self, camera: Camera, size: tuple[int, int], near: float, far: float) -> bool:
        width, height = size
        forward, right, above = camera.axes()
        rows = torch.stack([right, -above, forward])
        extrinsic = torch.eye(4, dtype=torch.float64)
        extrinsic[:3, :3] = rows
        extrinsic[:3, 3] = -rows @ torch.tensor(camera.eye, dtype=torch.float64)
        focal = height / (2 * math.tan(math.radians(camera.field) / 2))
        parameters = self.open3d.camera.PinholeCameraParameters()
        parameters.intrinsic = self.open3d.camera.PinholeCameraIntrinsic(
            width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5
        )
        parameters.extrinsic = extrinsic.numpy()
        control = self.viewer.get_view_control()
        control.set_constant_z_near(near)
        control.set_constant_z_far(far)
        control.convert_from_pinhole_camera_parameters(parameters, True)
        return True

    def _behind(self, camera: Camera, far: float) -> bool:
        session = self.session
        picture = (session.backdrop, session.environment, session.order, session.window, session.stops)
        turn = tuple(session.rotation.flatten().tolist())
        if not self._changed("sky", (picture, turn, camera) if session.backdrop != "plain" else None):
            return False
        image = session.backdrop_image() if self._changed("picture", picture) else None
        if session.backdrop == "plain":
            return self._put("sky", None)
        if image is not None:
            self._sky.textures = [self._image((image * 255).round().to(torch.uint8))]
        turned = self._directions @ session.rotation.double().T
        self._sky.vertices = self._vectors(torch.tensor(camera.eye).double() + 0.9 * far * turned)
        return self._put("sky", self._sky)

    def _function(self) -> bool:
        """The lobe of the picked vertex."""
        session = self.session
        key = (
            session.picked,
            session.mode,
            session.bake,
            session.order,
            session.orbit if session.follows_eye else None,
        )
        if not self._changed("lobe", key if session.picked is not None else None):
            return False
        found = session.lobe()
        if found is None:
            return self._put("lobe", None)
        mesh = self._mesh(found.positions, found.faces)
        mesh.vertex_colors = self._vectors(found.colours)
        self._put("lobe", None)
        return self._put("lobe", mesh)

    def _write(self, camera: Camera, size: tuple[int, int], near: float, lines: tuple[str, ...]) -> bool:
        if not self._changed("panel", (camera, size, lines)):
            return False
        if not lines:
            return self._put("panel", None)
        picture = panel(lines)
        self._panel.textures = [self._image(picture)]
        # One pixel of the picture is one of the window, on a plane just behind the nearest that is drawn.
        height, width = picture.shape[:2]
        x = torch.tensor([0.0, width, width, 0.0]).double() + LEFT_TOP
        y = torch.tensor([0.0, 0.0, height, height]).double() + LEFT_TOP
        rays = camera.through(x, y, *size)
        self._panel.vertices = self._vectors(torch.tensor(camera.eye).double() + 1.02 * near * rays)
        return self._put("panel", self._panel)

    def _clipping(self, camera: Camera) -> tuple[float, float]:
        """Distances of the nearest and the farthest that is drawn; the environment is at 0.9 of the farthest."""
        distance = math.dist(camera.eye, camera.target)
        reach = 2 * self.session.radius
        return max(distance - reach, 0.01 * distance), 2 * (distance + reach)

    def _changed(self, name: str, key: object) -> bool:
        if name in self._keys and self._keys[name] == key:
            return False
        self._keys[name] = key
        return True

    def _put(self, name: str, geometry: Any | None) -> bool:
        """Draws `geometry` under this name, or nothing; whether something else was drawn before."""
        before = self._drawn.get(name)
        self._drawn[name] = geometry
        if geometry is not None and geometry is before:
            self.viewer.update_geometry(geometry)
        elif geometry is not None:
            self.viewer.add_geometry(geometry, reset_bounding_box=False)
        elif before is not None:
            self.viewer.remove_geometry(before, reset_bounding_box=False)
        return geometry is not None or before is not None

    def _vectors(self, values: Tensor) -> Any:
        return self.open3d.utility.Vector3dVector(np.ascontiguousarray(values.double().numpy()))

    def _image(self, values: Tensor) -> Any:
        return self.open3d.geometry.Image(np.ascontiguousarray(values.numpy()))

    def _mesh(self, positions: Tensor, faces: Tensor) -> Any:
        # Without normals Open3D shows the colours as they are.
        indices = self.open3d.utility.Vector3iVector(np.ascontiguousarray(faces.int().numpy()))
        return self.open3d.geometry.TriangleMesh(self._vectors(positions), indices)

    def _textured(self, positions: Tensor, faces: Tensor, places: Tensor) -> Any:
        return self._mapped(positions, faces, places[faces.flatten()])

    def _mapped(self, positions: Tensor, faces: Tensor, places: Float[Tensor, "corners 2"]) -> Any:
        """A mesh with places of the three corners of each face on a picture."""
        mesh = self._mesh(positions, faces)
        corners = np.ascontiguousarray(places.double().numpy())
        mesh.triangle_uvs = self.open3d.utility.Vector2dVector(corners)
        mesh.triangle_material_ids = self.open3d.utility.IntVector(np.zeros(len(faces), np.int32))
        return mesh


def reverse_faces(positions: Tensor, faces: Tensor) -> Tensor:
    """The reverse sides of those faces whose reverse is no face of the model: they reflect nothing."""
    return faces[reverse_corners(positions, faces)[:, 0] < 0].flip(1)
