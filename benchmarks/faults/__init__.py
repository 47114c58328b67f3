"""Faults made on purpose while modsim3d writes files; `script/campaign faults` tries them all."""
