"""MOT challenge text, `det.txt`: frame numbers, which a frame rate and a start make times of."""

from __future__ import annotations

import math
from pathlib import Path

from modsim3d.errors import InputError
from modsim3d.formats.reading.builder import Problems
from modsim3d.formats.reading.confidences import Confidences
from modsim3d.formats.reading.mot import plain_lines, sequence_info
from modsim3d.formats.reading.text_lines import number_lines
from modsim3d.inputs.budgets import FRAMES_A_ROW, FREE_FRAMES, MAX_FRAMES
from modsim3d.tracks.files.box_forms import MOT
from modsim3d.voyage.logs.log import Clock, DetectionLog, LogOptions, LogRows


def read_mot_log(path: Path, options: LogOptions) -> DetectionLog:
    """The log of a file of frame, −1, x, y, width, height, confidence and perhaps a class.

    Raises:
        InputError: The file is wrong, or its frame rate is not known.
    """
    source = f"detections {path}"
    problems = Problems(source, options.skip_bad)
    info = sequence_info(path, (math.nan, math.nan), source)
    rate_hz = options.frame_rate_hz or info.rate_hz
    if rate_hz is None:
        problem = "the frame rate is not known: give --frame-rate, or put seqinfo.ini beside or above the file"
        raise InputError(source, [problem])
    lines, said = plain_lines(number_lines(path, "detections", ",", 7, problems), path.name, problems)
    classes = any(len(numbers) > 7 and numbers[7] >= 1 for _, numbers in lines)
    scores = ((where, numbers[6]) for where, numbers in lines)
    rows = LogRows(source, problems, Confidences.of(scores, options.confidence_scale, problems), MOT)
    most = min(max(info.frames, FREE_FRAMES + FRAMES_A_ROW * len(lines)), MAX_FRAMES)
    last = max([info.frames, *(int(numbers[0]) for _, numbers in lines if 1 <= numbers[0] <= most)])
    frames = [rows.frame(None, number / rate_hz, info.size_px) for number in range(last)]
    for where, numbers in lines:
        if not 1 <= numbers[0] <= most or numbers[0] != int(numbers[0]):
            problems.add(f"{where}: frame must be a whole number from 1 to {most} (got {numbers[0]:.15g})")
            continue
        x, y, width, height = numbers[2:6]
        label = _label(int(numbers[7]), options.labels) if classes and len(numbers) > 7 else None
        rows.add(frames[int(numbers[0]) - 1], where, [x - 1, y - 1, width, height], label, numbers[6])
    known = "seqLength in seqinfo.ini" if info.frames >= last else "the frame numbers up to the last with a detection"
    at = "" if options.start else "; its first frame is taken to be the scene's first step (--start gives another time)"
    return rows.log(Clock.STEP, f"{known}, {rate_hz:g} Hz{at}", notes=said)


def _label(number: int, labels: tuple[str, ...]) -> str:
    return labels[number - 1] if 1 <= number <= len(labels) else f"class_{number}"
