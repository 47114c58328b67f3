"""Poses from real traffic: AIS reports in, a scene folder out.

AIS is what ships broadcast about themselves (ITU-R M.1371): position, speed and course every few seconds to minutes,
name, type and dimensions every six minutes. `traffic` runs the parts in this order:

- `gathering` reads all files: `recognise` tells their format, `layouts` knows the columns of tables, `read_csv` and
  `read_nmea` return `messages`, and `cleaning` drops what is of no use;
- `time_grid` makes the steps, `hulls` the vessels with `ship_types`, and `geography` the local metres;
- `vessel_track` follows one vessel: `cleaning` drops jumps, `headings` fills gaps in, `resampling` moves to the steps;
- `viewpoint` finds a place for the camera; `scene_folder` writes the scene, and `report` what was done.
"""
