"""Barges that drift with the current in a swell: a pose source, a wave level and a shape for modsim3d."""

from modsim3d.plugins import Axis, PosesByTime


class Drift(PosesByTime):
    current_m_s: tuple[float, float]
    gap_m: float = 20.0

    def at(self, time_s, request):
        east, north = (speed * time_s for speed in self.current_m_s)
        return {name: ([east, north + i * self.gap_m, 0.0], 0.0) for i, name in enumerate(request.names)}


SWELL = (Axis(a=0.99, b=0.995, sigma_rad=4e-5), Axis(a=0.99, b=0.995, sigma_rad=6e-5), Axis(sigma_rad=1e-5))


def barge():
    vertices = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, [half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))]
