"""Poses from real traffic: AIS reports in, a scene folder out.

AIS is what ships broadcast about themselves (ITU-R M.1371): position, speed and course every few seconds to minutes,
name, type and dimensions every six minutes. `conversion` runs the parts in order; each is a file with one job.
"""
