"""A tracker over the frames of cameras: it is given them one by one, and what it answers is checked."""

import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import chain
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from modsim3d import ModsimError, Scene, Tracks, load_scene
from modsim3d.io.plugins import TRACKERS, Plugin
from modsim3d.runs.camera_sequences import CameraSequence, SequenceTruth
from modsim3d.runs.tracker_view import TrackerDetections
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame, Tracker
from modsim3d.tracking.trackers.registry import NamedTracker
from modsim3d.tracking.trackers.running import Feed, tracked
from tests.scenes import crossing

Follow = Callable[[Iterable[SensedFrame], CameraFacts], Any]
BOX = [[10.0, 20.0, 30.0, 40.0]]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(crossing(tmp_path_factory.mktemp("scene"), 40), source="analytic")


def sequence(scene: Scene, steps: list[int], boxes: list[tuple[int, float]]) -> CameraSequence:
    """Frames at some steps of 0.5 s; detections as (place of the frame, x_min), 10 pixels wide and high."""
    count, none = len(boxes), np.empty(0)
    frame, x = np.array([at for at, _ in boxes], dtype=np.int64), np.array([x for _, x in boxes], dtype=float)
    truth = SequenceTruth(*(none.astype(kind) for kind in (int, int, int, bool)), np.empty((0, 4)), none, none, none)
    edges = np.column_stack([x, np.zeros(count), x + 10, np.full(count, 10.0)]).reshape(count, 4)
    told = TrackerDetections(frame, np.zeros(count, dtype=np.int64), edges, np.full(count, 0.5))
    return CameraSequence(scene.cameras[0], np.array(steps), np.array(steps) * 0.5, truth, told)


def named(script: Follow, plugin: bool = False) -> NamedTracker:
    """A tracker that does what a test says."""
    tracker = type("Mine", (Tracker,), {"follow": lambda self, frames, camera: script(frames, camera)})()
    return NamedTracker("mine", tracker, Plugin(TRACKERS, "mine", "mine 1.0") if plugin else None, "")


def run(scene: Scene, script: Follow, *, plugin: bool = True, times: int = 1) -> Tracks:
    """The tracks of a script in three frames, at steps 0, 2 and 4, with two, no and one detection."""
    sequences, tracker = [sequence(scene, [0, 2, 4], [(0, 5), (0, 50), (2, 7)])], named(script, plugin)
    return [tracked(tracker, sequences, [0], scene) for _ in range(times)][-1]


