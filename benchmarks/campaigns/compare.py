"""compare: rendered truth of random scenes against ID buffers and analytic truth; nothing may be unexplained.

The scenes are those of tests/scenes.py, one seed a scene, from 0 on. `random_scene`: 1 to 40 disjoint boxes of 2 to
400 m at 5 m to 10 km, before cameras with any roll, skew, focal length and near plane; the first of them are looked at
again with supersampling. `random_rafts`: boats with faces in one plane that overlap, touch or lie an inch apart. Exit
status 1 if a difference is unexplained.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from modsim3d.render.id_pass import IdRenderer
from modsim3d.truth.crosscheck.comparison import CheckCounts
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.rendered import rendered_occlusion, rendered_spans
from modsim3d.verify.sources.agreement import EXPLANATIONS, Agreement, Comparison, compare_with_analytic
from modsim3d.verify.sources.compare import FastPath
from tests.scenes import drawing_of, outlines_of, random_rafts, random_scene

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
SCENES = {1: 2000, 4: 300}  # supersampling → number of scenes
RAFTS = 10_000
SCENES_AT_ONCE = 20
TITLES = {1: "supersample 1", 4: "supersample 4", 0: "rafts"}  # 0 stands for the rafts, which are not supersampled


@dataclass
class Tally:
    """What was found in a run of scenes."""

    scenes: int = 0
    vessel_frames: int = 0
    hidden_in_part: int = 0
    hidden_wholly: int = 0
    full: dict[str, int] = field(default_factory=lambda: dict.fromkeys(EXPLANATIONS.values(), 0))
    visible: dict[str, int] = field(default_factory=lambda: dict.fromkeys(EXPLANATIONS.values(), 0))
    largest_agreed_full_side_px: float = 0.0
    largest_agreed_visible_side_px: float = 0.0
    largest_side_at_a_tip_px: float = 0.0
    visible_at_all_differs: int = 0
    pixels_looked_at: int = 0
    drawn: CheckCounts = field(default_factory=CheckCounts)
    differs_from_drawn: int = 0
    unexplained: list[dict[str, Any]] = field(default_factory=list)

    def add(self, seed: int, rendered: Occlusion, found: Comparison, names: list[str]) -> None:
        """Count one scene."""
        fraction = rendered.visible_fraction()
        self.scenes += 1
        self.vessel_frames += len(names)
        self.hidden_in_part += int(((fraction > 0) & (fraction < 1)).sum())
        self.hidden_wholly += int((fraction == 0).sum())
        for verdict, reason in EXPLANATIONS.items():
            self.full[reason] += int((found.full == verdict).sum())
            self.visible[reason] += int((found.visible == verdict).sum())
        self.largest_agreed_full_side_px = max(
            self.largest_agreed_full_side_px, largest(found.full_side_px[found.full == Agreement.AGREE])
        )
        self.largest_agreed_visible_side_px = max(
            self.largest_agreed_visible_side_px, largest(found.visible_side_px[found.visible == Agreement.AGREE])
        )
        self.largest_side_at_a_tip_px = max(
            self.largest_side_at_a_tip_px, largest(found.full_side_px[found.full == Agreement.SHARP_TIP])
        )
        self.visible_at_all_differs += int((found.seen_differs & (found.visible != Agreement.INTERSECTING)).sum())
        self.pixels_looked_at += int(found.pixels_looked_at.sum())
        for row in np.flatnonzero(found.worst == Agreement.UNEXPLAINED):
            self.unexplained.append({"seed": seed, "vessel": names[row]})

    def join(self, other: Tally) -> None:
        """Add what another run of scenes found."""
        for name, value in vars(other).items():
            mine = getattr(self, name)
            if isinstance(value, dict):
                setattr(self, name, {key: mine[key] + value[key] for key in mine})
            else:
                setattr(self, name, max(mine, value) if name.startswith("largest") else mine + value)


def largest(sides_px: np.ndarray) -> float:
    return float(np.nanmax(np.abs(sides_px), initial=0.0))


def compare_scene(seed: int, kind: int, renderer: IdRenderer) -> Tally:
    """Compare one scene of a kind, a key of `TITLES`."""
    tally, supersample = Tally(), max(kind, 1)
    places, intrinsics, mount = (random_scene if kind else random_rafts)(np.random.default_rng(seed))
    outlines = outlines_of(places, intrinsics, mount)
    asked = outlines, intrinsics, renderer, supersample
    fast = FastPath(outlines, rendered_occlusion(*asked), rendered_spans(*asked))
    drawings = [drawing_of(places, intrinsics, mount, supersample)]
    names, boxed = [each.name for each, _, _ in places], np.ones((1, len(places)), dtype=bool)
    tally.drawn, differing, missing = fast.compare(drawings, boxed, names, renderer)

    def masks_of(row: int):
        return fast.masks(row, drawings)

    found = compare_with_analytic(outlines, intrinsics, fast.occlusion, masks_of, supersample)
    found.visible[list(differing)] = Agreement.UNEXPLAINED
    tally.add(seed, fast.occlusion, found, [names[i] for i in outlines.occluder])
    tally.differs_from_drawn = len(differing) + missing
    if missing:
        tally.unexplained.append({"seed": seed, "vessel": f"{missing} that were drawn and have no row"})
    return tally


def look_at(seeds: range, kind: int) -> tuple[Tally, str]:
    """Compare some scenes of a kind; also says what drew them."""
    from modsim3d.render.context import open_context

    tally = Tally()
    with open_context() as context:
        renderer = IdRenderer(context)
        for seed in seeds:
            tally.join(compare_scene(seed, kind, renderer))
        return tally, context.description


def portions(count: int, kind: int) -> Iterator[tuple[range, int]]:
    for first in range(0, count, SCENES_AT_ONCE):
        yield range(first, min(first + SCENES_AT_ONCE, count)), kind


def figures(tally: Tally) -> dict[str, Any]:
    """A tally for the JSON file, with shares."""
    frames = max(tally.vessel_frames, 1)
    hidden = tally.hidden_in_part + tally.hidden_wholly
    tips = tally.full[EXPLANATIONS[Agreement.SHARP_TIP]]
    return {
        **vars(tally),
        "drawn": asdict(tally.drawn),
        "hidden_share": hidden / frames,
        "sharp_tip_share": tips / frames,
    }


def table(found: dict[int, dict[str, Any]]) -> str:
    """The figures as a Markdown table, a column for each kind of scene."""
    columns = list(found.values())
    rows: list[tuple[str, list[str]]] = [
        ("random scenes", [f"{c['scenes']}" for c in columns]),
        ("vessel-frames", [f"{c['vessel_frames']}" for c in columns]),
        ("hidden in part or wholly", [f"{c['hidden_share']:.1%}" for c in columns]),
        ("**unexplained**", [f"**{len(c['unexplained'])}**" for c in columns]),
        ("silhouettes that OpenGL drew alone", [f"{c['drawn']['vessels']}" for c in columns]),
        ("buffers of the scene that it drew", [f"{c['drawn']['frames']}" for c in columns]),
        ("pixels compared with what was drawn", [f"{c['drawn']['pixels']}" for c in columns]),
        ("rendered from spans, vessel-frames", [f"{c['drawn']['from_spans']}" for c in columns]),
        ("rendered from buffers, vessel-frames", [f"{c['drawn']['from_buffers']}" for c in columns]),
        ("**not as it was drawn**", [f"**{c['differs_from_drawn']}**" for c in columns]),
        ("pixels that differ where rounding decides", [f"{c['drawn']['tie_pixels']}" for c in columns]),
        ("largest side difference of full boxes that agree", px(columns, "largest_agreed_full_side_px")),
        ("largest side difference of visible boxes that agree", px(columns, "largest_agreed_visible_side_px")),
        ("full boxes with a sharp tip without a pixel centre", [f"{c['sharp_tip_share']:.2%}" for c in columns]),
        ("largest side difference at such a tip", px(columns, "largest_side_at_a_tip_px")),
        ("seen by one source only", [f"{c['visible_at_all_differs']}" for c in columns]),
        ("every pixel checked against geometry", [f"{c['pixels_looked_at']}" for c in columns]),
    ]
    for kind, title in (("full", "full box"), ("visible", "visible part")):
        for reason in EXPLANATIONS.values():
            rows.append((f"{title}: {reason}", [f"{c[kind][reason]}" for c in columns]))
    head = ["| | " + " | ".join(TITLES[kind] for kind in found) + " |", "|---" * (len(found) + 1) + "|"]
    return "\n".join(head + [f"| {name} | {' | '.join(cells)} |" for name, cells in rows])


def px(columns: list[dict[str, Any]], name: str) -> list[str]:
    return [f"{column[name]:.3f} px" for column in columns]


def page(found: dict[int, dict[str, Any]], versions: dict[str, str]) -> str:
    total = sum(len(column["unexplained"]) for column in found.values())
    lines = [
        "# Rendered truth of random scenes, against what OpenGL draws and against geometry",
        "",
        "Written by `script/campaign compare`; the same figures are in `compare.json`.",
        "",
        "Each scene holds 1 to 40 disjoint boxes of 2 to 400 m at 5 m to 10 km, some touching, some across the near "
        "plane, before a camera with any roll, skew, focal length and near plane. Rafts are 1 to 4 groups of 2 to 6 "
        "boats of one length and beam, most of one height, side by side or astern, that overlap by a tenth, touch, are "
        "in one place or a hundredth apart. Faces in one plane are then before each other: of them, the vessel that "
        "comes first in the scene is in front.",
        "",
        "OpenGL draws each vessel alone, and the scene around them with a depth test; projection, clipping and order "
        "are the drawing's own. The rendered truth must have the same pixels, counts, boxes and occluders. A pixel may "
        "differ only at a tie: where an edge that is moved by 1/128 px, or a face that is moved by 1/128 px along its "
        "slope and 2⁻²⁰ of its nearest depth, changes what is seen.",
        "",
        "Against the analytic truth, two boxes agree if no side differs by more than a pixel of the buffer "
        "(1 / supersample of an image pixel) and the visible fraction by no more than pixels on the boundary explain. "
        "Of all others every pixel is looked at: it must be set if its centre is inside the exact region, and only "
        "then.",
        "",
        table(found),
        "",
        f"Unexplained in all: {total}.",
    ]
    for kind, column in found.items():
        lines += [f"- {TITLES[kind]}: seed {case['seed']}, vessel {case['vessel']}" for case in column["unexplained"]]
    lines += ["", "With " + ", ".join(f"{name} {number}" for name, number in versions.items()) + "."]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign compare", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenes", type=int, help="fewer than the campaign's own, for a try")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for compare.md and compare.json")
    options = parser.parse_args()
    planned = {kind: min(count, options.scenes or count) for kind, count in {**SCENES, 0: RAFTS}.items()}
    work = [portion for kind, count in planned.items() for portion in portions(count, kind)]
    tallies = {kind: Tally() for kind in planned}
    drawn_by = set()
    # OpenGL must be loaded in each process for itself.
    with ProcessPoolExecutor(options.processes, multiprocessing.get_context("spawn")) as pool:
        for (seeds, kind), (tally, renderer) in zip(work, pool.map(look_at, *zip(*work, strict=True)), strict=True):
            tallies[kind].join(tally)
            drawn_by.add(renderer)
            print(f"{TITLES[kind]}: {seeds.stop} of {planned[kind]} scenes", file=sys.stderr)
    found = {kind: figures(tally) for kind, tally in tallies.items()}
    versions = {
        "modsim3d": version("modsim3d"),
        "NumPy": np.__version__,
        "shapely": f"{shapely.__version__} (GEOS {shapely.geos_version_string})",
        "renderer": " and ".join(sorted(drawn_by)),
    }
    options.out.mkdir(parents=True, exist_ok=True)
    by_factor = {str(kind): found[kind] for kind in SCENES}
    data = json.dumps({"format": 2, "versions": versions, "supersample": by_factor, "rafts": found[0]}, indent=2)
    (options.out / "compare.json").write_text(data + "\n", encoding="utf-8")
    (options.out / "compare.md").write_text(page(found, versions), encoding="utf-8")
    print(table(found))
    return int(any(column["unexplained"] for column in found.values()))


if __name__ == "__main__":
    sys.exit(main())
