"""Learning from a voyage without labels: AIS and the scene are the truth, against which cameras and clocks are
registered.
"""
