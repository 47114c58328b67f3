"""The seeds of a campaign, all from one number.

Seeds below 1,000,000 are left to people: the settings of trackers, for one, were chosen on seeds 1001 and up.
"""

from __future__ import annotations

from modsim3d.campaign.file.keys import MOST_DETECTOR_SEEDS, MOST_SEEDS


def traffic_seed(base: int, index: int) -> int:
    """Seed of the scene of the repetition `index`, from 0: 1000000, 1000001, … for base 1."""
    return base * MOST_SEEDS + index


def detector_seed(traffic: int, index: int) -> int:
    """The detector seed `index`, from 0, of a traffic seed."""
    return traffic * MOST_DETECTOR_SEEDS + index
