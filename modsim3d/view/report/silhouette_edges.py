"""The edges of meshes at which front faces meet back faces, in pixels, cut at the near plane and at the image's edge. A
ray from the camera leaves a closed solid through a back face as often as it passes through the solid. The border of all
back faces beyond the near plane therefore winds around each pixel as often as the solid covers it. Edges between two
back faces or two front faces are not needed, nor is a section that closes the solid at the near plane."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from modsim3d.core.arrays import Array, Indices, Mask, run_starts
from modsim3d.geometry.camera import Intrinsics
from modsim3d.truth.buffer_drawing import LENS_GUARD_PX
from modsim3d.truth.outlines import OutlinePart, Outlines
from modsim3d.world.vessels import Solid

Signs = NDArray[np.int8]
MAX_FACES = 300_000  # looked at together: few calls, little memory


@dataclass(frozen=True, eq=False)
class Edges:
    """Directed edges that form closed lines around what each row of `Outlines` covers."""

    row: Indices  # of the outlines, non-decreasing, shape (e,)
    ends_px: Array  # start and end of each edge, shape (e, 2, 2)

    def boxes_px(self, rows: int) -> Array:
        """Boxes around the edges of each row; (inf, inf, −inf, −inf) around none, shape (rows, 4).
        They may be too large along the image's border."""
        boxes = np.tile([np.inf, np.inf, -np.inf, -np.inf], (rows, 1))
        first = run_starts(self.row)
        if len(first):
            for axis in (0, 1):
                starts = np.ascontiguousarray(self.ends_px[:, 0, axis])
                boxes[self.row[first], axis] = np.minimum.reduceat(starts, first)
                boxes[self.row[first], 2 + axis] = np.maximum.reduceat(starts, first)
        return boxes


def silhouette_edges(outlines: Outlines, intrinsics: Intrinsics) -> Edges:
    """The edges around all rows in the camera's image.
    The lines around solids that are not closed wind around what their faces cover, seen from either side."""
    pieces = [(np.empty(0, dtype=np.int64), np.empty((0, 2, 2)))]
    for part in outlines.parts:
        crosses = outlines.crosses_near[part.rows]
        for cut in (False, True):
            for some in _in_turns(part, np.flatnonzero(crosses == cut)):
                pieces.append(_edges(some, intrinsics, cut=cut))
    row, ends = np.concatenate([row for row, _ in pieces]), np.concatenate([ends for _, ends in pieces])
    if intrinsics.distortion is not None:
        row, ends = _confined(row, ends, intrinsics.pinhole.image_size_px, LENS_GUARD_PX)
        row, ends = _divided(row, ends, intrinsics.chord_px)
        ends = intrinsics.through_lens(ends)
    row, ends = _confined(row, ends, intrinsics.image_size_px)
    order = np.argsort(row, kind="stable")
    return Edges(row[order], ends[order])


