"""A scene in light and shade: sea, sky, sun, vessels in their colours, obstacles, and own ship's bow if it has a mesh.
Pixels show vessels as the ID buffer of the same size does. Light, fog and night are no part of the simulation."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from modsim3d.core.arrays import Array, Mask
from modsim3d.geometry.camera import Intrinsics
from modsim3d.render.id_pass import SUBPIXELS, Region
from modsim3d.render.shaded_pass import Lamp, LitFaces, LitPicture, ShadedRenderer
from modsim3d.view import palette
from modsim3d.view.lights import Sector, SeenLight, is_hidden, lights_towards
from modsim3d.view.pictures.canvas import Box, Canvas, Window
from modsim3d.view.pictures.plain import Solids, occluder_colour
from modsim3d.view.sea_and_sky import Backdrop, Floats, Rays, RenderStyle, fogged, palette_of, sun_of
from modsim3d.world.floating_vessels import GRAVITY_M_S2
from modsim3d.world.vessels import Vessel

# ---- Foam of bow waves and wakes, the stronger the faster vessels go ----

MIN_M_S = 0.5  # a slower vessel leaves none
WAKE_S, ARM_S = 14.0, 5.0  # in so much time the foam of the wake, and that of the bow wave, falls to a third
KELVIN = math.tan(math.asin(1 / 3))  # half the angle of a ship's waves in deep water: 19.47° (Kelvin, 1887)
FULL_M_S, FULL_FROUDE = 5.0, 0.4  # speed and Froude number at which wake and bow wave are white
FOAM, WHITER = 0.75, 0.12  # share of a pixel that the whitest foam covers, and how much whiter than fog it is


def draw_wakes(
    rgb: Floats, backdrop: Backdrop, solids: Solids, window: Window, speeds_m_s: Array
) -> tuple[Region, ...]:
    """Draw the foam of the vessels before a camera into a picture, sRGB from 0 to 1, shape (h, w, 3), and return the
    regions that it may have changed. For `speeds_m_s` see `lights_towards`."""
    sight, regions, wet = solids.sight, [], backdrop.wet
    poses, air = sight.camera_poses, np.array(palette_of(backdrop.style).fog, np.float32)
    for index in np.flatnonzero(sight.others[0] & (speeds_m_s > MIN_M_S)).tolist():
        vessel, speed_m_s = sight.vessels[index], float(speeds_m_s[index])
        ahead, origin_m = sight.world_R_vessel[0, index, :2, 0], sight.poses.positions_m[0, index]
        ahead = (ahead / np.linalg.norm(ahead)).astype(np.float32)
        behind_m, wide_m = vessel.length_m + 2 * WAKE_S * speed_m_s, vessel.beam_m + 2.5 * KELVIN * ARM_S * speed_m_s
        bow_m = origin_m[:2] + 0.5 * vessel.length_m * ahead
        outline = ((0.0, vessel.beam_m), ((wide_m - vessel.beam_m) / (1.2 * KELVIN), wide_m), (behind_m, wide_m))
        port = np.array([-ahead[1], ahead[0]])
        places = [bow_m - aft * ahead + side * wide * port for side in (1, -1) for aft, wide in outline[::side]]
        corners = poses.to_camera(np.column_stack([places, np.zeros(len(places))])[None])[0]
        if not (corners[:, 2] > solids.intrinsics.near_clip_m).all():
            continue  # it begins behind the camera, or ends there
        ends = window.to_picture(solids.intrinsics.project(corners))
        region = Region.around(np.concatenate([ends.min(axis=0), ends.max(axis=0)]), window.size)
        if region.width <= 0 or region.height <= 0:
            continue
        mask = Image.new("1", (region.width, region.height))
        ImageDraw.Draw(mask).polygon([tuple(end) for end in (ends - (region.x, region.y)).tolist()], fill=1)
        row, column = np.nonzero(
            np.asarray(mask) & backdrop.sea[region.y : region.y + region.height, region.x : region.x + region.width]
        )
        row, column = row + region.y, column + region.x
        on_sea = row - wet.start, column
        from_bow = (poses.positions_m[0, :2] - bow_m).astype(np.float32)
        x, y = (backdrop.from_camera_m[axis][on_sea] + from_bow[axis] for axis in (0, 1))
        aft, across = np.maximum(-(x * ahead[0] + y * ahead[1]), 0), np.abs(y * ahead[0] - x * ahead[1])
        share = _foam(aft, across, backdrop.footprint_m[on_sea], vessel, speed_m_s)
        share *= np.clip(0.75 + 0.9 * backdrop.ripple[row, column], 0.1, 1.2) * FOAM
        kept = 1 if backdrop.kept is None else backdrop.kept[on_sea][:, None]  # foam is whiter than the air before it
        rgb[row, column] += np.minimum(share, 0.9)[:, None] * (air * (1 + WHITER * kept) - rgb[row, column])
        regions.append(region)
    return tuple(regions)


def _foam(aft_m: Floats, across_m: Floats, footprint_m: Floats, vessel: Vessel, speed_m_s: float) -> Floats:
    """Share of the sea that is foam aft of a vessel's bow and across her way, each seen by a pixel of some size."""
    behind = aft_m - 0.95 * vessel.length_m
    half = 0.4 * vessel.beam_m + 0.05 * np.maximum(behind, 0)
    wake = np.exp(-((across_m / (half + footprint_m)) ** 2) - np.maximum(behind, 0) / (WAKE_S * speed_m_s))
    wake *= (behind > 0) * half / (half + footprint_m) * min(speed_m_s / FULL_M_S, 1.0)
    froude = speed_m_s / math.sqrt(GRAVITY_M_S2 * vessel.length_m)
    thick = 0.06 * vessel.beam_m + 0.1 + 0.04 * aft_m
    arm = np.maximum(KELVIN * aft_m, np.minimum(0.5 * vessel.beam_m, 1.2 * aft_m)) - across_m
    bow = np.exp(-((arm / (thick + footprint_m)) ** 2) - aft_m / (ARM_S * speed_m_s))
    bow *= thick / (thick + footprint_m) * min((froude / FULL_FROUDE) ** 2, 1.0)
    foam: Floats = np.maximum(wake, bow)
    return foam


