"""The campaign of simulated voyages: one is made again, and the committed page says what its numbers say."""

from __future__ import annotations

import json

import pytest

from benchmarks.campaigns.voyages import OUT
from benchmarks.voyages.cases import CASES
from benchmarks.voyages.page import text
from benchmarks.voyages.reported import AisErrors, as_reported
from benchmarks.voyages.scores import below, fewest, scores, share
from benchmarks.voyages.trials import holds, trial

