"""The statistical detector: state, dropout and class, box error, false positives, confidence."""

from modsim3d.detector.census import TargetCensus
from modsim3d.detector.chain import Detector, take_census
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.model import DetectorModel, PerformanceState
from modsim3d.detector.records import FALSE_KINDS, FALSE_POSITIVE, KINDS, TRUE, CameraFrames, Detections, Targets

__all__ = [
    "FALSE_KINDS",
    "FALSE_POSITIVE",
    "KINDS",
    "TRUE",
    "CameraFrames",
    "Detections",
    "Detector",
    "DetectorModel",
    "PerformanceState",
    "TargetCensus",
    "Targets",
    "load_detector",
    "parse_detector",
    "take_census",
]
