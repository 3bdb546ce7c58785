"""Pictures of a window as a pinhole camera would see it: painted ground and boxes, by OpenGL.

Draws without a screen, through EGL (Debian: libegl1, libgl1-mesa-dri). Logs have no
houses, trees or weather, so simulated pictures are no photographs.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import moderngl
import numpy as np
from numpy.typing import NDArray

from anchorflow_client.errors import AnchorFlowError
from anchorflow_driving.geometry import Array
from anchorflow_driving.log import VEHICLE
from anchorflow_driving.road import Road
from anchorflow_driving.sensors.agents import Solids, solids
from anchorflow_driving.sensors.ground import GroundPicture, paint_ground
from anchorflow_driving.sensors.pinhole import PinholeCamera
from anchorflow_driving.window import PlannerView

REACH = 150.0
"""m from the ego, up to which the others are drawn."""
BACKEND: dict[str, Any] = {"backend": "egl"}
NEAR, FAR = 0.2, 400.0
SKY = (0.62, 0.72, 0.84)
CABIN = (0.72, 0.92, 0.55, 0.62)
"""A cabin's shares of its vehicle's length, width and height, and the share at which it begins."""
COLOURS = np.array(
    [
        [0.80, 0.80, 0.82],
        [0.16, 0.17, 0.19],
        [0.55, 0.57, 0.60],
        [0.60, 0.10, 0.10],
        [0.12, 0.22, 0.45],
        [0.93, 0.93, 0.93],
        [0.35, 0.30, 0.25],
    ]
)
KIND_COLOURS = {1: (0.85, 0.55, 0.20), 2: (0.20, 0.60, 0.30), 3: (0.95, 0.45, 0.05)}

_GROUND = (
    """
#version 330
uniform mat4 camera;
in vec2 corner;
out vec2 place;
void main() { place = corner; gl_Position = camera * vec4(corner, 0.0, 1.0); }
""",
    """
#version 330
uniform sampler2D picture;
uniform vec3 pose;
uniform vec2 low;
uniform vec2 size;
uniform vec3 sky;
in vec2 place;
out vec4 colour;
void main() {
    float c = cos(pose.z), s = sin(pose.z);
    vec2 there = pose.xy + vec2(c * place.x - s * place.y, s * place.x + c * place.y);
    vec3 ground = texture(picture, (there - low) / size).rgb;
    float haze = 1.0 - exp(-length(place) / 160.0);
    colour = vec4(mix(ground, sky, haze), 1.0);
}
""",
)
_BOXES = (
    """
#version 330
uniform mat4 camera;
in vec3 corner;
in vec3 normal;
in vec3 pose;
in vec3 size;
in float bottom;
in vec3 paint;
out vec3 lit;
out float away;
void main() {
    float c = cos(pose.z), s = sin(pose.z);
    mat2 turn = mat2(c, s, -s, c);
    vec2 flat_place = pose.xy + turn * (corner.xy * size.xy);
    vec3 facing = vec3(turn * normal.xy, normal.z);
    float light = 0.55 + 0.45 * max(0.0, dot(facing, normalize(vec3(0.4, 0.3, 0.85))));
    lit = paint * light;
    away = length(flat_place);
    gl_Position = camera * vec4(flat_place, bottom + corner.z * size.z, 1.0);
}
""",
    """
