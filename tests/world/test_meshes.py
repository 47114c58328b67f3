"""The shipped vessel shapes, and reading the user's own."""

import base64
import io
import itertools
import json
import os
import runpy
import struct
import subprocess
import sys
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import trimesh
import yaml

from modsim3d.core.errors import InputError
from modsim3d.world.mesh_glb import glb_parts, joined, read_glb
from modsim3d.world.mesh_limits import MAX_FACES, MAX_VERTICES, leads_outside, read_obj
from modsim3d.world.mesh_reading import Axis, load_mesh, shipped_meshes
from modsim3d.world.vessels import Solid, axis, is_closed, shoebox, signed_volume, vehicle_R_file

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("container_ship", "ferry", "fishing_vessel", "kayak", "motorboat", "sailboat")


def triangles(solid: Solid, digits: int = 5) -> set[tuple[tuple[float, ...], ...]]:
    """The triangles of a solid, whatever the order of its vertices and faces; each begins at its least corner."""
    corners = np.round(solid.vertices[solid.faces], digits) + 0.0
    turned = (tuple(map(tuple, face)) for face in corners.tolist())
    return {face[k:] + face[:k] for face in turned for k in [face.index(min(face))]}


def problem(entry: object, folder: Path) -> str:
    """The one problem that an entry has, without its path."""
    with pytest.raises(InputError) as raised:
        load_mesh(entry, folder, "scene.yaml", "vessels", "boat", "mesh")
    (line,) = raised.value.problems
    assert raised.value.source == "scene.yaml"
    assert line.startswith("vessels.boat.mesh")
    return line.removeprefix("vessels.boat.mesh")


def glb(description: dict[str, object], data: bytes = b"", size: int | None = None) -> bytes:
    text = json.dumps(description).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if data:
        chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, size or 12 + len(chunks)) + chunks


def wedge_description() -> tuple[dict[str, object], bytes]:
    """A tetrahedron with its bow at +z and its top at +y, in glTF's axes, and its data."""
    positions = np.array([(-1, 0, -1), (1, 0, -1), (0, 0, 3), (0, 2, -1)], dtype="<f4")
    indices = np.array([(0, 1, 2), (0, 3, 1), (1, 3, 2), (0, 2, 3)], dtype="<u2")
    data = positions.tobytes() + indices.tobytes()
    description = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-1, 0, -1], "max": [1, 2, 3]},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
        "buffers": [{"byteLength": len(data)}],
    }
    return description, data