# ---- Lights of vessels ----

FAINTEST, BRIGHTEST = 0.35, 1.2  # brightness of the middle of the faintest light that an eye sees, and of a strong one
MAX_PX = 4.0  # radius of the strongest light at a width of 1280
MIRRORED, STREAK = 0.35, 7.0  # brightness of what the sea shows of a light, and how much longer than wide it is
SIDES = (Sector.PORT, Sector.STARBOARD)


def draw_lights(rgb: Floats, solids: Solids, window: Window, speeds_m_s: Array, extinction_per_m: float) -> None:
    """Draw the lights before a camera that nothing hides into a picture, sRGB from 0 to 1, shape (h, w, 3), and what
    the sea shows of them. For `speeds_m_s` and `extinction_per_m` see `lights_towards`."""
    unit, shown = window.size[0] / 1280, []
    for light in lights_towards(solids.sight, speeds_m_s, extinction_per_m):
        place = _place_px(solids, window, light.place_m, light.vessel)
        if place is not None:
            shown.append((light, place))
    for light, place in shown:
        # Sidelights that an eye can tell apart only by colour stand side by side: in one glow they would be yellow.
        pair = [at for one, at in shown if one.vessel == light.vessel and one.lantern.sector in SIDES]
        side = 0
        if light.lantern.sector in SIDES and len(pair) == 2 and abs(pair[0][0] - pair[1][0]) < 4 * unit:
            side = 1 if light.lantern.sector is Sector.PORT else -1  # seen from ahead, port is to the right
            place = (pair[0] + pair[1]) / 2
        _glow(rgb, place, light, unit, side)
        below = _place_px(solids, window, light.place_m * (1, 1, -1), -1)
        if below is not None:
            _glow(rgb, np.array([place[0], below[1]]) if side else below, light, unit, side, mirrored=True)


def _place_px(solids: Solids, window: Window, place_m: Array, vessel: int) -> Array | None:
    """Column and row of a place in WCF in a picture, shape (2,); None if it is not in it, or hidden by anything but a
    vessel, of which the index is given."""
    seen_m = solids.sight.camera_poses.to_camera(place_m[None, None])[0, 0]
    if seen_m[2] <= solids.intrinsics.near_clip_m:
        return None
    place_px = solids.intrinsics.project(seen_m[None])[0]
    at: Array = window.to_picture(place_px)
    inside = (at >= 0).all() and (at < window.size).all()
    return at if inside and not is_hidden(solids, vessel, place_px, solids.intrinsics.near_clip_m / seen_m[2]) else None