#version 330
uniform vec3 sky;
in vec3 lit;
in float away;
out vec4 colour;
void main() { colour = vec4(mix(lit, sky, 1.0 - exp(-away / 160.0)), 1.0); }
""",
)


class RenderingUnavailable(AnchorFlowError):
    """No OpenGL context could be made here."""


class Renderer:
    """Draws windows; keeps the ground of each road that it has drawn, as long as the road is there.

    Raises `RenderingUnavailable` if there is no EGL here.
    """

    def __init__(self) -> None:
        try:
            self._gl = moderngl.create_context(standalone=True, **BACKEND)
        except Exception as error:
            told = f"no OpenGL context through EGL ({error}); Debian has libegl1, libgl1-mesa-dri"
            raise RenderingUnavailable(told) from error
        gl = self._gl
        gl.gc_mode = "context_gc"  # what Python has forgotten is released in `draw`
        gl.enable(moderngl.DEPTH_TEST)
        self._ground = gl.program(vertex_shader=_GROUND[0], fragment_shader=_GROUND[1])
        self._boxes = gl.program(vertex_shader=_BOXES[0], fragment_shader=_BOXES[1])
        corners = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]], np.float32) * (FAR / 2)
        self._floor = gl.vertex_array(self._ground, gl.buffer(corners.tobytes()), "corner")
        self._cube = gl.buffer(_cube().tobytes())
        self._pictures: WeakKeyDictionary[Road, tuple[moderngl.Texture, GroundPicture]] = (
            WeakKeyDictionary()
        )
        self._targets: dict[tuple[int, int], moderngl.Framebuffer] = {}

    def draw(
        self, view: PlannerView, camera: PinholeCamera, *, with_ego: bool = False
    ) -> NDArray[np.uint8]:
        """The camera's picture [rows, columns, 3], red first."""
        with self._gl:  # another context of the process may be the current one
            self._gl.gc()
            target = self._target(camera.rows, camera.columns)
            target.use()
            target.clear(*SKY, 1.0, depth=1.0)
            matrix = _floats(camera.matrix(NEAR, FAR).T)
            self._draw_ground(view, matrix)
            self._draw_boxes(solids(view, reach=REACH, with_ego=with_ego), matrix)
            pixels = np.frombuffer(target.read(components=3, alignment=1), np.uint8)
        return pixels.reshape(camera.rows, camera.columns, 3)[::-1].copy()

    def _draw_ground(self, view: PlannerView, matrix: bytes) -> None:
        if view.road not in self._pictures:
            ground = paint_ground(view)
            rows, columns = ground.pixels.shape[:2]
            texture = self._gl.texture((columns, rows), 3, ground.pixels.tobytes(), alignment=1)
            texture.repeat_x = texture.repeat_y = False
            texture.build_mipmaps()
            texture.filter = moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR
            self._pictures[view.road] = texture, ground
        texture, ground = self._pictures[view.road]
        texture.use(0)
        _set(self._ground, "camera", matrix)
        _set(self._ground, "pose", _floats(view.state.pose))
        _set(self._ground, "low", _floats(ground.low))
        _set(self._ground, "size", _floats(ground.size))
        _set(self._ground, "sky", _floats(np.array(SKY)))
        self._floor.render(moderngl.TRIANGLE_STRIP)

    def _draw_boxes(self, others: Solids, matrix: bytes) -> None:
        boxes = _painted(others)
        if not len(boxes):
            return
        instances = self._gl.buffer(boxes.tobytes())
        array = self._gl.vertex_array(
            self._boxes,
            [
                (self._cube, "3f 3f", "corner", "normal"),
                (instances, "3f 3f 1f 3f/i", "pose", "size", "bottom", "paint"),
            ],
        )
        _set(self._boxes, "camera", matrix)
        _set(self._boxes, "sky", _floats(np.array(SKY)))
        array.render(moderngl.TRIANGLES, instances=len(boxes))

    def _target(self, rows: int, columns: int) -> moderngl.Framebuffer:
        size = columns, rows
        if size not in self._targets:
            gl = self._gl
            colours, depth = gl.renderbuffer(size, 3), gl.depth_renderbuffer(size)
            self._targets[size] = gl.framebuffer(colours, depth)
        return self._targets[size]


def _set(program: moderngl.Program, name: str, value: bytes) -> None:
    uniform = program[name]
    assert isinstance(uniform, moderngl.Uniform)
    uniform.write(value)


def _floats(values: Array) -> bytes:
    return values.astype(np.float32).tobytes()


def _painted(others: Solids) -> NDArray[np.float32]:
    """[M, 10] pose, size, bottom, colour of boxes: a vehicle's body and its cabin."""
    rows = []
    for pose, size, kind, track in zip(
        others.poses, others.size, others.kind.tolist(), others.track.tolist(), strict=True
    ):
        paint = COLOURS[track % len(COLOURS)] if kind == VEHICLE else np.array(KIND_COLOURS[kind])
        if kind != VEHICLE:
            rows.append([*pose, *size, 0.0, *paint])
            continue
        length, width, height, bottom = CABIN * size[[0, 1, 2, 2]]
        rows.append([*pose, size[0], size[1], bottom - 0.25, 0.25, *paint])
        rows.append([*pose, length, width, height - 0.17 * size[2], bottom, *(0.35 * paint)])
    return np.array(rows, np.float32).reshape(-1, 10)


def _cube() -> NDArray[np.float32]:
    """[36, 6] corners (x, y from -0.5 to 0.5, z from 0 to 1) and normals, of twelve triangles."""
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            square = np.array([[-1, -1], [1, -1], [1, 1], [-1, -1], [1, 1], [-1, 1]]) / 2
            corners = np.insert(square, axis, sign / 2, axis=1)
            corners[:, 2] += 0.5
            normal = np.zeros(3)
            normal[axis] = sign
            faces.append(np.column_stack([corners, np.tile(normal, (6, 1))]))
    return np.concatenate(faces).astype(np.float32)
