"""A detector learned from a voyage: its log of detections, and the known tracks of vessels in place of labels."""
