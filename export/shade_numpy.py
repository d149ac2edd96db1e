"""Shades an exported scene with ONNX Runtime and numpy alone: no torch, no torchprt.

    python shade_numpy.py scene.onnx --mesh scene.ply --output turned.ply --yaw 90

A MODEL.onnx holds transfer, not faces: the mesh comes from the PLY that belongs to it (`torchprt shade -o`), whose
colours are replaced, or from an .npz with `positions [V, 3]` and `faces [F, 3]`.
"""

import argparse
import json
import sys
import time

import numpy as np
import onnxruntime

PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
COLOURS = ("red", "green", "blue")


def sh_basis(s):
    """Real orthonormal SH of order 3 with the Condon-Shortley sign at directions [..., 3]: [..., 9]."""
    x, y, z = np.moveaxis(np.asarray(s, np.float64), -1, 0)
    return np.stack(
        [
            np.full_like(x, 0.5 / np.sqrt(np.pi)),
            -np.sqrt(0.75 / np.pi) * y,
            np.sqrt(0.75 / np.pi) * z,
            -np.sqrt(0.75 / np.pi) * x,
            np.sqrt(3.75 / np.pi) * x * y,
            -np.sqrt(3.75 / np.pi) * y * z,
            np.sqrt(0.3125 / np.pi) * (3 * z * z - 1),
            -np.sqrt(3.75 / np.pi) * x * z,
            np.sqrt(0.9375 / np.pi) * (x * x - y * y),
        ],
        -1,
    )


def sky_and_sun(order, sky, sun, direction):
    """SH light [order^2, 3]: radiance `sky` from everywhere, and irradiance `sun` from `direction` in three bands."""
    light = np.zeros((max(order, 3) ** 2, 3))
    light[0] = np.asarray(sky) * np.sqrt(4 * np.pi)
    light[:9] += sh_basis(direction)[:, None] * np.asarray(sun)
    return light[: order * order]


def cube_directions(size):
    """Directions [6, size, size, 3] of the texels: faces +x -x +y -y +z -z, OpenGL orientation."""
    centres = 2 * (np.arange(size) + 0.5) / size - 1
    t, s = np.meshgrid(centres, centres, indexing="ij")
    one = np.ones_like(s)
    faces = [(one, -t, -s), (-one, -t, s), (s, one, t), (s, -one, -t), (s, -t, one), (-s, -t, -one)]
    directions = np.stack([np.stack(face, -1) for face in faces])
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def sky_and_sun_cube(size, sky, sun, direction):
    """The same as cube map [6, size, size, 3]; the sun is a cap of 15 degrees about `direction`."""
    inside = cube_directions(size) @ np.asarray(direction) > np.cos(np.radians(15))
    solid_angle = 2 * np.pi * (1 - np.cos(np.radians(15)))
    return np.asarray(sky) + inside[..., None] * np.asarray(sun) / solid_angle


def lamp_at(order, center, radius, radiance, points):
    """SH lights [S, order^2, 3] of a sphere that shines, seen from points [S, 3]: a disc, in three bands."""
    steps = np.asarray(center) - points
    distance = np.linalg.norm(steps, axis=-1, keepdims=True)
    squared = (radius / distance) ** 2
    cosine = np.sqrt(1 - squared)
    bands = np.pi * np.concatenate([2 * squared / (1 + cosine), squared, cosine * squared], -1)
    light = np.zeros((len(points), max(order, 3) ** 2, 3))
    weights = np.repeat(bands, [1, 3, 5], axis=-1) * sh_basis(steps / distance)
    light[:, :9] = weights[..., None] * np.asarray(radiance)
    return light[:, : order * order]


def lights_at_points(about, far, lamp):
    """The lights of a file with sample points, [K, order^2, 3]: one from far away, and a lamp nearby or None."""
    points = np.asarray(about["sample_points"])
    near = (lambda places: lamp_at(about["order"], lamp[:3], lamp[3], lamp[4:], places)) if lamp else None
    rows = [np.broadcast_to(far, (len(points), *far.shape)) + (near(points) if near else 0)]
    if about["gradients"]:
        # Of a point its light and how that changes along x, y and z.
        step = 1e-4 * np.ptp(points, axis=0).max()
        for axis in np.eye(3) * step:
            slope = (near(points + axis) - near(points - axis)) / (2 * step) if near else np.zeros_like(rows[0])
            rows.append(slope)
    return np.stack(rows, 1).reshape(-1, *far.shape)


