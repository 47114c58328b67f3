"""Vessels side by side that drift with the current."""

from modsim3d.poses import PosesByTime


class Drift(PosesByTime):
    current_m_s: tuple[float, float]
    gap_m: float = 20.0

    def at(self, time_s, request):
        east, north = (speed * time_s for speed in self.current_m_s)
        return {name: ([east, north + i * self.gap_m, 0.0], 0.0) for i, name in enumerate(request.names)}
