"""Pose sources: which vessels are present at each step, where they are, and their headings. `base` has the interface:
`Poses`; `PoseSource`, which gives them; and `SourceKeys`, a section of a scene file that builds a source. `registry`
knows the built-in sources by name, and checks what plug-ins return. To add one, copy `WaypointTracks` of `base` (at the
scene's times) or one of `replay`: a file with its own times, or poses that arrive during the run. In a plug-in a
subclass of `base.PosesByTime` is the shortest way."""
