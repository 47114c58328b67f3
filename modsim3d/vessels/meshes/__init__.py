"""Vessel shapes from mesh files, shipped and the user's own."""

from modsim3d.vessels.meshes.limits import MAX_FACES, MAX_VERTICES
from modsim3d.vessels.meshes.reading import load_mesh, shipped_meshes

__all__ = ["MAX_FACES", "MAX_VERTICES", "load_mesh", "shipped_meshes"]