def by_trimesh(content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of all parts of a GLB file, as trimesh reads them; parts that mirror are not reversed."""
    scene = trimesh.load_scene(io.BytesIO(content), file_type="glb", skip_materials=True, process=False)
    vertices, faces = [], []
    for name in scene.graph.nodes_geometry:
        transform, geometry = scene.graph[name]
        if isinstance(part := scene.geometry[geometry], trimesh.Trimesh):  # lines and points are other objects
            faces.append(part.faces + sum(map(len, vertices)))
            vertices.append(trimesh.transform_points(part.vertices, transform))
    return np.concatenate(vertices), np.concatenate(faces)


def assert_read_as_by_trimesh(content: bytes) -> None:
    found = joined(glb_parts(read_glb(io.BytesIO(content), len(content))))
    for got, want in zip(found, by_trimesh(content), strict=True):
        np.testing.assert_array_equal(got, want)


def test_the_shipped_meshes_are_those_of_the_table_and_of_the_script_to_the_byte(tmp_path):
    table = yaml.safe_load((ROOT / "meshes" / "meshes.yaml").read_text())
    assert sorted(table) == sorted(shipped_meshes()) == sorted(NAMES)
    assert all(table[name]["faces"] == len(load_mesh(name, ROOT).faces) for name in NAMES)
    runpy.run_path(str(ROOT / "script" / "make_meshes"))["main"](tmp_path)
    for written in sorted(tmp_path.iterdir()):
        assert written.read_bytes() == (ROOT / "meshes" / written.name).read_bytes(), written.name
    assert len(list(tmp_path.iterdir())) == len(NAMES) + 1


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_mesh_is_a_solid_that_fills_the_unit_box_and_is_read_as_by_trimesh(name: str) -> None:
    solid = load_mesh(name, ROOT)
    bounds = [solid.vertices.min(axis=0), solid.vertices.max(axis=0)]
    assert np.array_equal(bounds, [[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]])
    assert solid.closed and not solid.convex and 60 <= len(solid.faces) <= 400
    witness = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    assert witness.is_watertight and witness.is_winding_consistent and witness.body_count == 1
    assert 0.02 < witness.volume < 0.6
    assert_read_as_by_trimesh(shipped_meshes()[name].read_bytes())
    seen = trimesh.load_scene(shipped_meshes()[name]).to_mesh()  # as in any viewer, with y up
    assert np.allclose(seen.bounds, [[-0.5, 0.0, -0.5], [0.5, 1.0, 0.5]]) and np.allclose(seen.volume, witness.volume)


@pytest.mark.parametrize("name", NAMES)
def test_every_ray_enters_a_shipped_mesh_through_a_front_face_and_leaves_it_again(name: str) -> None:
    """Signed crossings of parallel rays, nearest first, against each face: in, out, in, out."""
    solid = load_mesh(name, ROOT)
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    a, b, c = np.moveaxis((solid.vertices @ turn.T)[solid.faces], 1, 0)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    rays = rng.uniform(-0.6, 0.6, size=(2000, 2)) + (turn @ [0.0, 0.0, 0.4])[:2]
    hits = 0
    for x, y in rays:
        u = ((b[:, 0] - x) * (c[:, 1] - y) - (c[:, 0] - x) * (b[:, 1] - y)) / area
        v = ((c[:, 0] - x) * (a[:, 1] - y) - (a[:, 0] - x) * (c[:, 1] - y)) / area
        met = (u > 0) & (v > 0) & (u + v < 1)
        height = (u * a[:, 2] + v * b[:, 2] + (1 - u - v) * c[:, 2])[met]
        signs = np.sign(area[met])[np.argsort(-height)]  # from above: counter-clockwise faces are front faces
        assert np.array_equal(signs, np.resize([1, -1], len(signs))) and len(signs) % 2 == 0
        hits += bool(len(signs))
    assert hits > 100


def test_the_shape_is_the_same_through_every_format_and_in_other_axes(tmp_path: Path) -> None:
    want = load_mesh("motorboat", ROOT)
    mesh = trimesh.Trimesh(want.vertices * [8.5, 2.8, 2.6] + [100, -20, 3], want.faces, process=False)
    for ending in ("obj", "stl", "ply", "glb"):
        mesh.export(tmp_path / f"boat.{ending}")
    mesh.export(tmp_path / "text.stl", file_type="stl_ascii")
    mesh.export(tmp_path / "text.ply", encoding="ascii")
    axes = dict.fromkeys(sorted(path.name for path in tmp_path.iterdir()), ("+x", "+z"))
    for forward, up in (("-x", "+z"), ("+y", "-z"), ("+z", "+y")):
        in_file = want.vertices @ vehicle_R_file(forward, up)  # the transpose undoes a rotation
        trimesh.Trimesh(in_file, want.faces, process=False).export(tmp_path / f"{forward}{up}.ply")
        axes[f"{forward}{up}.ply"] = forward, up
    for file, (forward, up) in axes.items():
        got = load_mesh({"file": file, "forward": forward, "up": up}, tmp_path)
        assert triangles(got, 4) == triangles(want, 4), file
        assert got.closed and len(got.vertices) == len(want.vertices), file


def test_axes_map_the_file_to_forward_port_up_where_a_shipped_mesh_has_its_bow_and_mast():
    for forward, up in itertools.product(get_args(Axis), repeat=2):
        if forward[1] != up[1]:
            rotation = vehicle_R_file(forward, up)
            assert np.allclose(rotation @ np.transpose([axis(forward), axis(up)]), [[1, 0], [0, 0], [0, 1]])
            assert np.isclose(np.linalg.det(rotation), 1.0)
    ferry = load_mesh("ferry", ROOT).vertices
    bow, stern = ferry[ferry[:, 0] > 0.49], ferry[ferry[:, 0] < -0.49]
    assert np.ptp(bow[:, 1]) < 0.2 < np.ptp(stern[:, 1])
    sails = load_mesh("sailboat", ROOT).vertices
    assert np.abs(sails[sails[:, 2] > 0.9, 1]).max() < 0.2


def test_glb_is_read_in_gltf_axes_unless_told_otherwise_and_nodes_placed_by_their_transforms(tmp_path):
    (tmp_path / "wedge.glb").write_bytes(glb(*wedge_description()))
    solid = load_mesh("wedge.glb", tmp_path)
    bow, _, top = solid.vertices[solid.vertices.argmax(axis=0)].tolist()
    assert (bow, top) == ([0.5, 0.0, 0.0], [-0.5, 0.0, 1.0]) and solid.closed and solid.convex
    turned = load_mesh({"file": "wedge.glb", "forward": "-z"}, tmp_path)
    assert turned.vertices[np.argmax(turned.vertices[:, 2])].tolist() == [0.5, 0.0, 1.0]
    description, data = wedge_description()
    description["nodes"] = [
        {"children": [1, 2], "translation": [0, 0, 5]},
        {"mesh": 0, "scale": [-1, 1, 1], "translation": [3, 0, 0]},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -3, 0, 0, 1]},
    ]
    (tmp_path / "two.glb").write_bytes(glb(description, data))
    solid = load_mesh("two.glb", tmp_path)
    assert len(solid.faces) == 8 and solid.closed and not solid.convex
    # Each wedge has a sixth of its box, which is a quarter of the whole one's breadth (2 of 8).
    assert signed_volume(solid.vertices, solid.faces) == pytest.approx(2 * 0.25 / 6)


def test_parts_have_the_order_and_the_place_that_trimesh_gives_them() -> None:
    description, data = wedge_description()
    one = description["meshes"][0]["primitives"][0]
    description["meshes"] = [{"primitives": [{**one, "mode": mode}]} for mode in (4, 5, 1)]
    description["meshes"].append({"primitives": [{"attributes": {"POSITION": 2}}]})
    strided = {"bufferView": 2, "byteOffset": 4, "componentType": 5122, "count": 3, "type": "VEC3"}
    description["accessors"].append(strided)
    description["bufferViews"].append({"buffer": 1, "byteLength": 40, "byteStride": 10})
    numbers = base64.b64encode(np.arange(20, dtype="<i2").tobytes()).decode()
    description["buffers"].append({"byteLength": 40, "uri": f"data:application/octet-stream;base64,{numbers}"})
    description["scenes"] = [{"nodes": [7, 0]}]
    description["nodes"] = [
        {"children": [1, 2, 3], "translation": [0.1, 0.2, 5.3], "rotation": [0.1, -0.4, 0.2, 0.7]},
        {"mesh": 0, "scale": [1.1, 1.3, 0.7], "rotation": [0.0, 0.6, 0.0, 0.8], "children": [4, 5]},
        {"mesh": 1, "rotation": [0.0, 0.0, 0.0, 0.0]},
        {"mesh": 2},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 0.8, 0.6, 0, 0, -0.6, 0.8, 0, -3, 0.3, 0.1, 1]},
        {"children": [6], "scale": [3, 1, 2]},
        {"mesh": 3, "translation": [1, 2, 3]},
        {"mesh": 3, "scale": [2, 2, 2]},
    ]
    assert_read_as_by_trimesh(glb(description, data))


def test_every_primitive_is_read_with_the_bits_of_trimesh_s_transforms(tmp_path):
    """Trimesh loses primitives of one mesh whose random names coincide, of 12 000 a dozen."""
    description, data = wedge_description()
    description["meshes"][0]["primitives"] *= 100
    description["nodes"][0]["scale"] = [2, 1, 1]
    (tmp_path / "parts.glb").write_bytes(glb(description, data))
    got = load_mesh("parts.glb", tmp_path)
    assert len(got.faces) == 400 and len(got.vertices) == 4
    description, data = wedge_description()
    rng = np.random.default_rng(0)
    sizes = {"rotation": 4, "translation": 3, "scale": 3}
    some = [{name: rng.uniform(0.1, 2, size).tolist() for name, size in sizes.items()} for _ in range(300)]
    # Each chain has three nodes, and the last two show the mesh.
    description["nodes"] = [
        {**node, **({"mesh": 0} if number % 3 else {}), **({"children": [number + 1]} if number % 3 < 2 else {})}
        for number, node in enumerate(some)
    ]
    description["scenes"] = [{"nodes": list(range(0, 300, 3))}]
    assert_read_as_by_trimesh(glb(description, data))


def test_an_inside_out_mesh_is_turned_faces_are_split_and_a_hole_or_mixed_winding_is_open(tmp_path: Path) -> None:
    box, mixed = shoebox(), shoebox().faces.copy()
    mixed[3] = mixed[3, ::-1]
    for file, faces in (("out.stl", box.faces[:, ::-1]), ("hole.ply", box.faces[1:]), ("mixed.ply", mixed)):
        trimesh.Trimesh(box.vertices, faces, process=False).export(tmp_path / file)
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [*(f"v {row}" for row in BOX_ROWS), *(f"f {a} {b} {c} {d}" for a, b, c, d in quads)]
    (tmp_path / "quads.obj").write_text("\n".join(lines))
    assert box.closed and box.convex and is_closed(box.faces)
    for file, closed in (("out.stl", True), ("quads.obj", True), ("hole.ply", False), ("mixed.ply", False)):
        solid = load_mesh(file, tmp_path)
        assert solid.closed == solid.convex == closed, file
        if closed:
            assert signed_volume(solid.vertices, solid.faces) == pytest.approx(1.0)
            assert (len(solid.vertices), len(solid.faces)) == (8, 12)


def as_programs_write_it() -> dict[str, bytes]:
    """Files of the shoebox with what programs add to it, and that changes nothing."""
    vertices, faces = shoebox().vertices.tolist(), shoebox().faces.tolist()
    box = trimesh.Trimesh(vertices, faces, process=False)
    rows = [f"v {row}" for row in BOX_ROWS]
    backwards = [f"f {a - 8}/1/1 {b - 8}//2 \\\n {c - 8}/3" for a, b, c in faces]
    flat = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in [*faces, (0, 0, 1)]]
    return {
        "a degenerate face and an unused point.obj": "\n".join([*rows, "v 50 50 50", *flat, ""]).encode(),
        "an unused point.ply": ply([*BOX_ROWS, "50 50 50"], header=PLY_FACES.replace("vertex 8", "vertex 9")),
        "blank lines and a tail.ply": ply([*BOX_ROWS[:3], "", "  ", *BOX_ROWS[3:]]) + b"\nthe end\n" * 9,
        "corners that count back.obj": "\n".join([*rows, "vt 0 0", "vn 0 0 1", *backwards, ""]).encode(),
        "indented.obj": obj().replace(b"f ", b"  f\t").replace(b"v ", b"\tv\t"),
        "no UTF-8.stl": box.export(file_type="stl_ascii").encode().replace(b"solid ", b"solid Fj\xf8rd ", 1),
        "no UTF-8.obj": b"# B\xe5t\n" + obj(),
        "no UTF-8.ply": ply(BOX_ROWS).replace(b"1.0\n", b"1.0\ncomment B\xe5t\n", 1),
        "no UTF-8, binary.ply": box.export(file_type="ply").replace(b"1.0\n", b"1.0\ncomment B\xe5t\n", 1),
    }


def test_what_programs_add_to_a_mesh_changes_nothing_and_only_as_many_faces_as_allowed_are_read(tmp_path):
    for file, content in as_programs_write_it().items():
        (tmp_path / file).write_bytes(content)
        assert triangles(load_mesh(file, tmp_path)) == triangles(shoebox()), file
    for name, (content, size, said) in many_faces().items():
        with (tmp_path / name).open("wb") as file:
            file.write(content)
            file.truncate(size)
        assert said in problem(name, tmp_path)
        (tmp_path / name).unlink()
    corners = np.random.default_rng(0).uniform(size=(MAX_FACES + 1, 3, 3))
    soup = np.arange(3 * MAX_FACES + 3).reshape(-1, 3)
    trimesh.Trimesh(corners.reshape(-1, 3), soup, process=False).export(tmp_path / "more.stl")
    trimesh.Trimesh(corners[:-1].reshape(-1, 3), soup[:-1], process=False).export(tmp_path / "most.stl")
    assert len(load_mesh("most.stl", tmp_path).faces) == MAX_FACES
    assert f"has {MAX_FACES + 1} faces" in problem("more.stl", tmp_path)


FIVE_MILLION = 5_000_000
PLY_HEADER = f"ply\nformat binary_little_endian 1.0\nelement vertex 9\nelement face {FIVE_MILLION}\nend_header\n"


def many_faces() -> dict[str, tuple[bytes, int, str]]:
    """Name of a file → how it begins, how long it is, sparse so that it takes no room, and what is said of it."""
    description, data = wedge_description()
    description["accessors"][1]["count"] = 3 * FIVE_MILLION
    big = glb(description, data)
    description["accessors"][1]["count"] = 3000
    often = glb({**description, "nodes": [{"mesh": 0}] * 100, "scenes": [{"nodes": list(range(100))}]}, data)
    stl = b"\0" * 80 + struct.pack("<I", FIVE_MILLION)
    most = f": 'big.stl' has 5000000 faces; a mesh may have at most {MAX_FACES}: simplify it"
    return {
        "big.stl": (stl, 84 + 50 * FIVE_MILLION, most),
        "big.ply": (PLY_HEADER.encode(), 13 * FIVE_MILLION, "has 5000000 faces"),
        "big.glb": (big, len(big), "has 5000000 faces"),
        "shown often.glb": (often, len(often), "has 100000 faces"),
        "big.obj": (b"v 0 0 0\n" + b"f 1 1 1\n" * FIVE_MILLION, 8 + 8 * FIVE_MILLION, "has 5000000 faces"),
        "text.stl": (b"solid\n" * 20 + b"endfacet\n" * 60_000, 120 + 9 * 60_000, "has 60000 faces"),
    }


BOX_ROWS = [" ".join(map(str, row)) for row in shoebox().vertices.tolist()]
BOX_FACES = [f"3 {a} {b} {c}" for a, b, c in shoebox().faces.tolist()]
PLY = "ply\nformat ascii 1.0\nelement vertex 8\nproperty double x\nproperty double y\nproperty double z\n"
PLY_FACES = PLY + "element face 12\nproperty list uchar int vertex_indices\nend_header\n"


def ply(rows: list[str], faces: list[str] | None = None, header: str = PLY_FACES) -> bytes:
    return (header + "\n".join([*rows, *(BOX_FACES if faces is None else faces)]) + "\n").encode()


def obj(*extra: str) -> bytes:
    rows = [f"v {row}" for row in BOX_ROWS]
    faces = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in shoebox().faces.tolist()]
    return "\n".join([*extra, *rows, *faces, ""]).encode()


def changed(**parts: object) -> bytes:
    description, data = wedge_description()
    return glb({**description, **parts}, data)


def wedge_with(part: str, index: int, **keys: object) -> bytes:
    description, data = wedge_description()
    description[part][index].update(keys)
    return glb(description, data)


def wedge_beginning(number: bytes) -> bytes:
    """The wedge with another number as its first coordinate."""
    description, data = wedge_description()
    return glb(description, number + data[4:])


FAR = [{"children": [number + 1], "scale": [1e9] * 3} for number in range(40)]
PNG = b"\x89PNG\r\n\x1a\n" + bytes(200)
GARBAGE = b"Lorem ipsum dolor sit amet, consectetur adipiscing elit. " * 20
NO_MESH = {"glb": "is not a GLB file", "stl": "is not an STL file", "ply": "is not a PLY file", "obj": "holds no faces"}
REFUSED = {
    **{f"picture.{ending}": (PNG, words) for ending, words in NO_MESH.items()},
    **{f"garbage.{ending}": (GARBAGE, words) for ending, words in NO_MESH.items()},
    "empty.glb": (b"", "is empty"),
    "empty.obj": (b"", "is empty"),
    "solid.stl": (b"solid garbage\n" * 9, "holds no faces"),
    "short.stl": (bytes(80) + struct.pack("<I", 9) + bytes(100), "neither text that begins with 'solid'"),
    "points.ply": (ply(BOX_ROWS, [], PLY + "end_header\n"), "holds no faces, only points"),
    "points.obj": (b"\n".join(b"v " + row.encode() for row in BOX_ROWS), "holds no faces, only points"),
    "points.glb": (wedge_with("meshes", 0, primitives=[{"attributes": {"POSITION": 0}, "mode": 0}]), "holds no faces"),
    "nan.ply": (ply([*BOX_ROWS[:3], "nan 0 0", *BOX_ROWS[4:]]), "has 1 of 8 vertices that are NaN, infinite"),
    "inf.ply": (ply([*BOX_ROWS[:3], "0 -inf 0", *BOX_ROWS[4:]]), "the first is number 3, [0.0, -inf, 0.0]"),
    "huge.ply": (ply([*BOX_ROWS[:3], "1e300 0 0", *BOX_ROWS[4:]]), "beyond 1e+09"),
    "flat.ply": (ply([f"{row.rsplit(' ', 1)[0]} 4" for row in BOX_ROWS]), "has no height: a solid is needed"),
    "line.ply": (ply([f"{row.split()[0]} 7 4" for row in BOX_ROWS]), "has no beam and no height"),
    "cut.ply": (ply(BOX_ROWS[:5]), "has 17 rows of the 20 that its header announces"),
    "index.ply": (ply(BOX_ROWS, ["3 0 1 900", *BOX_FACES[1:]]), "cannot be read as PLY|that use vertex 900"),
    "index.obj": (obj() + b"f 1 2 900\n", "has the corner '900' in line 21: there is no such vertex, of 8"),
    "words.ply": (ply(["a b c", *BOX_ROWS[1:]]), "cannot be read as PLY"),
    "count.ply": (ply(BOX_ROWS, header=PLY_FACES.replace("vertex 8", "vertex eight")), "'element vertex eight'"),
    "points.stl": (b"solid\nfacet\nendfacet\n" + b"vertex 0 0 0\n" * (MAX_VERTICES + 1), "has 150001 vertices"),
    "long.obj": (obj("f" + " 1" * 40_000), "line of 80001 characters (line 1)"),
    "corners.obj": (obj(*["f" + " 1" * 30_000] * 2), "has 60008 faces"),
    "word.obj": (obj() + b"f 1 2 x\n", "has the corner 'x' in line 21; a number is needed"),
    "zero.obj": (obj() + b"f 1 2 -9\n", "has the corner '-9' in line 21: there is no such vertex"),
    "parts.stl": (b"solid\nendsolid\n" * 1001 + b"endfacet", "has 1001 solids"),
    "image.glb": (changed(images=[{"uri": "http://example.org/x"}]), "refers to 'http://example.org/x' (image)"),
    "parent.glb": (wedge_with("buffers", 0, uri="%2e%2e/x.bin"), "refers to '%2e%2e/x.bin' (buffer)"),
    "beside.glb": (wedge_with("buffers", 0, uri="x.bin"), "keeps its geometry in another file, 'x.bin'"),
    "draco.glb": (changed(extensionsRequired=["KHR_draco_mesh_compression"]), "needs the glTF extension"),
    "sparse.glb": (wedge_with("accessors", 0, sparse={"count": 1}), "has accessor 0 stored sparsely"),
    "vertices.glb": (wedge_with("accessors", 0, count=200_000), "has 200000 vertices"),
    "plane.ply": (ply(BOX_ROWS, header=PLY_FACES.replace("property double z\n", "")), "'z' is missing"),
    "plane.obj": (obj().replace(b"0.0\n", b"\n").replace(b" 1.0\n", b"\n"), "has vertices of 2 coordinates"),
    "range.glb": (wedge_with("accessors", 0, count=400), "has accessor 0 with 400 items in 48 bytes"),
    "stride.glb": (wedge_with("bufferViews", 0, byteStride=252), "has accessor 0 with 4 items"),
    "view.glb": (wedge_with("bufferViews", 1, byteLength=4000), "has buffer view 1 reaching beyond its data"),
    "claims.glb": (
        changed(buffers=[{"byteLength": 9000}], bufferViews=[{"buffer": 0, "byteLength": 8000}] * 2),
        "reaching beyond its data of 72 bytes",
    ),
    "nodata.glb": (changed(accessors=[{"componentType": 5126, "count": 4, "type": "VEC3"}] * 2), "of a type"),
    "loop.glb": (changed(nodes=[{"mesh": 0, "children": [0]}]), "has node 0 in two places"),
    "twice.glb": (changed(scenes=[{"nodes": [0, 0]}]), "has node 0 in two places"),
    "noscene.glb": (changed(scenes=[]), "has no scene 0"),
    "nomesh.glb": (changed(nodes=[{"mesh": 7}]), "has no mesh 7"),
    "nonode.glb": (changed(scenes=[{"nodes": [5]}]), "has no node 5"),
    "corners.glb": (wedge_with("accessors", 1, count=11), "has triangles with 11 corners"),
    "nobase64.glb": (wedge_with("buffers", 0, uri="data:,abc"), "has data in buffer 0 that is not base64"),
    "padding.glb": (wedge_with("buffers", 0, uri="data:;base64,A"), "has data in buffer 0 that is not base64"),
    "shortdata.glb": (wedge_with("buffers", 0, uri="data:;base64,AAAA"), "has only 3 bytes of data in buffer 0"),
    "chunk.glb": (changed().replace(b"\x48\0\0\0BIN\0", b"\x49\0\0\0BIN\0"), "has 72 bytes"),
    "fan.glb": (wedge_with("meshes", 0, primitives=[{"attributes": {"POSITION": 0}, "mode": 6}]), "triangle fans"),
    "type.glb": (wedge_with("accessors", 0, count="many"), "accessors[0].count: a whole number is needed"),
    "json.glb": (glb({}).replace(b"{}", b"{x"), "is not JSON"),
    "deep.glb": (glb({}).replace(b"{}  ", b"[" * 4), "is not JSON"),
    "cut.glb": (changed()[:-20], "is it cut off?"),
    "version.glb": (changed()[:4] + struct.pack("<I", 1) + changed()[8:], "is glTF version 1"),
    "quiet.glb": (wedge_beginning(struct.pack("<f", np.nan)), "has 1 of 4 vertices that are NaN"),
    "signalling.glb": (wedge_beginning(struct.pack("<I", 0x7F800001)), "has 1 of 4 vertices that are NaN"),
    "far.glb": (changed(nodes=[*FAR, {"mesh": 0}]), "vertices that are NaN, infinite or beyond"),
}


@pytest.mark.parametrize("file", REFUSED)
def test_a_bad_file_is_refused_in_one_clear_line(file: str, tmp_path: Path) -> None:
    content, words = REFUSED[file]
    (tmp_path / file).write_bytes(content)
    line = problem(file, tmp_path)
    assert line.startswith(f": '{file}' ")
    assert any(part in line for part in words.split("|")), line
    assert len(line) < 300 and "\n" not in line


def test_a_bad_entry_is_refused_in_one_clear_line(tmp_path: Path) -> None:
    outside, scene = tmp_path / "outside.stl", tmp_path / "scene"
    outside.write_bytes(trimesh.creation.box().export(file_type="stl"))
    (scene / "folder.stl").mkdir(parents=True)
    (scene / "there.stl").write_bytes(outside.read_bytes())
    (scene / "link.stl").symlink_to(outside)
    os.mkfifo(scene / "pipe.stl")
    for entry, words in (
        ("fery", "'fery' is no shipped mesh (did you mean 'ferry'?), and no file that ends in one of .glb, .obj"),
        ("hull.blend", "no file that ends in one of .glb, .obj, .stl, .ply"),
        ("hull.stl", "'hull.stl' does not exist"),
        ("folder.stl", "is a folder"),
        ("pipe.stl", "is no ordinary file"),
        ("link.stl", "is a link that leads out of the scene's folder"),
        ("../hull.stl", "'../hull.stl' is remote or outside the scene's folder"),
        ("a/../../hull.stl", "outside the scene's folder"),
        ("/etc/hull.stl", "outside the scene's folder"),
        ("https://example.org/hull.glb", "is remote or outside"),
        ("data:model/gltf-binary;base64,AAAA.glb", "is remote or outside"),
        ("C:\\hull.stl", "is remote or outside"),
        ("", "cannot be a file's name"),
        ("a\0.stl", "cannot be a file's name"),
        (7, "the name of a shipped mesh, a file, or a mapping of file, forward and up is needed (got 7)"),
        (None, "(got null)"),
        ({"forward": "+x"}, ".file: missing"),
        ({"file": "a.stl", "upp": "+z"}, ".upp: unknown key (did you mean 'up'?)"),
        ({"file": "a.stl", "up": "z"}, ".up: must be '+x', '-x'"),
        ({"file": "there.stl", "up": "-x"}, "has forward +x and up -x; two different axes are needed"),
    ):
        assert words in problem(entry, scene), entry


def test_references_inside_the_folder_are_told_from_others_and_harmless_ones_not_followed(tmp_path):
    ways = ("/", "../", "x/../", "..\\", "\\\\host\\", "file:", "~/", " /")
    for inside in ("hull.bin", "a/b.png", "a..b.png", "..a/b"):
        assert not leads_outside(inside)
        assert all(leads_outside(f"{way}{inside}") for way in ways), inside
    libraries = ("box.mtl", "../../secret.mtl", "https://example.org/a.mtl", "C:\\Users\\me\\ship.mtl")
    files = {f"{number}.obj": obj(f"mtllib {name}", "usemtl paint") for number, name in enumerate(libraries)}
    assert all(b"mtl" not in read_obj(io.BytesIO(content), len(content)) for content in files.values())
    texture = PLY_FACES.replace("ascii 1.0\n", "ascii 1.0\ncomment TextureFile /etc/passwd\n")
    files["box.ply"] = ply(BOX_ROWS, header=texture)
    files["box.glb"] = changed(images=[{"uri": "paint.png"}, {"uri": "data:image/png;base64,AAAA"}])
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
        assert load_mesh(file, tmp_path).closed, file


def test_any_damaged_file_is_refused_or_a_solid(tmp_path: Path) -> None:
    """Bytes changed and cut at random: nothing but InputError may come of it."""
    rng = np.random.default_rng(5)
    mesh = trimesh.Trimesh(shoebox().vertices, shoebox().faces, process=False)
    files = {ending: mesh.export(file_type=ending) for ending in ("glb", "stl")}
    files |= {"ply": mesh.export(file_type="ply", encoding="ascii"), "obj": obj()}
    for ending, content in files.items():
        whole = np.frombuffer(content, dtype=np.uint8)
        for _ in range(40):
            damaged = whole.copy()
            where = rng.integers(0, len(damaged), size=rng.integers(1, 6))
            damaged[where] = rng.integers(0, 256, size=len(where))
            file = tmp_path / f"damaged.{ending}"
            file.write_bytes(damaged[: rng.integers(1, 2 * len(damaged))].tobytes())
            try:
                solid = load_mesh(file.name, tmp_path)
            except InputError as error:
                assert len(error.problems) == 1
            else:
                assert np.isfinite(solid.vertices).all() and solid.faces.max() < len(solid.vertices)


def test_a_scene_of_shipped_meshes_and_a_sea_and_a_moment_of_it_load_no_package_that_they_do_not_need() -> None:
    code = (
        "import modsim3d, modsim3d.world.mesh_reading, sys; scene = modsim3d.load_scene('strait'); "
        "loaded = {'trimesh', 'scipy.spatial'} & set(sys.modules); scene.at(0); "
        "sys.exit(bool(loaded) or 'trimesh' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
