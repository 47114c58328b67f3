"""The oracle-association reference: detections associated by where they came from."""

from modsim3d.tracking.oracle.association import oracle_tracks

__all__ = ["oracle_tracks"]
