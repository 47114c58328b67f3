"""Real traffic: AIS reports in, a scene folder out.

AIS is what ships broadcast about themselves (ITU-R M.1371): position, speed and course every few seconds to minutes,
name, type and dimensions every six minutes. `traffic` runs the parts in this order:

- `gathering` reads all files: `read_csv` and `read_nmea` return `messages`, without what is of no use;
- `vessel_track` makes the steps and follows one vessel: jumps are dropped, gaps in headings filled; `hulls` has the
  vessels with their types;
- `scene_folder` writes the scene with a place for the camera, and `report` what was done.
"""
