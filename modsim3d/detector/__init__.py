"""The statistical detector: state, dropout and class, box error, false positives, confidence."""

from modsim3d.detector.chain import Detector, reference_of
from modsim3d.detector.loader import load_detector, parse_detector
from modsim3d.detector.model import DetectorModel, PerformanceState
from modsim3d.detector.records import FALSE_KINDS, FALSE_POSITIVE, KINDS, TRUE, CameraFrames, Detections, Targets
from modsim3d.detector.reference import Reference

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
    "Reference",
    "Targets",
    "load_detector",
    "parse_detector",
    "reference_of",
]
