"""Import paths that were documented before their modules moved: thin aliases, found as `modsim3d.poses` and so on.

`modsim3d.__init__` puts this folder on the package's search path, so that each file here is a module of `modsim3d`.
"""
