"""Counts over the truths of a campaign: in how many runs and traffic seeds something is."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.campaign.folder import CampaignFolder
from modsim3d.campaign.work.coverage import COVERED, MET
from modsim3d.campaign.work.row import DONE
from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.text import UNKNOWN

_NEEDED = (COVERED, MET, "condition", "frames", "traffic_seed")
"""How the columns begin that are counted; those of scores are many, and left where they are."""


@dataclass(frozen=True)
class CountedBin:
    """A bin."""

    label: str
    count: int  # how often it was met, each truth counted once
    runs: int  # number of those in which it was
    seeds: int  # number of traffic seeds in which it was

    @property
    def cells(self) -> list[str]:
        """As a page shows them; dashes if there was none."""
        numbers = [f"{number:,}" for number in (self.count, self.runs, self.seeds)] if self.count else [UNKNOWN] * 3
        return [self.label, *numbers]


@dataclass(frozen=True, eq=False)
class Covered:
    """Rows that each stand for several runs: n of them."""

    rows: pa.Table  # columns of the first run of each
    runs: Indices  # number of runs of each, shape (n,)

    @classmethod
    def by(cls, table: pa.Table, key: str) -> Self:
        """The rows of runs that are done, one for each value of a column."""
        needed = [name for name in table.column_names if name.startswith(_NEEDED) or name.endswith(".frames")]
        done = table.select(list(dict.fromkeys([key, *needed]))).filter(pc.equal(table["status"], DONE))
        codes = done[key].combine_chunks().dictionary_encode().indices.to_numpy(zero_copy_only=False)
        _, first, runs = np.unique(codes, return_index=True, return_counts=True)
        return cls(done.take(pa.array(first, pa.int64())), np.asarray(runs, dtype=np.int64))

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.runs)

    def numbers(self, name: str) -> Array:
        """A column, NaN for null and where there is no such column, shape (n,)."""
        if name not in self.rows.column_names:
            return np.full(len(self), np.nan)
        return np.asarray(self.rows[name].to_numpy(zero_copy_only=False), dtype=np.float64)

    def in_rows(self, chosen: Mask, label: str, count: int) -> CountedBin:
        """A bin that is in some of the rows."""
        seeds = self.rows["traffic_seed"].to_numpy()[chosen]
        return CountedBin(label, count, int(self.runs[chosen].sum()), len(np.unique(seeds)))


class Truths(Covered):
    """The truths of a campaign: what all runs over one truth have in common is counted once."""

    @classmethod
    def of(cls, table: pa.Table) -> Self:
        """The truths of all runs that are done."""
        return cls.by(table, "truth_key")

    @property
    def runs_in_all(self) -> int:
        """Number of runs that are done."""
        return int(self.runs.sum())

    @property
    def seeds_in_all(self) -> int:
        """Number of traffic seeds that differ in their truth."""
        return len(np.unique(self.rows["traffic_seed"].to_numpy()))

    def known(self, name: str) -> bool:
        """Whether any run has a column."""
        return bool(np.isfinite(self.numbers(name)).any())

    def total(self, name: str) -> float:
        """The sum of a column over the truths."""
        return float(np.nansum(self.numbers(name)))

    def counted(self, name: str, label: str) -> CountedBin:
        """The bin of a column that counts."""
        values = self.numbers(name)
        return self.in_rows(values > 0, label, int(np.nansum(values)))

    def within(self, name: str, low: float, high: float, label: str) -> CountedBin:
        """Truths in which a column is at least `low` and below `high`."""
        values = self.numbers(name)
        chosen = (values >= low) & (values < high)
        return self.in_rows(chosen, label, int(np.count_nonzero(chosen)))

    def unknown(self, name: str, label: str) -> CountedBin:
        """Truths in which a column is null."""
        chosen = np.isnan(self.numbers(name))
        return self.in_rows(chosen, label, int(np.count_nonzero(chosen)))

    def span(self, least: str, most: str, unit: str, what: str = "All of them") -> str:
        """The least and the greatest of all truths in words; empty if there are none."""
        low, high = self.numbers(least), self.numbers(most)
        if not np.isfinite(low).any():
            return ""
        return f"{what}: from {_short(np.nanmin(low))} to {_short(np.nanmax(high))} {unit}."


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def counted_states(folder: CampaignFolder, table: pa.Table) -> tuple[CountedBin, ...]:
    """Frames in each performance state, the frames of a detector over a truth counted once."""
    looks = Covered.by(table, "detections_key")
    conditions = folder.facts["conditions"]
    condition = looks.rows["condition"].to_numpy()
    found = []
    for state in dict.fromkeys(state for each in conditions for state in each["states"]):
        only = np.isin(condition, [index for index, each in enumerate(conditions) if each["states"] == [state]])
        frames = np.nan_to_num(np.where(only, looks.numbers("frames"), looks.numbers(f"state.{state}.frames")))
        found.append(looks.in_rows(frames > 0, state, int(frames.sum())))
    return tuple(found)
