"""Searches for garbage while a stream runs."""

from __future__ import annotations

import gc

import pytest

from modsim3d.runs.streaming.lines import short_collections


def test_collections_leave_out_what_was_there_before_and_only_inside():
    before = gc.get_threshold()
    with pytest.raises(ZeroDivisionError), short_collections():
        assert len(gc.get_objects()) < 100 < gc.get_freeze_count()
        assert gc.get_threshold()[0] == 700
        raise ZeroDivisionError
    assert gc.get_threshold() == before
    assert gc.get_freeze_count() == 0