def _in_turns(part: OutlinePart, members: Indices) -> Iterator[OutlinePart]:
    """Parts with some members of one, so that their faces fit into memory."""
    size = max(1, MAX_FACES // max(1, len(part.solid.faces)))
    for first in range(0, len(members), size):
        some = members[first : first + size]
        yield OutlinePart(part.solid, part.rows[some], part.vertices_camera[some], part.vertices_px[some])


@dataclass(frozen=True, eq=False)
class _Mesh:
    """The edges of a solid, and the faces at each."""

    ends: Indices  # vertices of each edge, the lower number first, shape (E, 2)
    faces: Indices  # at each edge, shape (k, E), the number of faces where there are fewer than k
    signs: Signs  # 1 where a face runs along its edge from the first end to the second, else −1, shape (k, E)


@lru_cache(maxsize=256)
def _mesh(solid: Solid) -> _Mesh:
    start, end = solid.faces.ravel(), np.roll(solid.faces, -1, axis=1).ravel()
    ends, edge = np.unique(np.sort(np.column_stack([start, end]), axis=1), axis=0, return_inverse=True)
    edge = edge.reshape(-1)
    order = np.argsort(edge, kind="stable")
    count = np.bincount(edge, minlength=len(ends))
    slot = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    faces = np.full((int(count.max(initial=0)), len(ends)), len(solid.faces))
    signs = np.ones(faces.shape, dtype=np.int8)
    faces[slot, edge[order]] = order // 3
    signs[slot, edge[order]] = np.sign(end - start)[order]
    return _Mesh(ends, faces, signs)


def _edges(part: OutlinePart, intrinsics: Intrinsics, *, cut: bool) -> tuple[Indices, Array]:
    """Rows, and ends in the pinhole's image, of the edges around a part; `cut` if the near plane cuts all rows."""
    mesh = _mesh(part.solid)
    turned = _turned(part)
    net = np.zeros((len(mesh.ends), len(part.rows)), dtype=np.int8)
    for sign, face in zip(mesh.signs, mesh.faces, strict=True):
        net += sign[:, None] * turned[face]
    net = np.ascontiguousarray(net.T)
    member, edge = np.nonzero(net)
    times = net[member, edge]
    vertex = np.where((times > 0)[:, None], mesh.ends[edge], mesh.ends[edge, ::-1])
    many = np.abs(times)
    member, vertex = np.repeat(member, many), np.repeat(vertex, many, axis=0)
    if not cut:
        return part.rows[member], part.vertices_px[member[:, None], vertex]
    member, ends = _beyond_near(part, member, vertex, intrinsics.near_clip_m)
    section_member, section = _section(part, turned, intrinsics.near_clip_m)
    pixels = intrinsics.pinhole.project(np.concatenate([ends, section]))
    return part.rows[np.concatenate([member, section_member])], pixels


def _turned(part: OutlinePart) -> Signs:
    """Count of each face, and a last row of zeros, shape (F + 1, m).
    It is 1 for a face as it is, −1 for one whose corners run the other way round, 0 for one that is not needed."""
    x, y, z = (np.ascontiguousarray(part.vertices_camera[..., axis].T) for axis in range(3))
    a, b, c = part.solid.faces.T
    ax, ay, az = x[a], y[a], z[a]
    bx, by, bz = x[b] - ax, y[b] - ay, z[b] - az
    cx, cy, cz = x[c] - ax, y[c] - ay, z[c] - az
    away = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    turned = np.zeros((len(part.solid.faces) + 1, len(part.rows)), dtype=np.int8)
    turned[:-1] = -(away > 0).astype(np.int8)
    if not part.solid.closed:
        turned[:-1] += away < 0
    return turned


def _beyond_near(part: OutlinePart, member: Indices, vertex: Indices, near: float) -> tuple[Indices, Array]:
    """Members and ends in CCF of what is left of edges beyond the near plane, shapes (e,) and (e, 2, 3)."""
    depth = part.vertices_camera[member[:, None], vertex, 2]
    inside = depth >= near
    kept = inside.any(axis=1)
    member, vertex, inside = member[kept], vertex[kept], inside[kept]
    ends = part.vertices_camera[member[:, None], vertex]
    for one in (0, 1):
        out = np.flatnonzero(~inside[:, one])
        ends[out, one] = _crossing(part, member[out], vertex[out, 1 - one], vertex[out, one], near)
    return member, ends


def _section(part: OutlinePart, turned: Signs, near: float) -> tuple[Indices, Array]:
    """Members and ends in CCF of the edges along which the near plane cuts faces, shapes (e,) and (e, 2, 3)."""
    faces = part.solid.faces
    inside = (part.vertices_camera[..., 2] >= near)[:, faces]
    after = np.roll(inside, -1, axis=2)
    member, face = np.nonzero((inside & ~after).any(axis=2) & (turned[:-1].T != 0))
    which = np.arange(len(member))
    ends = np.empty((len(member), 2, 3))
    inside, after = inside[member, face], after[member, face]
    # The border of what is left of a face runs along its cut from where it leaves to where it comes back.
    leaves, comes = (inside & ~after).argmax(axis=1), (~inside & after).argmax(axis=1)
    corner = faces[face]
    ends[:, 0] = _crossing(part, member, corner[which, leaves], corner[which, (leaves + 1) % 3], near)
    ends[:, 1] = _crossing(part, member, corner[which, (comes + 1) % 3], corner[which, comes], near)
    backwards = turned[face, member] < 0
    ends[backwards] = ends[backwards, ::-1]
    return member, ends


def _crossing(part: OutlinePart, member: Indices, inner: Indices, outer: Indices, near: float) -> Array:
    """Points at which edges leave the half-space beyond the near plane, shape (e, 3).
    They are computed from the inner end, so that all that end there get exactly the same point."""
    a, b = part.vertices_camera[member, inner], part.vertices_camera[member, outer]
    share = (a[:, 2] - near) / (a[:, 2] - b[:, 2])
    crossing: Array = a + share[:, None] * (b - a)
    crossing[:, 2] = near
    return crossing


def _confined(row: Indices, ends: Array, size_px: tuple[int, int], guard_px: float = 0.0) -> tuple[Indices, Array]:
    """Edges whose lines wind around each pixel of the image as before, and which do not leave it by more than a guard.
    Lines outside are moved to the nearest places on the border."""
    low, high = -guard_px, np.array(size_px) + guard_px
    out = ((ends < low) | (ends > high)).reshape(-1, 4).any(axis=1)
    whole_row, whole_ends, row, ends = row[~out], ends[~out], row[out], ends[out]
    for axis in (0, 1):
        for bound in (low, high[axis]):
            beyond = ends[..., axis] > bound
            cut = np.flatnonzero(beyond[:, 0] != beyond[:, 1])
            start, end = ends[cut, 0], ends[cut, 1]
            share = (bound - start[:, axis]) / (end[:, axis] - start[:, axis])
            crossing = start + share[:, None] * (end - start)
            crossing[:, axis] = bound
            row = np.concatenate([row, row[cut]])
            ends = np.concatenate([ends, np.stack([crossing, end], axis=1)])
            ends[cut, 1] = crossing
    ends = np.clip(ends, low, high)
    kept = np.any(ends[:, 0] != ends[:, 1], axis=1)
    return np.concatenate([whole_row, row[kept]]), np.concatenate([whole_ends, ends[kept]])


def _divided(row: Indices, ends: Array, longest_px: float) -> tuple[Indices, Array]:
    """Edges cut into equal pieces that are no longer than `longest_px`."""
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    pieces = np.maximum(1, np.ceil(length / longest_px).astype(np.int64))
    which = np.repeat(np.arange(len(pieces)), pieces)
    piece = np.arange(len(which)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    start, end = ends[which, 0], ends[which, 1]
    shares = (piece[:, None] / pieces[which, None], (piece[:, None] + 1) / pieces[which, None])
    divided = np.stack([start + share * (end - start) for share in shares], axis=1)
    last = piece + 1 == pieces[which]
    divided[last, 1] = end[last]
    return row[which], divided


# ---- Closed lines around what is covered, without cutting polygons ----

PLACE_BITS = 17  # of a coordinate in a vertex's number
_PLACE = (1 << PLACE_BITS) - 1


@dataclass(frozen=True, eq=False)
class Contours:
    """Closed lines, those of one shape after the other."""

    shape: Indices  # index of the shape that each line belongs to, non-decreasing, shape (l,)
    count: Indices  # number of corners of each line, shape (l,)
    corners: Indices  # of the lines, line after line, the first not repeated at the end, shape (k, 2)


def contours(shape: Indices, ends: Indices) -> Contours:
    """Join the directed edges of each shape to closed lines, by the index of the shape, shape (e,).
    Start and end of the edges are whole numbers from 0 to 65,535, shape (e, 2, 2). In each shape as many edges begin at
    a place as end there."""
    place = (ends[..., 0] << PLACE_BITS) + ends[..., 1]
    number, vertex = np.unique((shape[:, None] << 2 * PLACE_BITS) + place, return_inverse=True)
    start, end = vertex.reshape(-1, 2).T
    line, count = _joined(*_unpaired(start, end, len(number)))
    numbers = number[line]
    flat = np.column_stack([numbers >> PLACE_BITS, numbers]) & _PLACE
    first = np.cumsum(count) - count
    return Contours(numbers[first] >> 2 * PLACE_BITS, count, flat)


def _unpaired(start: Indices, end: Indices, vertices: int) -> tuple[Indices, Indices]:
    """Start and end of the directed edges that no opposite edge cancels, shape (e,) each."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    edge, which = np.unique(low * vertices + high, return_inverse=True)
    net = np.bincount(which.reshape(-1), np.sign(end - start), len(edge)).astype(np.int64)
    low, high = np.divmod(edge, vertices) if vertices else (edge, edge)
    forth, back = (np.repeat(np.arange(len(edge)), np.maximum(sign * net, 0)) for sign in (1, -1))
    return np.concatenate([low[forth], high[back]]), np.concatenate([high[forth], low[back]])


def _joined(start: Indices, end: Indices) -> tuple[Indices, Indices]:
    """Start vertices of edges in order along closed lines, shape (e,), and the number of edges of each line, shape
    (l,). As many edges begin at each vertex as end there. A line begins at its lowest vertex. Lines are in order of it,
    so that those of a shape stay together."""
    order = np.argsort(start, kind="stable")
    after = np.empty_like(order)
    after[np.argsort(end, kind="stable")] = np.arange(len(order))
    after = after[order]
    first = _least_along(after)
    heads = first == np.arange(len(first))
    count = np.bincount(first, minlength=len(first))
    begin = np.cumsum(np.where(heads, count, 0)) - count
    line = np.empty_like(order)
    left = _left_to(heads, after)
    line[begin[first] + (count[first] - left) % count[first]] = order
    return start[line], count[heads]


def _least_along(after: Indices) -> Indices:
    """The least index in the ring of each, where one follows the other as `after` says, shape (n,)."""
    least, jump = np.arange(len(after)), after
    while True:
        # Each knows the least of 2, 4, 8, … from itself on; once nobody learns more, all know that of the ring.
        lower = np.minimum(least, least[jump])
        if np.array_equal(lower, least):
            return least
        least, jump = lower, jump[jump]


def _left_to(heads: Mask, after: Indices) -> Indices:
    """Number of steps along `after` from each to the next head, zero for a head itself, shape (n,)."""
    left = np.where(heads, 0, 1)
    jump = np.where(heads, np.arange(len(after)), after)
    while not heads[jump].all():
        left, jump = left + left[jump], jump[jump]
    return left


def tidy_at_border(shape: Indices, ends: Indices, size: tuple[int, int]) -> tuple[Indices, Indices]:
    """Edges without the ways to and fro along the border of an image, and their shapes; the lines wind around its
    pixels as before. `shape` has the shape of each edge, shape (e,), `ends` their start and end, whole numbers from 0
    to `size`, the greatest column and row, shape (e, 2, 2). Those along the border come last."""
    left = np.ones(len(shape), dtype=bool)
    shapes, every = [], []
    for axis, bound in ((0, 0), (0, size[0]), (1, 0), (1, size[1])):
        on_bound = ends[..., axis] == bound
        on = left & on_bound[:, 0] & on_bound[:, 1]
        left &= ~on
        place, which = np.unique((shape[on, None] << PLACE_BITS) + ends[on, :, 1 - axis], return_inverse=True)
        change = np.bincount(which.reshape(-1), np.tile([1, -1], int(on.sum())), len(place)).astype(np.int64)
        place, cover = place[change != 0], np.cumsum(change[change != 0])
        piece = np.repeat(np.arange(len(cover)), np.abs(cover))
        along = np.stack([place[piece], place[np.minimum(piece + 1, len(place) - 1)]], axis=1)
        along[cover[piece] < 0] = along[cover[piece] < 0, ::-1]
        shapes.append(along[:, 0] >> PLACE_BITS)
        both = np.full((len(along), 2, 2), bound)
        both[..., 1 - axis] = along & _PLACE
        every.append(both)
    return np.concatenate([shape[left], *shapes]), np.concatenate([ends[left], *every])
