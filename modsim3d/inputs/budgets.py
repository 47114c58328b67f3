"""What an input may cost: every budget of the readers, each with its reason."""

from __future__ import annotations

MAX_TEXT_BYTES = 1 << 29
"""Of a file that is read as a whole: seven million poses. What is parsed from it takes up to ten times as much."""
MAX_UNPACK_RATIO = 100
"""Bytes that a gzipped file may unpack to for each of its own: tables reach 20, a file that is all one byte 1000."""
FREE_UNPACKED_BYTES = 1 << 23
"""Bytes that any gzipped file may unpack to."""
PIECE_BYTES = 1 << 20
"""Read at once. A single read would reserve memory for the whole budget."""
