"""modsim3d: simulates cameras and their vessel detector in front of a multi-object tracker.

    >>> import modsim3d
    >>> scene = modsim3d.load_scene("strait", steps=2)
    >>> for frame in modsim3d.simulate_frames(scene):
    ...     truth, detections = frame.truth.boxes_px, frame.detections.boxes_px

`import modsim3d` loads no OpenGL, plotting or table library; each name below is imported when it is first used.
"""

from typing import TYPE_CHECKING

from modsim3d.core.lazy_names import LazyNames

if TYPE_CHECKING:  # what a type checker takes; it finds a misspelt name
    from modsim3d.campaign.campaign import Campaign as Campaign
    from modsim3d.campaign.campaign import open_campaign as open_campaign
    from modsim3d.campaign.campaign import run_campaign as run_campaign
    from modsim3d.campaign.means import Mean as Mean
    from modsim3d.campaign.means import MeanRow as MeanRow
    from modsim3d.campaign.verdicts.verdict import Verdict as Verdict
    from modsim3d.core.errors import InputError as InputError
    from modsim3d.core.errors import ModsimError as ModsimError
    from modsim3d.core.errors import OutputError as OutputError
    from modsim3d.core.errors import RendererError as RendererError
    from modsim3d.core.errors import RunDirectoryError as RunDirectoryError
    from modsim3d.detector.file.reading import load_detector as load_detector
    from modsim3d.detector.model import DetectorModel as DetectorModel
    from modsim3d.detector.truncation import truncated_errors as truncated_errors
    from modsim3d.formats.detect_truth import TruthResult as TruthResult
    from modsim3d.formats.detect_truth import detect_truth as detect_truth
    from modsim3d.formats.detect_truth import labelled_video as labelled_video
    from modsim3d.geometry.kinematics import closest_approach as closest_approach
    from modsim3d.learn.learning import LearnResult as LearnResult
    from modsim3d.learn.learning import learn_detector as learn_detector
    from modsim3d.learn.reported_figures import ReportedDetector as ReportedDetector
    from modsim3d.learn.reported_figures import learn_from_figures as learn_from_figures
    from modsim3d.learn.voyage.learn_voyage import VoyageResult as VoyageResult
    from modsim3d.learn.voyage.learn_voyage import learn_voyage as learn_voyage
    from modsim3d.learn.voyage.logs.log import LogOptions as LogOptions
    from modsim3d.runs.frames import Frame as Frame
    from modsim3d.runs.frames import FrameDetections as FrameDetections
    from modsim3d.runs.frames import FrameTruth as FrameTruth
    from modsim3d.runs.locating import Located as Located
    from modsim3d.runs.locating import locate as locate
    from modsim3d.runs.pipeline import simulate_frames as simulate_frames
    from modsim3d.runs.run import RunResult as RunResult
    from modsim3d.runs.run import detect_run as detect_run
    from modsim3d.runs.run import run_scene as run_scene
    from modsim3d.runs.run_rows import RunRows as RunRows
    from modsim3d.runs.stored_run import StoredRun as StoredRun
    from modsim3d.runs.stored_run import open_run as open_run
    from modsim3d.scene.cameras import camera_placement as camera_placement
    from modsim3d.scene.from_dict import scene_from_dict as scene_from_dict
    from modsim3d.scene.reading import load_scene as load_scene
    from modsim3d.scene.scene import Scene as Scene
    from modsim3d.scene.sight import IdImage as IdImage
    from modsim3d.scene.sight import Snapshot as Snapshot
    from modsim3d.tracking.score_run import RunScores as RunScores
    from modsim3d.tracking.score_run import score_run as score_run
    from modsim3d.tracking.track_run import TrackResult as TrackResult
    from modsim3d.tracking.track_run import track_run as track_run
    from modsim3d.tracking.trackers.interface import TrackedFrame as TrackedFrame
    from modsim3d.tracking.trackers.interface import Tracker as Tracker
    from modsim3d.tracking.world.scoring import score_world as score_world
    from modsim3d.tracks.reading import read_tracks as read_tracks
    from modsim3d.tracks.tracks import Tracks as Tracks
    from modsim3d.tracks.world_reading import read_world_tracks as read_world_tracks
    from modsim3d.verify.error_fit import MomentTable as MomentTable
    from modsim3d.verify.evidence import ManyDetections as ManyDetections
    from modsim3d.verify.verification import verify_evidence as verify_evidence
    from modsim3d.verify.verify_run import VerifiedRun as VerifiedRun
    from modsim3d.verify.verify_run import verify_run as verify_run
    from modsim3d.view.frame_plot import plot_frame as plot_frame
    from modsim3d.view.pictures.canvas import Window as Window
    from modsim3d.view.pictures.frame_picture import CameraView as CameraView
    from modsim3d.view.pictures.frame_picture import frame_picture as frame_picture
    from modsim3d.view.pictures.layers import DETECTIONS as DETECTIONS
    from modsim3d.view.pictures.plain import open_id_renderer as open_id_renderer
    from modsim3d.world.encounters import Encounter as Encounter
    from modsim3d.world.encounters import density_per_km2 as density_per_km2
    from modsim3d.world.encounters import encounter as encounter
    from modsim3d.world.encounters import hull_tracks as hull_tracks
    from modsim3d.world.encounters import lane_offsets as lane_offsets
    from modsim3d.world.encounters import speeds_m_s as speeds_m_s

    __version__: str

