"""When each vessel has reported: what a scene made from AIS says of how fresh its poses are."""

from __future__ import annotations

import gzip

import orjson

from modsim3d.ais.options import time_text
from modsim3d.ais.traffic import Traffic

REPORT_TIMES = "report_times.json.gz"
_DECIMALS = 3


def report_times(traffic: Traffic) -> bytes:
    """The content of `report_times.json.gz`: the start, and seconds since then of each vessel's positions.

    `used_s` are those of the positions that its poses are made of, `jumps_s` of those that it cannot have reached.
    """
    vessels = {
        str(vessel.mmsi): {
            "used_s": vessel.reported_s.round(_DECIMALS).tolist(),
            "jumps_s": vessel.jumps_s.round(_DECIMALS).tolist(),
        }
        for vessel in traffic.vessels
    }
    content = {"start": time_text(traffic.grid.start_s), "vessels": vessels}
    return gzip.compress(orjson.dumps(content), mtime=0)