def _glow(
    rgb: Floats, place_px: Array, light: SeenLight, unit_px: float, side: int = 0, *, mirrored: bool = False
) -> None:
    """A bright point in a halo. Its radius and its brightness grow with the logarithm of the light, as eyes see it.
    `side` is 1 for the right half only, −1 for the left. On the sea it is `mirrored` as a faint streak."""
    radius_px = max(1.0, unit_px * min(0.7 + 0.75 * light.decades, MAX_PX))
    peak = min(FAINTEST + 0.4 * light.decades, BRIGHTEST) * (MIRRORED if mirrored else 1)
    high_px = radius_px * (STREAK if mirrored else 1)
    height, width = rgb.shape[:2]
    column, row = (math.floor(value) for value in place_px)
    reach, tall = math.ceil(8 * radius_px), math.ceil(8 * high_px if not mirrored else 2 * high_px)
    rows = np.arange(max(row - tall, 0), min(row + tall + 1, height))
    columns = np.arange(max(column - reach, 0), min(column + reach + 1, width))
    if side:
        columns = columns[(columns + 0.5 - place_px[0]) * side > 0]
        if not len(columns):
            return
    across = (columns + 0.5 - place_px[0] - 0.5 * side * radius_px) / radius_px
    squared = ((rows + 0.5 - place_px[1])[:, None] / high_px) ** 2 + across**2
    strength = peak * (np.exp(-squared) + (0 if mirrored else 0.2) * np.exp(-squared / 12))[..., None]
    light_rgb = (strength * light.lantern.colour.value).astype(np.float32)
    rgb[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += light_rgb


SAMPLES = 2  # solids are drawn this much larger and shrunk, so that their edges have no steps
REFLECTION = 0.8  # share of a vessel's light that a calm sea would show
SMEAR = 6  # pixels, at a width of 1280, by which ripples move a reflection
DECK = (150, 150, 144)  # of own ship, which no other vessel is mixed with
OVERHEAD = np.array([0.2, -0.3, 1.0])  # to the part of the sky that is brightest apart from the sun, in the world


def caption_box(style: RenderStyle, picture: Image.Image) -> Box:
    """Box of the line that says what weather is drawn, in a corner of a picture, in its pixels."""
    width, height = Canvas(picture, round(style.enlarged * picture.width)).plate_size(style.caption)
    return 0, picture.height - height, width, picture.height


class ShadedPictureRenderer:
    """Draws shaded pictures in one style. It keeps the backdrop of a camera that does not move."""

    def __init__(self, renderer: ShadedRenderer, style: RenderStyle) -> None:
        """Take the renderer, which lives as long as its context."""
        self.style = style
        self._renderer = renderer
        self._grounds: dict[tuple[str, Intrinsics, Window], _Ground] = {}
        self._others: dict[RenderStyle, ShadedPictureRenderer] = {self.style: self}

    def styled(self, style: RenderStyle) -> ShadedPictureRenderer:
        """A renderer of another style in the same context."""
        if style not in self._others:
            self._others[style] = ShadedPictureRenderer(self._renderer, style)
        return self._others[style]

    def picture(
        self, solids: Solids, window: Window, speeds_m_s: Array | None = None, samples: int = SAMPLES
    ) -> Image.Image:
        """A shaded picture of a window. With speeds over ground of all vessels, shape (V,), they leave wakes, and show
        lights in the dark. `samples` are buffer pixels for each pixel and axis; with 1 edges are not smoothed."""
        rays = _rays(solids.intrinsics, window)
        ground = self._ground(rays, solids, window)
        faces = lit_faces(solids)
        mirrored = _mirrored(faces, solids)
        regions = _region(faces, solids, window), _region(mirrored, solids, window, margin_px=2 * SMEAR)
        rgb = ground.begin(solids.time_s)
        wakes = () if speeds_m_s is None else draw_wakes(rgb, ground.backdrop, solids, window, speeds_m_s)
        self._reflect(rgb, ground.backdrop, mirrored, solids, window, regions[1])
        self._stand(rgb, rays, faces, solids, window, regions[0], samples)
        rows = _rows((*regions, *wakes))
        if self.style.dark and speeds_m_s is not None:
            rows = slice(0, window.size[1])
            draw_lights(rgb, solids, window, speeds_m_s, self.style.extinction_per_m)
        picture = Image.fromarray(ground.end(rows, rays.inside))
        if self.style.rain:
            _rain(picture, int(solids.sight.steps[0]))
        if self.style.caption:
            canvas = Canvas(picture, round(self.style.enlarged * picture.width))
            canvas.plate(0, int(caption_box(self.style, picture)[1]), self.style.caption, palette.INK)
        return picture

    def _ground(self, rays: Rays, solids: Solids, window: Window) -> _Ground:
        """Sea and sky; kept from the last picture of the camera if it has not moved."""
        poses = solids.sight.camera_poses
        pose = np.concatenate([poses.camera_R_world[0].ravel(), poses.positions_m[0]])
        key = solids.camera.name, solids.intrinsics, window
        ground = self._grounds.get(key)
        if ground is None or not np.array_equal(ground.pose, pose):
            focal_px, place = solids.intrinsics.focal_px[0] * window.scale, poses.positions_m[0]
            behind = Backdrop(rays, poses.camera_R_world[0], place, focal_px, self.style, self.style.sea(solids.waves))
            ground = self._grounds[key] = _Ground(pose, behind)
        return ground

    def _lit(self, faces: LitFaces, solids: Solids, window: Window, region: Region, samples: int) -> LitPicture:
        to_picture = np.diag([window.scale * samples, window.scale * samples, 1.0])
        corner = window.x * window.scale + region.x, window.y * window.scale + region.y
        to_picture[:2, 2] = -samples * np.array(corner)
        lamps, ambient = _lamps(solids.sight.camera_poses.camera_R_world[0], self.style)
        size = (region.width * samples, region.height * samples)
        pixels = to_picture @ solids.intrinsics.matrix
        return self._renderer.draw(faces, pixels, solids.intrinsics.near_clip_m, size, lamps, ambient)

    def _stand(
        self, rgb: Floats, rays: Rays, faces: LitFaces, solids: Solids, window: Window, region: Region, samples: int
    ) -> None:
        if not region.width or not region.height:
            return
        lit = self._lit(faces, solids, window, region, samples)
        here = np.s_[region.y : region.y + region.height, region.x : region.x + region.width]
        colour = lit.colour
        if self.style.extinction_per_m:
            along = np.repeat(np.repeat(rays.camera[here][..., 2], samples, axis=0), samples, axis=1)
            misty = fogged(colour / np.float32(255), np.where(lit.drawn, lit.depth_m, 0) / along, self.style)
            colour = np.rint(misty * lit.drawn[..., None] * 255).astype(np.uint8)
        cover = _reduced(lit.drawn * np.uint8(255), samples)[..., None]
        rgb[here] = rgb[here] * (1 - cover) + _reduced(colour, samples)

    def _reflect(
        self, rgb: Floats, behind: Backdrop, mirrored: LitFaces, solids: Solids, window: Window, region: Region
    ) -> None:
        """Draw mirrored solids in a region, moved by ripples."""
        if not region.width or not region.height:
            return
        lit = self._lit(mirrored, solids, window, region, 1)
        here = np.s_[region.y : region.y + region.height, region.x : region.x + region.width]
        rows, columns = np.arange(region.height)[:, None], np.arange(region.width)
        unit = SMEAR * window.size[0] / 1280
        seen = np.dstack([lit.colour, lit.drawn * np.uint8(255)])
        if self.style.extinction_per_m:
            depth = np.where(lit.drawn, lit.depth_m, 0)
            kept = (lit.drawn * np.exp(-self.style.extinction_per_m * depth))[..., None]
            misty = fogged(lit.colour / np.float32(255), depth, self.style)
            seen = np.rint(np.dstack([misty * kept, kept]) * 255).astype(np.uint8)
        # Waves smear a reflection up and down, and hardly to the sides.
        small = (region.width, max(round(region.height / max(unit, 1)), 1))
        image = Image.frombuffer("RGBX", (region.width, region.height), seen, "raw", "RGBX", 0, 1)
        image = image.resize(small, Image.Resampling.BOX)
        soft = np.asarray(image.resize((region.width, region.height), Image.Resampling.BILINEAR)).reshape(-1, 4)
        from_row = np.clip(rows + np.rint(behind.ripple[here] * unit).astype(int), 0, region.height - 1)
        source = (from_row * region.width + columns).ravel()
        # Most of the sea shows no vessel: only the pixels that do are computed, each by one index, which is fast.
        shown = np.flatnonzero((soft[:, 3].take(source) > 0) & behind.sea[here].ravel())
        row, column = np.divmod(shown, region.width)
        row, column = row + region.y, column + region.x
        share: Floats = (behind.mirror(row, column) * np.float32(REFLECTION / 255))[:, None]
        light = soft.take(source[shown], axis=0) * share
        target, pixels = row * rgb.shape[1] + column, rgb.reshape(-1, 3)
        pixels[target] = pixels.take(target, axis=0) * (1 - light[:, 3:]) + light[:, :3]


class _Ground:
    """Sea and sky as a camera sees them from one pose, on which pictures are drawn one after another."""

    def __init__(self, pose: Array, behind: Backdrop) -> None:
        self.pose, self.backdrop = pose, behind
        self._rgb, self._changed = behind.colour.copy(), slice(0, 0)
        self._used = False
        self._shown: NDArray[np.uint8] | None = None

    def begin(self, time_s: float) -> Floats:
        """Nothing but sea and sky at a time to draw on, sRGB from 0 to 1, shape (h, w, 3)."""
        self._rgb[self._changed] = self.backdrop.colour[self._changed]
        if self.backdrop.waves is not None:
            self.backdrop.draw_sea(self._rgb, time_s)
        return self._rgb

    def end(self, rows: slice, inside: Mask) -> NDArray[np.uint8]:
        """The picture when some rows were drawn on, shape (h, w, 3), with paper outside the camera's image."""
        self._changed = rows
        if not self._used:  # by a camera that moves, only once
            self._used = True
            return _shown(self._rgb, inside)
        if self._shown is None:
            self._shown = _shown(self.backdrop.colour, inside)
        picture = self._shown.copy()
        for some in (rows, *([] if self.backdrop.waves is None else [self.backdrop.wet])):
            picture[some] = _shown(self._rgb[some], inside[some])
        return picture


def _shown(rgb: Floats, inside: Mask) -> NDArray[np.uint8]:
    shown: NDArray[np.uint8] = (np.clip(rgb, 0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8)
    shown[~inside] = palette.PAPER
    return shown


_rays = lru_cache(maxsize=32)(Rays.of)


def _reduced(image: NDArray[np.uint8], samples: int) -> Floats:
    """Means of blocks, from 0 to 1, shape (h / samples, w / samples) or (h / samples, w / samples, 3)."""
    return np.asarray(Image.fromarray(image).reduce(samples), dtype=np.float32) / np.float32(255)


def lit_faces(solids: Solids) -> LitFaces:
    """The triangles of the solids for a pinhole renderer; a lens that distorts has bent them before."""
    triangles, intrinsics = solids.triangles, solids.intrinsics
    snapped = np.rint(triangles.corners_px * SUBPIXELS) / SUBPIXELS  # as the ID pass has them
    depth = intrinsics.near_clip_m / triangles.inverse_depth
    flat = np.concatenate([snapped, np.ones_like(depth)[..., None]], axis=-1) @ np.linalg.inv(intrinsics.matrix).T
    corners = flat * depth[..., None]
    vessels, poses = len(solids.extents_m), solids.sight.camera_poses
    own, colours = solids.sight.carriers[0], []
    for occluder in solids.occluders.tolist():
        colour = occluder_colour(occluder, solids)
        colours.append(palette.mixed(colour, DECK, 0.75) if occluder < vessels and own[occluder] else colour)
    height_m = (corners @ poses.camera_R_world[0] + poses.positions_m[0])[..., 2]
    shade = np.clip(0.72 + 0.04 * height_m, 0.72, 1.1)  # what stands in the water is darker at its foot
    shade[solids.occluders[triangles.row] < vessels] = 1
    rgb = np.array(colours).reshape(-1, 3)[triangles.row] / 255
    return LitFaces(corners, solids.normals_camera(), rgb, shade)


def _mirrored(faces: LitFaces, solids: Solids) -> LitFaces:
    """The faces above the sea mirrored at it, without those that the near plane would cut."""
    poses = solids.sight.camera_poses
    rotation, place = poses.camera_R_world[0], poses.positions_m[0]
    world = faces.corners_camera @ rotation + place
    flip = np.array([1.0, 1.0, -1.0])
    turned = (world * flip - place) @ rotation.T
    # What is under water stands, turned over, within its own vessel's outline, and is drawn over: it is not cut off.
    kept = (world[..., 2] > 0).any(axis=1) & (turned[..., 2] >= solids.intrinsics.near_clip_m).all(axis=1)
    normals = (faces.normals_camera[kept] @ rotation * flip) @ rotation.T
    return LitFaces(turned[kept], normals, faces.colours[kept], None if faces.shade is None else faces.shade[kept])


def _region(faces: LitFaces, solids: Solids, window: Window, margin_px: int = 1) -> Region:
    """The pixels of a window that faces may touch."""
    if not len(faces.colours):
        return Region(0, 0, 0, 0)
    flat = faces.corners_camera @ solids.intrinsics.matrix.T
    pixels = window.to_picture(flat[..., :2] / flat[..., 2:]).reshape(-1, 2)
    return Region.around(np.concatenate([pixels.min(axis=0), pixels.max(axis=0)]), window.size, margin_px)


def _rows(regions: tuple[Region, ...]) -> slice:
    """The rows of a window that regions touch."""
    touched = [region for region in regions if region.width and region.height]
    first = min((region.y for region in touched), default=0)
    return slice(first, max((region.y + region.height for region in touched), default=0))


def _lamps(camera_R_world: Array, style: RenderStyle) -> tuple[list[Lamp], tuple[float, float, float]]:
    """Sun, sky and a little light from where the camera is; by night the moon in the sun's place. No sun through
    clouds."""
    to_sun, to_zenith = (tuple((camera_R_world @ world).tolist()) for world in (sun_of(style), OVERHEAD))
    if style.night:
        dim = 0.35 if style.overcast or style.rain else 1.0
        return [Lamp(to_sun, (0.65, 0.75, 1.0), 0.3 * dim)], (0.022 * dim, 0.026 * dim, 0.036 * dim)
    if style.dusk:
        lamps = [Lamp(to_zenith, (0.7, 0.8, 1.0), 0.35)]
        return [*lamps, *([Lamp(to_sun, (1.0, 0.55, 0.3), 1.1)] if style.sunny else [])], (0.06, 0.065, 0.09)
    from_camera = Lamp((0.0, -0.2, -1.0), (1.0, 1.0, 1.0), 0.35)
    if not style.sunny:
        return [Lamp(to_zenith, (0.95, 0.98, 1.0), 1.0), from_camera], (0.24, 0.25, 0.27)
    sun, sky = Lamp(to_sun, (1.0, 0.96, 0.88), 2.3), Lamp(to_zenith, (0.75, 0.87, 1.0), 0.7)
    return [sun, sky, from_camera], (0.20, 0.22, 0.25)


STREAKS, STREAK_PX, SLANT = 420, 26.0, 0.18  # of rain, in a picture 1280 px wide; how far the wind drives it aside


def _rain(picture: Image.Image, step: int) -> None:
    """Streaks of rain over a picture, others at each step."""
    (width, height), unit = picture.size, picture.width / 1280
    rng, veil = np.random.default_rng(step), Image.new("L", picture.size)
    draw = ImageDraw.Draw(veil)
    places, sizes = rng.random((STREAKS, 2)) * (width, height), STREAK_PX * unit * (0.3 + 0.7 * rng.random(STREAKS))
    for (x, y), size in zip(places.tolist(), sizes.tolist(), strict=True):
        draw.line(
            (x, y, x - SLANT * size, y + size), fill=round(70 * size / (STREAK_PX * unit)), width=max(round(unit), 1)
        )
    light = round(2.5 * float(np.asarray(picture.resize((16, 9))).mean()) ** 0.86)
    picture.paste((light, light, light), (0, 0), veil)
