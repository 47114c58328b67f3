"""Ways to write a GIF with imageio, frame by frame, beside that of `modsim3d.view.films.files`; prints the table.

The film is the first of Simulation 1, 640 px wide, 200 frames of 0.2 s. Each writer runs in a process of its own, gets
the frames one by one, and chooses the colours itself where it cannot be given them. Memory is the most that the process
takes beyond what it had before the first frame. Run it with `python -m benchmarks.gif_writers`.
"""

from __future__ import annotations

import multiprocessing
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import imageio.v2
import imageio.v3
import numpy as np
from PIL import Image

from benchmarks.measured import table
from modsim3d.view.films.files import film_palette, quantised, write_gif

STEPS, FRAME_MS = 200, 200
TICKS = FRAME_MS // 10
Frames = Iterator[Image.Image]
Writer = Callable[[Path, Frames, Image.Image], None]


def ours(out: Path, frames: Frames, colours: Image.Image) -> None:
    indices = (quantised(frame, colours) for frame in frames)
    with out.open("wb") as file:
        write_gif(file, colours, ((Image.frombytes("L", each.size, each.tobytes()), TICKS) for each in indices))


def pillow_plugin(out: Path, frames: Frames, colours: Image.Image) -> None:
    with imageio.v3.imopen(out, "w", plugin="pillow") as file:
        for frame in frames:
            file.write(np.asarray(frame), duration=FRAME_MS, loop=0)


def pillow_plugin_with_palette(out: Path, frames: Frames, colours: Image.Image) -> None:
    options = {"is_batch": False, "duration": FRAME_MS, "loop": 0, "optimize": False}
    with imageio.v3.imopen(out, "w", plugin="pillow") as file:
        for frame in frames:
            indices = np.asarray(quantised(frame, colours))
            file.write(indices, palette=bytes(colours.getpalette() or []), **options)


def gif_pil(out: Path, frames: Frames, colours: Image.Image) -> None:
    """Without `subrectangles`, with which it ends in a TypeError at the second frame under NumPy 2.4."""
    with imageio.v2.get_writer(out, format="GIF-PIL", mode="I", duration=FRAME_MS / 1000) as file:
        for frame in frames:
            file.append_data(np.asarray(frame))


def ffmpeg_plugin(out: Path, frames: Frames, colours: Image.Image) -> None:
    """The plugin takes no file that ends in `.gif`."""
    chosen, film = out.with_suffix(".png"), out.with_suffix(".mp4")
    strip = np.array(colours.getpalette(), dtype=np.uint8).reshape(16, 16, 3)
    Image.fromarray(strip).save(chosen)
    filters = f"movie={chosen}[p];[0:v][p]paletteuse=dither=none:diff_mode=rectangle"
    options = {"fps": 1000 // FRAME_MS, "codec": "gif", "pixelformat": "pal8", "macro_block_size": 1}
    params = ["-f", "gif", "-filter_complex", filters]
    with imageio.v2.get_writer(film, format="FFMPEG", output_params=params, **options) as file:
        for frame in frames:
            file.append_data(np.asarray(frame))
    film.replace(out)


WRITERS: dict[str, Writer] = {
    "this one": ours,
    "imageio, `pillow`, with the film's palette": pillow_plugin_with_palette,
    "imageio, `pillow`": pillow_plugin,
    "imageio, `GIF-PIL`": gif_pil,
    "imageio, `FFMPEG`, with the film's palette": ffmpeg_plugin,
}


def frames_of(folder: Path) -> Frames:
    for path in sorted(folder.glob("frame_*.png")):
        with Image.open(path) as picture:
            yield picture.convert("RGB")


def memory_kb(key: str) -> int:
    return next(int(line.split()[1]) for line in Path("/proc/self/status").read_text().splitlines() if key in line)


def used_s() -> float:
    return time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])


def measured(name: str, folder: Path) -> list[str]:
    """A row of the table; what reading the frames takes is taken off."""
    colours = film_palette([frame for number, frame in enumerate(frames_of(folder)) if number % (STEPS // 4) == 0])
    out, began = folder / "film.gif", used_s()
    for _ in frames_of(folder):
        pass
    reading = used_s() - began
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted from here
    before, began = memory_kb("VmRSS"), used_s()
    WRITERS[name](out, frames_of(folder), colours)
    seconds, peak = used_s() - began - reading, memory_kb("VmHWM") - before
    encoder = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    wrong = 0.0
    with Image.open(out) as film:
        for number, frame in enumerate(frames_of(folder)):
            film.seek(number)
            exact = np.asarray(quantised(frame, colours).convert("RGB"))
            wrong += np.any(np.asarray(film.convert("RGB")) != exact, axis=-1).mean() / STEPS
    size = f"{out.stat().st_size / 1000:.0f} kB"
    return [name, f"{seconds:.1f} s", size, f"{max(peak, encoder) / 1024:.0f} MB", f"{100 * wrong:.0f} %"]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        run, film = Path(folder) / "run", Path(folder) / "film"
        program = [sys.executable, "-m", "modsim3d"]
        options = ["--mode", "2", "--steps", str(STEPS), "--no-sheet", "--out", run]
        subprocess.run([*program, "run", "simulation_1", *options], check=True)
        options = ["--kind", "detections", "--width", "640", "--format", "png", "--out", film]
        subprocess.run([*program, "view", "film", run, *options], check=True)
        with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
            rows = [pool.apply(measured, (name, film)) for name in WRITERS]
    heads = ["Writer", "Processor time", "File", "Memory for frames", "Pixels of another colour"]
    print(table(heads, rows))


if __name__ == "__main__":
    main()
