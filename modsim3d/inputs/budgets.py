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
MAX_YAML_BYTES = 1 << 20
"""Of a scene or detector in YAML, which takes two seconds a megabyte. A thousand vessels with tracks need half."""
MAX_YAML_VALUES = 200_000
"""Once aliases and merge keys are written out, which can multiply a file of ten lines to any size."""
YAML_CHARACTERS_PER_VALUE = 64
"""A long text counts as a value for each so many characters, since an alias can repeat it too."""
MAX_JSON_VALUES = 2_000_000
"""Of a file of vessels or a scene in JSON; each takes up to 100 bytes of memory. A thousand vessels are 10,000."""
POSE_BYTES_PER_VALUE = 8
"""A pose file may have more values than that if they are as long as those of poses, which take 12 bytes each."""
MAX_POSES = 200_000_000
"""Vessels times steps, present or not: 33 bytes each in memory. Two thousand vessels for a day take 173 million."""