_NAMES = LazyNames(
    __name__,
    {
        "modsim3d.campaign.campaign": "Campaign open_campaign run_campaign",
        "modsim3d.campaign.means": "Mean MeanRow",
        "modsim3d.campaign.verdicts.verdict": "Verdict",
        "modsim3d.core.errors": "InputError ModsimError OutputError RendererError RunDirectoryError",
        "modsim3d.detector.file.reading": "load_detector",
        "modsim3d.detector.model": "DetectorModel",
        "modsim3d.detector.truncation": "truncated_errors",
        "modsim3d.formats.detect_truth": "TruthResult detect_truth labelled_video",
        "modsim3d.geometry.kinematics": "closest_approach",
        "modsim3d.learn.learning": "LearnResult learn_detector",
        "modsim3d.learn.reported_figures": "ReportedDetector learn_from_figures",
        "modsim3d.learn.voyage.learn_voyage": "VoyageResult learn_voyage",
        "modsim3d.learn.voyage.logs.log": "LogOptions",
        "modsim3d.runs.frames": "Frame FrameDetections FrameTruth",
        "modsim3d.runs.locating": "Located locate",
        "modsim3d.runs.pipeline": "simulate_frames",
        "modsim3d.runs.run": "RunResult detect_run run_scene",
        "modsim3d.runs.run_rows": "RunRows",
        "modsim3d.runs.stored_run": "StoredRun open_run",
        "modsim3d.scene.cameras": "camera_placement",
        "modsim3d.scene.from_dict": "scene_from_dict",
        "modsim3d.scene.reading": "load_scene",
        "modsim3d.scene.scene": "Scene",
        "modsim3d.scene.sight": "IdImage Snapshot",
        "modsim3d.tracking.score_run": "RunScores score_run",
        "modsim3d.tracking.track_run": "TrackResult track_run",
        "modsim3d.tracking.trackers.interface": "TrackedFrame Tracker",
        "modsim3d.tracking.world.scoring": "score_world",
        "modsim3d.tracks.reading": "read_tracks",
        "modsim3d.tracks.tracks": "Tracks",
        "modsim3d.tracks.world_reading": "read_world_tracks",
        "modsim3d.verify.error_fit": "MomentTable",
        "modsim3d.verify.evidence": "ManyDetections",
        "modsim3d.verify.verification": "verify_evidence",
        "modsim3d.verify.verify_run": "VerifiedRun verify_run",
        "modsim3d.view.frame_plot": "plot_frame",
        "modsim3d.view.pictures.canvas": "Window",
        "modsim3d.view.pictures.frame_picture": "CameraView frame_picture",
        "modsim3d.view.pictures.layers": "DETECTIONS",
        "modsim3d.view.pictures.plain": "open_id_renderer",
        "modsim3d.world.encounters": "Encounter density_per_km2 encounter hull_tracks lane_offsets speeds_m_s",
    },
)
__all__ = _NAMES.names
if not TYPE_CHECKING:
    __getattr__, __dir__ = _NAMES.__getitem__, _NAMES.listed