def test_a_tracker_is_given_each_frame_with_its_detections_and_time(scene: Scene) -> None:
    seen = []

    def script(frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        assert (camera.name, camera.labels, camera.rate_hz) == ("C0", tuple(scene.detector.labels), 1.0)
        assert camera.image_size_px == scene.cameras[0].intrinsics.image_size_px
        for frame in frames:
            seen.append((frame.time_s, frame.boxes_px[:, 0].tolist(), frame.label.shape, frame.confidence.tolist()))
            frame.boxes_px[:] = 0  # its own to write to
            yield TrackedFrame.empty()

    assert len(run(scene, script, times=2)) == 0
    assert seen[:3] == [(0.0, [5.0, 50.0], (2,), [0.5, 0.5]), (1.0, [], (0,), []), (2.0, [7.0], (1,), [0.5])]
    assert seen[3:] == seen[:3]


def test_tracks_are_numbered_by_their_first_box_and_cameras_are_tracked_by_themselves(scene):
    numbers = iter([[900, -4], [], [-4, 17]])

    def script(frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        for _ in frames:
            track = next(numbers)
            yield TrackedFrame(track, BOX * len(track))  # type: ignore[arg-type]

    tracks = run(scene, script)
    assert tracks.frame.tolist() == [0, 0, 4, 4] and tracks.track.tolist() == [1, 2, 2, 3]
    assert tracks.label.tolist() == [-1] * 4 and np.isnan(tracks.confidence).all()

    def script(frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        return (TrackedFrame(np.arange(7, 7 + len(each.label)), each.boxes_px, each.label) for each in frames)

    sequences = [sequence(scene, [0, 1], [(0, 5), (1, 6)]), sequence(scene, [1], [(0, 9)])]
    two = SimpleNamespace(cameras=scene.cameras * 2, detector=scene.detector)
    tracks = tracked(named(script), sequences, [0, 1], two)  # type: ignore[arg-type]
    assert (tracks.frame.tolist(), tracks.track.tolist()) == ([0, 2, 3], [1, 1, 1])
    assert (tracks.boxes_px[:, 0].tolist(), tracks.cameras) == ([5.0, 6.0, 9.0], 2)


def answer(**columns: Any) -> Follow:
    """A script that gives one answer in the frame at 1 s, and none in the others."""

    def script(frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        for frame in frames:
            wrong = {"track": [3], "boxes_px": BOX, **columns}
            yield TrackedFrame(**wrong) if frame.time_s == 1.0 else TrackedFrame.empty()

    return script


def yields(value: Any) -> Follow:
    return lambda frames, camera: (value for _ in frames)


def fails(frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
    for frame in frames:
        assert 1 / int(frame.time_s - 1.0)
        yield TrackedFrame.empty()


def leaves(frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
    yield from (TrackedFrame.empty() for _ in [next(iter(frames))])
    sys.exit()


def lagging(frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
    """Answers each frame after it has seen the next."""
    waiting = None
    for frame in frames:
        if waiting is not None:
            yield TrackedFrame.empty()
        waiting = frame
    yield TrackedFrame.empty()


NAN_COVARIANCE = [[[1.0, np.nan], [np.nan, 1.0]]]
WRONG: dict[str, tuple[Follow, str]] = {
    "all frames at once": (lambda frames, camera: [TrackedFrame.empty() for _ in frames], "at 0 s: it read the next"),
    "one frame ahead": (lagging, "at 0 s: it read the next frame before it answered this one"),
    "before it has read": (lambda frames, camera: iter([TrackedFrame.empty()] * 3), "at 0 s: it answered before it"),
    "too few": (lambda frames, camera: (TrackedFrame.empty() for _ in [next(frames)]), "at 1 s: it ended after 1 of 3"),  # type: ignore[call-overload]
    "too many": (
        lambda frames, camera: (TrackedFrame.empty() for _ in chain(frames, [None])),
        "it gave more answers than the camera has frames (3)",
    ),
    "nothing": (lambda frames, camera: None, "follow must yield"),
    "no answer": (yields(None), "at 0 s: the answer to a frame is a modsim3d.TrackedFrame, not NoneType"),
    "an exception": (fails, "failed: ZeroDivisionError: division by zero (test_running.py"),
    "an exit": (leaves, "failed: SystemExit:  (test_running.py"),
    "an exit at once": (lambda frames, camera: sys.exit(3), "failed: SystemExit: 3 (test_running.py"),
    "a float for a number": (answer(track=[3.0]), "TrackedFrame.track must be integers, not float64"),
    "a number for a list": (answer(track=3), "got the shape ()"),
    "twice": (answer(track=[3, 3], boxes_px=BOX * 2), "at 1 s: track 3: two boxes have the track 3"),
    "a box too few": (answer(track=[3, 4]), "boxes_px must have the shape (2, 4) with 2 tracks; got (1, 4)"),
    "three edges": (answer(boxes_px=[[1.0, 2.0, 3.0]]), "boxes_px must have the shape (1, 4)"),
    "text": (answer(boxes_px=[["a", "b", "c", "d"]]), "boxes_px must be an array of numbers"),
    "no boxes": (answer(boxes_px=None), "boxes_px must"),
    "a box of nothing": (answer(boxes_px=[[10, 20, np.nan, 40]]), "at 1 s: track 3: a box must be finite"),
    "x, y, width, height": (answer(boxes_px=[[500, 20, 30, 40]]), "with a positive width and height, not 500, 20, 30"),
    "no width": (answer(boxes_px=[[500, 20, 500, 40]]), "with a positive width and height"),
    "an unknown label": (answer(label=[9]), "a label is an index from 0 to"),
    "text for a label": (answer(label=["boat"]), "TrackedFrame.label must be integers"),
    "a label too many": (answer(label=[0, 0]), "label must have the shape (1,)"),
    "a confidence of 3": (answer(confidence=[3.0]), "a confidence is from 0 to 1, not 3"),
    "a negative variance": (answer(covariance_px2=[[[-1.0, 0], [0, 1]]]), "this is no covariance of x and y"),
    "too much covariance": (answer(covariance_px2=[[[1.0, 2], [2, 1]]]), "this is no covariance of x and y"),
    "unequal covariances": (answer(covariance_px2=[[[1.0, 0.1], [0.2, 1]]]), "this is no covariance of x and y"),
    "a track that is never near": (answer(boxes_px=[[9000.0, 20, 9010, 40]]), "more than an image away from the image"),
    "half a covariance": (answer(covariance_px2=NAN_COVARIANCE), "this is no covariance of x and y"),
}


@pytest.mark.parametrize(("script", "part"), WRONG.values(), ids=WRONG)
def test_a_wrong_answer_is_told_with_plugin_camera_and_time(scene: Scene, script: Follow, part: str) -> None:
    with pytest.raises(ModsimError) as caught:
        run(scene, script)
    said = str(caught.value)
    assert part in said
    assert said.startswith("the plug-in 'mine' of mine 1.0") and "camera 'C0'" in said and "\n" not in said


def test_what_is_right_is_kept_and_an_error_of_a_built_in_tracker_is_its_own(scene):
    covariance = [[[4.0, 1.0], [1.0, 9.0]]]
    tracks = run(scene, answer(label=[0], confidence=[1.0], covariance_px2=covariance))
    assert (tracks.frame.tolist(), tracks.track.tolist(), tracks.label.tolist()) == ([2], [1], [0])
    assert (tracks.boxes_px.tolist(), tracks.covariance_px2.tolist()) == (BOX, covariance)
    assert len(run(scene, answer(label=[-1], confidence=[np.nan]))) == 1
    with pytest.raises(ZeroDivisionError):
        run(scene, fails, plugin=False)
    assert len(tracked(named(yields(None)), [sequence(scene, [], [])], [0], scene)) == 0
    assert len(tracked(named(yields(None)), [], [], scene)) == 0


def test_working_time_is_that_of_the_tracker_and_not_of_what_makes_its_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr("modsim3d.tracking.trackers.running.perf_counter", lambda: clock.now)

    def slow(things: Iterable[int], seconds: float) -> Iterator[int]:
        for each in things:
            clock.now += seconds
            yield each

    tracker = named(lambda frames, camera: frames)
    feed = Feed(tracker, "", "step", np.arange(3.0), slow(range(3), 10), partial(slow, seconds=1))
    assert list(feed.answers(lambda count: None)) == [0, 1, 2] and feed.seconds == [1, 1, 1]