def yaw_matrix(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def to_srgb(radiance, exposure=0.0):
    """8-bit sRGB of linear radiance after `exposure` stops, clipped."""
    value = np.clip(radiance * 2.0**exposure, 0, 1)
    return np.round(255 * np.where(value > 0.0031308, 1.055 * value ** (1 / 2.4) - 0.055, 12.92 * value)).astype("u1")


def read_ply(path):
    """Vertices as a structured array and everything behind them as bytes, with what the header says."""
    with open(path, "rb") as file:
        if file.readline().strip() != b"ply":
            sys.exit(f"{path} is not a PLY file")
        form, elements, lines = "", [], []
        while (line := file.readline()) and line.strip() != b"end_header":
            words = line.decode("ascii", "replace").split()
            lines.append(" ".join(words))
            if words[:1] == ["format"]:
                form = words[1]
            elif words[:1] == ["element"]:
                elements.append((words[1], int(words[2]), []))
            elif words[:1] == ["property"]:
                elements[-1][2].append(words[1:])
        if form not in ("ascii", "binary_little_endian") or not elements or elements[0][0] != "vertex":
            sys.exit(f"{path} must be an ascii or little-endian PLY that begins with its vertices")
        _, count, properties = elements[0]
        if any(kind == "list" for kind, *_ in properties):
            sys.exit(f"{path} has lists in its vertices: export it plainly")
        layout = np.dtype([(name, "<" + PLY_TYPES[kind]) for kind, name in properties])
        if form == "ascii":
            rows = [tuple(file.readline().split()) for _ in range(count)]
            vertices = np.array([row for row in rows if len(row) == len(properties)], dtype=layout)
        else:
            data = file.read(count * layout.itemsize)
            vertices = np.frombuffer(data[: len(data) // layout.itemsize * layout.itemsize], layout)
        if len(vertices) != count:
            sys.exit(f"{path} is cut short")
        return form, lines, vertices, file.read()


def write_ply(path, form, lines, vertices, rest, colours):
    """The PLY that `read_ply` read, with `colours [V, 3]` in place of its own."""
    kept = [name for name in vertices.dtype.names if name not in COLOURS]
    layout = np.dtype([(name, vertices.dtype[name]) for name in kept] + [(name, "u1") for name in COLOURS])
    coloured = np.empty(len(vertices), layout)
    for name in kept:
        coloured[name] = vertices[name]
    for channel, name in enumerate(COLOURS):
        coloured[name] = colours[:, channel]
    header, element = [], ""
    for line in [*lines, "end_header"]:
        words = line.split()
        if element == "vertex" and words[0] != "property":
            header += [f"property uchar {name}" for name in COLOURS]
        if words[0] != "property":
            element = words[1] if words[0] == "element" else element if words[0] == "comment" else ""
        if not (element == "vertex" and words[0] == "property" and words[-1] in COLOURS):
            header.append(line)
    with open(path, "wb") as file:
        file.write(("ply\n" + "\n".join(header) + "\n").encode())
        if form == "ascii":
            file.writelines((" ".join(str(value) for value in row) + "\n").encode() for row in coloured.tolist())
        else:
            file.write(coloured.tobytes())
        file.write(rest)


def read_mesh(path):
    """What `write_ply` needs, from a PLY or from an .npz with positions and faces."""
    if not path.endswith(".npz"):
        return read_ply(path)
    with np.load(path) as arrays:
        positions, faces = arrays["positions"].astype("<f4"), arrays["faces"]
    vertices = np.ascontiguousarray(positions).view([(name, "<f4") for name in "xyz"])[:, 0]
    rows = np.empty(len(faces), [("count", "u1"), ("indices", "<i4", 3)])
    rows["count"], rows["indices"] = 3, faces
    lines = ["format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {name}" for name in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    return "binary_little_endian", lines, vertices, rows.tobytes()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", help="the .onnx that `torchprt export` wrote")
    parser.add_argument("--mesh", help="its .ply, or an .npz with positions and faces")
    parser.add_argument("--output", help="the .ply to write (needs --mesh)")
    parser.add_argument("--input", help=".npy with a light [N, 3], or a cube map [6, H, W, 3], instead of sky and sun")
    parser.add_argument("--sky", type=float, nargs=3, default=(0.4, 0.5, 0.7), metavar=("R", "G", "B"))
    parser.add_argument("--sun", type=float, nargs=3, default=(2.0, 1.8, 1.5), metavar=("R", "G", "B"))
    parser.add_argument("--direction", type=float, nargs=3, default=(1.0, 1.0, 1.0), metavar=("X", "Y", "Z"))
    parser.add_argument(
        "--eye",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="for glossy surfaces: the eye, or the direction toward it if the model takes a view",
    )
    parser.add_argument("--yaw", type=float, default=0.0, help="degrees by which the environment is turned about +y")
    parser.add_argument(
        "--lamp",
        type=float,
        nargs=7,
        metavar=("X", "Y", "Z", "RADIUS", "R", "G", "B"),
        help="for a model with sample points: a sphere nearby, beside sky and sun",
    )
    parser.add_argument("--exposure", type=float, default=0.0, help="stops")
    parser.add_argument("--repeat", type=int, default=20, help="how often to shade for the timing")
    arguments = parser.parse_args()
    if bool(arguments.mesh) != bool(arguments.output):
        parser.error("--mesh and --output go together")
    length = np.linalg.norm(arguments.direction)
    if not length > 0:
        parser.error("--direction must not be zero")

    session = onnxruntime.InferenceSession(arguments.model, providers=["CPUExecutionProvider"])
    about = {key: json.loads(text) for key, text in session.get_modelmeta().custom_metadata_map.items()}
    shapes = {entry.name: entry.shape[1:] for entry in session.get_inputs()}
    direction = np.asarray(arguments.direction) / length
    values = {"rotation": yaw_matrix(arguments.yaw)}
    if arguments.input:
        values["light"] = values["environment"] = np.load(arguments.input)
    elif "light" in shapes:
        values["light"] = sky_and_sun(about["order"], arguments.sky, arguments.sun, direction)
    elif "environment" in shapes:
        values["environment"] = sky_and_sun_cube(about["size"], arguments.sky, arguments.sun, direction)
    local = "sample_points" in about and "light" in shapes
    if arguments.lamp and not local:
        sys.exit("this model has one light for all of it: leave out --lamp, or export one with --local")
    if local and not arguments.input:
        values["light"] = lights_at_points(about, values["light"], arguments.lamp)
    if arguments.input and not {"light", "environment"} & set(shapes):
        sys.exit("the light of this model is fixed: leave out --input")
    if arguments.eye and not {"eye", "view"} & set(shapes):
        sys.exit("this model shows the same to every eye: leave out --eye")
    if arguments.eye:
        values["eye"] = values["view"] = np.asarray(arguments.eye)
    elif {"eye", "view"} & set(shapes):
        sys.exit("what the model shows depends on the eye: give --eye X Y Z")
    for name, shape in shapes.items():
        if list(values[name].shape) != shape:
            sys.exit(f"the model takes a {name} of shape {shape}, not {list(values[name].shape)}")
    feed = {name: values[name][None].astype("f4") for name in shapes}

    radiance = session.run(["radiance"], feed)[0][0]
    start = time.perf_counter()
    for _ in range(arguments.repeat):
        session.run(["radiance"], feed)
    milliseconds = 1e3 * (time.perf_counter() - start) / max(arguments.repeat, 1)
    print(f"{about['kind']} transfer, order {about['order']}, {len(radiance)} vertices: {milliseconds:.3f} ms a light")
    print("mean radiance", *(f"{value:.6g}" for value in radiance.mean(0)))

    if arguments.output:
        form, lines, vertices, rest = read_mesh(arguments.mesh)
        if len(vertices) != len(radiance):
            sys.exit(f"{arguments.mesh} has {len(vertices)} vertices but the model shades {len(radiance)}")
        write_ply(arguments.output, form, lines, vertices, rest, to_srgb(radiance, arguments.exposure))
        print("wrote", arguments.output)


if __name__ == "__main__":
    main()
